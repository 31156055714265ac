"""The command line: answers at once, refuses bad input, and leaves an answer that can be looked up."""

import csv
import json
import re
import resource
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from study.main import main
from study.paper.presets import SMOKE
from sysid.version import installed_version

ROOT = Path(__file__).resolve().parents[2]


def command(*arguments):
    return [sys.executable, "-m", "study.main", *map(str, arguments)]


def study(*arguments, timeout=120):
    return subprocess.run(command(*arguments), cwd=ROOT, capture_output=True, text=True, timeout=timeout, check=False)


def children_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def rows(folder):
    with (folder / "runs.csv").open() as file:
        return [{k: v for k, v in row.items() if k != "wall_time_s"} for row in csv.DictReader(file)]


def test_help_answers_within_half_a_second():
    """Of the processor: what else a machine does meanwhile is not ours."""
    seconds = []
    for _ in range(5):
        before = children_seconds()
        assert "quick,paper" in study("--help").stdout
        seconds.append(children_seconds() - before)
    assert min(seconds) < 0.5


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--preset", "slow"], ["unknown preset 'slow'", "quick, paper, paper-small"]),
        (["--preset", "strategies", "--strategies", "point,guess"], ["unknown strategy 'guess'", "prior, prior_range"]),
        (["--strategies", "point"], ["--strategies point: expected a preset of strategies, not quick"]),
        (["--preset", "mismatch", "--import", "runs.csv"], ["--import runs.csv: expected a preset of the paper's"]),
        (["--preset", "strategies", "--import", "cases.csv"], ["cases.csv", "a table of finished cases"]),
        (["--sedes", "3"], ["unknown option '--sedes'", "--preset, --strategies"]),
        (["--workers", "some"], ["workers", "some"]),
        (["--workers", "-1"], ["--workers -1", "0 for one a core"]),
        (["--address", "10.0.0.1:6379", "--workers", "2"], ["--workers 2", "none with --address"]),
        (["--checkpoint-seconds", "nan"], ["nan", "number of seconds >= 0"]),
        (["--device", "abacus"], ["abacus", "'cpu' always can"]),
        (["--out", "pyproject.toml"], ["pyproject.toml is a file", "choose another --out"]),
        (["--out", "tests/study"], []),
    ],
)
def test_bad_input_ends_with_a_sentence_and_code_2(arguments, told, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    if "tests/study" in arguments:
        (tmp_path / "report.html").write_text("mine")
        arguments, told = ["--out", str(tmp_path)], ["report.html", "choose another --out"]
    before = sorted(tmp_path.iterdir())
    try:
        code = main(arguments)
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    said = " ".join(re.sub(r"[│╭╮╰╯─]", " ", "".join(capsys.readouterr())).split())
    for text in told:
        assert text in said
    assert sorted(tmp_path.iterdir()) == before


def test_bad_input_ends_the_process_with_code_2_and_no_traceback():
    answer = study("--preset", "slow")
    assert answer.returncode == 2 and "Traceback" not in answer.stdout + answer.stderr


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    answer = study("--preset", "smoke", "--out", folder)
    assert answer.returncode == 0, answer.stderr
    return folder, answer.stdout


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
    assert len(rows(folder)) == len(SMOKE.cells)


@pytest.mark.long
def test_a_finished_study_is_only_drawn_again(undisturbed):
    folder, _ = undisturbed
    database = (folder / "results.sqlite").read_bytes()
    (folder / "heatmap.png").unlink()
    assert study("--preset", "smoke", "--out", folder).returncode == 0
    assert (folder / "heatmap.png").exists()
    assert (folder / "results.sqlite").read_bytes() == database


def test_study_json_says_what_the_tables_depend_on(undisturbed):
    folder, _ = undisturbed
    record = json.loads((folder / "study.json").read_text())
    assert record["runs"] == len(SMOKE.cells) and record["fingerprint"] == SMOKE.fingerprint
    assert record["versions"]["gapfinder"] == installed_version("gapfinder") and record["worker_hours"] > 0.0


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
