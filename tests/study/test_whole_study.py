"""A study leaves an answer that can be looked up, and so does one that is killed at random moments, as by a power cut.

Workers, the driver and all of them at once are killed; nobody cleans up. Started again, the study gives the numbers of
one that ran through.
"""

import contextlib
import csv
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from study.paper.presets import SMOKE

ROOT = Path(__file__).resolve().parents[2]
STEPS = 3500
"""So many that six kills hit training."""
STUDY = f"""
import dataclasses, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs in the background of a shell ignores it
from study import main
from study.paper import presets
presets.PAPER_PRESETS["smoke"] = dataclasses.replace(presets.SMOKE, steps={STEPS})
sys.exit(main.main())
"""

pytestmark = pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="workers are looked up in /proc, which is Linux"
)


class Study:
    """A study in its own process group, with a checkpoint every fifth of a second."""

    def __init__(self, folder):
        self.folder = folder
        arguments = ("--preset", "smoke", "--out", str(folder), "--workers", "2", "--checkpoint-seconds", "0.2")
        self.process = subprocess.Popen(
            [sys.executable, "-c", STUDY, *arguments], cwd=ROOT, start_new_session=True, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip

    @property
    def runs(self):
        return self.process.poll() is None

    def wait_for_checkpoint(self):
        """Until a checkpoint is written that was not there before, or the study ends."""
        known, deadline = self.checkpoints(), time.monotonic() + 120.0
        while self.runs and self.checkpoints() <= known:
            assert time.monotonic() < deadline
            time.sleep(0.005)

    def checkpoints(self):
        files = set()
        for path in self.folder.glob("*.checkpoint"):
            with contextlib.suppress(FileNotFoundError):
                files.add((path.name, path.stat().st_mtime_ns))
        return files

    def workers(self):
        """Process ids of its workers."""
        pids = []
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
            pids = [int(pid) for pid in children if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
        return pids

    def strike(self, victim, rng):
        """Kill the victim: a worker, the driver, or everything. Where there is no worker, the driver."""
        workers = self.workers()
        with contextlib.suppress(ProcessLookupError):
            if victim == "worker" and workers:
                os.kill(rng.choice(workers), signal.SIGKILL)
                return
            os.killpg(self.process.pid, signal.SIGKILL) if victim == "all" else self.process.kill()
        self.process.communicate()
        deadline = time.monotonic() + 10.0
        while any(Path(f"/proc/{pid}").exists() for pid in workers):
            assert time.monotonic() < deadline, "workers outlived their driver"
            time.sleep(0.02)

    def end(self):
        out, err = self.process.communicate(timeout=300)
        return self.process.returncode, out, err


def table(path):
    """The text of a CSV file but for the times."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    times = {rows[0].index(name) for name in ("wall_time_s", "seconds") if name in rows[0]}
    return [[value for k, value in enumerate(row) if k not in times] for row in rows]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The folder of a study that ran through, and what it printed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    code, out, said = Study(folder).end()
    assert code == 0, said
    return folder, out


@pytest.mark.long
def test_a_study_ends_with_its_answer_and_files(undisturbed):
    folder, said = undisturbed
    assert "What were the first rollouts worth?" in said
    assert f"report   {folder / 'report.html'}" in said
    made = {path.name for path in folder.iterdir()}
    assert made == {
        "results.sqlite", "runs.csv", "references.csv", "study.json", "report.html",
        "heatmap.png", "pareto.png", "curves.png", "policies",
        "published_heatmap.png", "published_pareto.png",
    }  # fmt: skip
    assert (folder / "runs.csv").read_text().count("\n") == 1 + len(SMOKE.cells)


@pytest.mark.long
def test_a_finished_study_is_only_drawn_again(undisturbed):
    folder, _ = undisturbed
    database = (folder / "results.sqlite").read_bytes()
    (folder / "heatmap.png").unlink()
    code, _, said = Study(folder).end()
    assert code == 0, said
    assert (folder / "heatmap.png").exists()
    assert (folder / "results.sqlite").read_bytes() == database


@pytest.mark.long
def test_killed_six_times_and_resumed_a_study_gives_the_numbers_of_one_that_ran_through(tmp_path, undisturbed):
    struck, (unstruck, _) = tmp_path / "struck", undisturbed
    rng = np.random.default_rng(0)
    study = Study(struck)
    study.wait_for_checkpoint()
    study.strike("worker", rng)
    study.wait_for_checkpoint()
    time.sleep(2.0)
    (struck / "population_2.checkpoint.partial").write_bytes(b"a checkpoint that was never finished")
    os.killpg(study.process.pid, signal.SIGINT)
    code, out, said = study.end()
    assert code == 130
    assert "SIGKILL (out of memory?); it is started again" in out
    assert re.match(r"\nstopped; the same command goes on: python -m study.main --preset smoke --out .*\n", said)

    for victim in rng.permutation(["worker"] * 2 + ["driver"] * 2 + ["all"]):
        study = study if study.runs else Study(struck)
        if rng.random() < 0.7:
            study.wait_for_checkpoint()
        time.sleep(rng.uniform(0.0, 0.5))
        study.strike(victim, rng)

    study = study if study.runs else Study(struck)
    code, _, said = study.end()
    assert code == 0, said

    for name in ("runs.csv", "references.csv"):
        assert table(struck / name) == table(unstruck / name)
    assert not list(struck.glob("*.checkpoint*"))
