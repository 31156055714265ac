"""The command line answers at once, and refuses bad input."""

import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from study.main import main

ROOT = Path(__file__).resolve().parents[2]


def study(*arguments):
    words = [sys.executable, "-m", "study.main", *map(str, arguments)]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


def children_seconds():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_help_answers_within_half_a_second():
    """Of the processor: what else a machine does meanwhile is not ours."""
    seconds = []
    for _ in range(5):
        before = children_seconds()
        assert "quick,paper" in study("--help").stdout
        seconds.append(children_seconds() - before)
    assert min(seconds) < 0.5


@pytest.mark.parametrize(
    ("arguments", "texts"),
    [
        (["--preset", "slow"], ["unknown preset 'slow'", "quick, paper, paper-small"]),
        (["--preset", "strategies", "--strategies", "point,guess"], ["unknown strategy 'guess'", "prior, prior_range"]),
        (["--strategies", "point"], ["--strategies point: expected a preset of strategies, not quick"]),
        (["--preset", "mismatch", "--import", "runs.csv"], ["--import runs.csv: expected a preset of the paper's"]),
        (["--preset", "strategies", "--import", "cases.csv"], ["cases.csv", "a table of finished cases"]),
        (["--sedes", "3"], ["--sedes", "--help"]),
        (["--workers", "some"], ["workers", "some"]),
        (["--workers", "-1"], ["--workers -1", "0 for one a core"]),
        (["--address", "10.0.0.1:6379", "--workers", "2"], ["--workers 2", "none with --address"]),
        (["--checkpoint-seconds", "nan"], ["nan", "number of seconds >= 0"]),
        (["--device", "abacus"], ["abacus", "'cpu' always can"]),
        (["--out", "pyproject.toml"], ["pyproject.toml is a file", "choose another --out"]),
        (["--out", "tests/study"], []),
    ],
)
def test_bad_input_ends_with_a_sentence_and_code_2(arguments, texts, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    if "tests/study" in arguments:
        (tmp_path / "report.html").write_text("mine")
        arguments, texts = ["--out", str(tmp_path)], ["report.html", "choose another --out"]
    before = sorted(tmp_path.iterdir())
    try:
        code = main(arguments)
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    said = " ".join(re.sub(r"[│╭╮╰╯─]", " ", "".join(capsys.readouterr())).split())
    for text in texts:
        assert text in said
    assert sorted(tmp_path.iterdir()) == before


def test_bad_input_ends_the_process_with_code_2_and_no_traceback():
    answer = study("--preset", "slow")
    assert answer.returncode == 2 and "Traceback" not in answer.stdout + answer.stderr
