"""Whatever became of the results of a study, they are read, or refused in one sentence."""

import sqlite3
from collections import defaultdict
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from study.paper.finished_runs import RUNS, read_import, taken_up
from study.paper.presets import PAPER_PRESETS
from study.paper.sweep import Sweep, sweep_results
from tests.hostile_input.answering import CELLS, ESC, answered, many

RESULTS = Path(__file__).parents[2] / "study" / "results"

KNOWN = "'main', 0, 0.0, 0, 1, 1, 0, -1, 0, -1, 1"
"""The cell and the numbers of a run."""
STATEMENTS = {
    "no table": "DROP TABLE runs",
    "another table": "DROP TABLE runs; CREATE TABLE runs (a)",
    "a view": "DROP TABLE runs; CREATE VIEW runs AS SELECT 1",
    "another meta": "DROP TABLE meta; CREATE TABLE meta (a)",
    "settings of nothing": "UPDATE meta SET value = '[1' WHERE key IN ('settings', 'fingerprint')",
    "settings of a list": "UPDATE meta SET value = '[1]' WHERE key IN ('settings', 'fingerprint')",
    "another preset": f"UPDATE meta SET value = '{ESC}{'x' * 10**5}' WHERE key = 'preset'",
    "text for numbers": "INSERT INTO estimates VALUES ('main', 'a', 'b', 'c', 'd', 'e')",
    "nothing in a run": "INSERT INTO runs (point, n, w, seed) VALUES ('main', 0, 0.0, 0)",
    "no JSON in a run": f"INSERT INTO runs VALUES ({KNOWN}, 'a', 'b', 'c', 'd', 'e', '')",
    "other JSON in a run": f"INSERT INTO runs VALUES ({KNOWN}, '[\"a\"]', '[[1]]', '3', '3', '{{}}', '')",
}


def imported(path, preset):
    return taken_up(read_import(path, preset), preset, defaultdict(lambda: (1.0, 1.0)))


def opened(path):
    with sweep_results(path, PAPER_PRESETS["smoke"]) as results:
        assert results.all(RUNS) is not None and Sweep(PAPER_PRESETS["smoke"], results).estimates() is not None


@pytest.mark.parametrize("statements", STATEMENTS.values(), ids=STATEMENTS.keys())
def test_results_of_another_kind_are_refused(statements, tmp_path):
    opened(tmp_path)
    with sqlite3.connect(tmp_path / "results.sqlite") as db:
        db.executescript(statements)
    db.close()
    assert not answered(opened, tmp_path)


@pytest.mark.parametrize("size", [1, 100, 5000, 30000])
def test_results_that_were_cut_short_are_refused(size, tmp_path):
    opened(tmp_path)
    content = (tmp_path / "results.sqlite").read_bytes()
    (tmp_path / "results.sqlite").write_bytes(content[:size])
    assert not answered(opened, tmp_path)


ROWS = (RESULTS / "paper-small" / "runs.csv").read_text().splitlines()[:3]


@many
@given(cells=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 9), CELLS), max_size=4), cut=st.integers(0, 900))
@example(cells=[(1, 2, "x" * 200_000)], cut=0)
@example(cells=[(1, 1, "9" * 5000)], cut=0)
def test_any_cell_in_a_table_of_runs_is_refused_or_read(tmp_path_factory, cells, cut):
    rows = [line.split(",") for line in ROWS]
    for row, column, cell in cells:
        rows[row][column] = cell
    path = tmp_path_factory.getbasetemp() / "runs.csv"
    text = "\n".join(map(",".join, rows)).encode(errors="surrogatepass")
    path.write_bytes(text[: len(text) - cut])
    answered(imported, path, PAPER_PRESETS["paper-small"])
