"""The command line: answers at once, refuses bad input, and goes on after being stopped in any way."""

import contextlib
import csv
import os
import re
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from study.config import SMOKE

ROOT = Path(__file__).resolve().parents[2]
OPTIMUM = -330.15
"""On the paper's plant, 900 x 900 states (mean over seeds 0-9)."""


def command(*arguments):
    return [sys.executable, "-m", "study.main", *map(str, arguments)]


def study(*arguments, timeout=120):
    return subprocess.run(command(*arguments), cwd=ROOT, capture_output=True, text=True, timeout=timeout, check=False)


def rows(folder):
    with (folder / "runs.csv").open() as file:
        return [{k: v for k, v in row.items() if k != "wall_time_s"} for row in csv.DictReader(file)]


def test_help_answers_within_half_a_second():
    seconds = []
    for _ in range(5):
        begin = time.perf_counter()
        assert "quick,paper" in study("--help").stdout
        seconds.append(time.perf_counter() - begin)
    assert min(seconds) < 0.5


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--preset", "slow"], ["unknown preset 'slow'", "quick, paper, paper-small"]),
        (["--sedes", "3"], ["unknown option '--sedes'", "--preset, --out"]),
        (["--workers", "some"], ["workers", "some"]),
        (["--workers", "-1"], ["--workers -1", "0 for one a core"]),
        (["--checkpoint-seconds", "nan"], ["nan", "number of seconds >= 0"]),
        (["--device", "abacus"], ["abacus", "'cpu' always can"]),
        (["--out", "pyproject.toml"], ["pyproject.toml is a file", "choose another --out"]),
        (["--out", "tests/study"], []),
    ],
)
def test_bad_input_ends_with_a_sentence_and_code_2(arguments, told, tmp_path):
    if "tests/study" in arguments:
        (tmp_path / "report.html").write_text("mine")
        arguments, told = ["--out", tmp_path], ["report.html", "choose another --out"]
    before = sorted(tmp_path.iterdir())
    answer = study(*arguments)
    assert answer.returncode == 2
    said = " ".join(re.sub(r"[│╭╮╰╯─]", " ", answer.stdout + answer.stderr).split())
    for text in told:
        assert text in said
    assert "Traceback" not in said
    assert sorted(tmp_path.iterdir()) == before


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    answer = study("--preset", "smoke", "--out", folder)
    assert answer.returncode == 0, answer.stderr
    return folder, answer.stdout


def test_a_study_ends_with_its_answer_and_files(undisturbed):
    folder, said = undisturbed
    assert "What were the first rollouts worth?" in said
    assert f"report   {folder / 'report.html'}" in said
    made = {path.name for path in folder.iterdir()}
    assert made == {
        "results.sqlite", "runs.csv", "references.csv", "report.html",
        "heatmap.png", "pareto.png", "gap.png", "curves.png", "policies",
    }  # fmt: skip
    assert len(rows(folder)) == len(SMOKE.cells)


def test_a_finished_study_is_only_drawn_again(undisturbed):
    folder, _ = undisturbed
    database = (folder / "results.sqlite").read_bytes()
    (folder / "heatmap.png").unlink()
    assert study("--preset", "smoke", "--out", folder).returncode == 0
    assert (folder / "heatmap.png").exists()
    assert (folder / "results.sqlite").read_bytes() == database


def test_references_of_the_smallest_grid_are_near_the_optimum(undisturbed):
    folder, _ = undisturbed
    with (folder / "references.csv").open() as file:
        returns = {row["controller"]: float(row["return_mean"]) for row in csv.DictReader(file)}
    assert returns["optimal"] > returns["swing_up_lqr"] > returns["lqr"]


def test_every_run_keeps_what_its_number_depends_on(undisturbed):
    folder, _ = undisturbed
    with sqlite3.connect(folder / "results.sqlite") as db:
        for returns, curve, settings, versions in db.execute("SELECT returns, curve, settings, versions FROM runs"):
            assert returns.count(",") == SMOKE.episodes - 1
            assert curve.count("[") == 1 + SMOKE.steps // 200
            assert all(f'"{name}"' in settings for name in ("polyak", "gamma", "randomization", "sigma", "truth"))
            assert all(f'"{name}"' in versions for name in ("torch", "torchrl", "numpy", "python"))


class Stoppable:
    """A smoke study in its own process group, with a checkpoint at every look at the clock."""

    def __init__(self, folder, workers):
        self.folder = folder
        arguments = ("--preset", "smoke", "--out", folder, "--workers", workers, "--checkpoint-seconds", "0")
        self.process = subprocess.Popen(
            command(*arguments), cwd=ROOT, start_new_session=True, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    def wait_for_training(self):
        """Until a checkpoint is written that was not there before."""
        known = self._checkpoints()
        deadline = time.monotonic() + 60.0
        while not self._checkpoints() - known:
            assert self.process.poll() is None, self.process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def _checkpoints(self):
        found = set()
        for path in self.folder.glob("*.checkpoint"):
            with contextlib.suppress(FileNotFoundError):
                found.add((path.name, path.stat().st_mtime_ns))
        return found

    def workers(self):
        """Process ids of its workers."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        return [int(pid) for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]

    def end(self):
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="workers are looked up in /proc, which is Linux")
def test_stopped_in_every_way_the_same_command_goes_on_to_the_same_numbers(undisturbed, tmp_path):
    everything = Stoppable(tmp_path, workers=2)
    everything.wait_for_training()
    os.killpg(everything.process.pid, signal.SIGKILL)
    everything.end()
    assert list(tmp_path.glob("*.checkpoint"))

    parent = Stoppable(tmp_path, workers=1)
    parent.wait_for_training()
    workers = parent.workers()
    assert workers
    parent.process.kill()
    parent.end()
    deadline = time.monotonic() + 10.0
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < deadline, "workers outlived their parent"
        time.sleep(0.05)

    worker = Stoppable(tmp_path, workers=1)
    worker.wait_for_training()
    os.kill(worker.workers()[0], signal.SIGKILL)
    code, _, said = worker.end()
    assert code == 1
    assert re.fullmatch(r"error: population \d of 2 failed: .* SIGKILL \(out of memory\?\); .* goes on: .*\n", said)

    (tmp_path / "population_2.checkpoint.partial").write_bytes(b"a checkpoint that was never finished")
    interrupted = Stoppable(tmp_path, workers=1)
    interrupted.wait_for_training()
    os.killpg(interrupted.process.pid, signal.SIGINT)
    code, _, said = interrupted.end()
    assert code == 130
    assert re.fullmatch(r"\nstopped; the same command goes on: python -m study.main --preset smoke --out .*\n", said)

    answer = study("--preset", "smoke", "--out", tmp_path, "--workers", "1")
    assert answer.returncode == 0, answer.stderr
    assert "from a checkpoint" in answer.stdout
    assert rows(tmp_path) == rows(undisturbed[0])
    assert not list(tmp_path.glob("*.checkpoint*"))


def test_quick_has_the_start_states_of_the_paper():
    from policies.evaluate import evaluate, start_states
    from study.cells import start_states as study_starts
    from study.identification import hidden_plant

    theta, theta_dot = study_starts(SMOKE, 1)
    expected = start_states(1, SMOKE.episodes)
    assert np.array_equal(theta, expected[0])
    assert np.array_equal(theta_dot, expected[1])
    assert evaluate(lambda state, t: 0.0, hidden_plant((2.0, 1.5)), theta, theta_dot).mean < OPTIMUM
