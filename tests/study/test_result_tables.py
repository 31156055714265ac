"""What results folders keep: every kind of row, sorted by its keys, all of an answer or none of it."""

import dataclasses
import sqlite3

import pytest

from study.mismatch.mismatch_plan import MISMATCH_PLANS
from study.paper.finished_runs import RUNS, Run
from study.paper.presets import PAPER_PRESETS, Cell
from study.paper.reference_controllers import REFERENCES, Reference
from study.paper.sweep import ESTIMATES, Estimated, sweep_results
from study.strategies.designs import DESIGNS, Designed
from study.strategies.populations import TRAININGS, Trained
from study.strategies.session import STEPS, CaseRound
from study.strategies.trial_experiment import trial_results
from study.strategies.trial_plan import Case
from sysid import InvalidInput

MISMATCH = MISMATCH_PLANS["mismatch-smoke"]
SWEEP = dataclasses.replace(PAPER_PRESETS["smoke"], name=MISMATCH.name)
CURVE, SETTINGS = ((200, -3.5),), {"sac": {"steps": 1}}
MODEL = {"effects": [{"name": "delay", "T": 0.126}], "sd": [0.1, 1e-17], "unit": None}
ROUND = CaseRound(Case("delay_medium", "encoder", "mended", 5, 1), 0, {"model": MODEL, "verdict": "delay"}, 7.5)
TRAINED = Trained("0f3a", {"plain": (-1.25, -2.5), "magnet": (-0.1,)}, {"torch": "2"}, 9.0)
EPISODES = (-1.25, -2.5), (-3.0,)
RUN = Run(
    Cell("main", 5, 0.5, 1), (1.785, 1.65), 0.26, -1.875, 0.625, -3.0, 7.5, *EPISODES, CURVE, SETTINGS, {"torch": "2"}
)
REFERENCE = Reference("lqr", (2.1, 1.5), (2.0, 1.5), 1, -1.0, -2.0, {"numpy": "2"}, 3.0)
ROWS = {
    "steps": (STEPS, ROUND, {"case": ROUND.case._replace(seed=0)}),
    "trainings": (TRAININGS, TRAINED, {"key": "0000"}),
    "designs": (DESIGNS, Designed("magnet", "0f3a", 1, (-1.0, -2.0), 3.0), {"seed": 0}),
    "estimates": (ESTIMATES, Estimated("main", 5, 1, (1.785, 1.65), 0.5), {"seed": 0}),
    "runs": (RUNS, RUN, {"cell": RUN.cell._replace(seed=0)}),
    "references": (REFERENCES, REFERENCE, {"seed": 0}),
}
"""Of each table a row, and what makes another one of it that sorts before it."""


def changed(row, **fields):
    return row._replace(**fields) if hasattr(row, "_replace") else dataclasses.replace(row, **fields)


@pytest.fixture(params=ROWS)
def table(request):
    kind, row, first = ROWS[request.param]
    return kind, row, changed(row, **first)


def opened(folder, kind):
    if kind in (STEPS, TRAININGS, DESIGNS):
        return trial_results(folder, MISMATCH)
    return sweep_results(folder, SWEEP)


def test_what_went_in_comes_out_again_sorted(table, tmp_path):
    kind, row, first = table
    with opened(tmp_path, kind) as results:
        assert results.all(kind) == []
        results.add(kind, [row, first])
    with opened(tmp_path, kind) as results:
        assert results.all(kind) == [first, row]
        assert len(results.keys(kind)) == 2


def test_a_second_answer_leaves_the_first_in_place(table, tmp_path):
    """A run that was taken up from elsewhere stays, though its population trains it too."""
    kind, row, first = table
    with opened(tmp_path, kind) as results:
        results.add(kind, [row])
        results.add(kind, [first, changed(row, seconds=0.25)])
        assert results.all(kind) == [first, row]


def test_answers_are_kept_all_or_none(table, tmp_path):
    kind, row, first = table
    with opened(tmp_path, kind) as results:
        with pytest.raises(sqlite3.Error):
            results.add(kind, [row, changed(first, seconds=object())])
        assert results.all(kind) == []


@pytest.mark.parametrize("field", ["plant", "sensing", "strategy", "n", "seed"])
def test_every_case_has_its_own_rounds(field, tmp_path):
    other = dataclasses.replace(ROUND, case=ROUND.case._replace(**{field: 0 if field in ("n", "seed") else "another"}))
    with trial_results(tmp_path, MISMATCH) as results:
        results.add(STEPS, [ROUND, other])
        assert results.all(STEPS) == sorted([other, ROUND], key=lambda step: step.case)


def test_the_folder_of_another_kind_is_refused(tmp_path):
    trial_results(tmp_path / "mismatch", MISMATCH).close()
    with pytest.raises(InvalidInput, match="format 'mismatch 5', expected '5'"):
        sweep_results(tmp_path / "mismatch", SWEEP)
    sweep_results(tmp_path / "study", SWEEP).close()
    with pytest.raises(InvalidInput, match="format '5', expected 'mismatch 5'"):
        trial_results(tmp_path / "study", MISMATCH)


def test_a_folder_that_lacks_a_table_is_refused(tmp_path):
    with sweep_results(tmp_path, SWEEP) as results:
        results.db.execute("DROP TABLE estimates")
    with pytest.raises(InvalidInput, match="no table estimates"):
        sweep_results(tmp_path, SWEEP)


def test_a_cell_of_another_kind_is_refused():
    row = RUNS.row(RUN)
    assert RUNS.value(row) == RUN
    for cells in ([row[0], 5.5, *row[2:]], [None, *row[1:]]):
        with pytest.raises((ValueError, TypeError)):
            RUNS.value(cells)
