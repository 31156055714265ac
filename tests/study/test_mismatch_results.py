"""What the mismatch experiment keeps: fits, trained agents, designs and the time spent on unfinished populations."""

import dataclasses
import sqlite3

import pytest

from study.mismatch.mismatch_experiment import mismatch_results
from study.mismatch.mismatch_plan import PLANS
from study.mismatch.trial_setups import FITS, Fitted
from study.paper.presets import PRESETS
from study.paper.sweep import sweep_results
from study.trials.designs import DESIGNS, Designed
from study.trials.populations import TRAININGS, Trained
from sysid import InvalidInput

SMOKE = PLANS["mismatch-smoke"]
SWEEP = dataclasses.replace(PRESETS["smoke"], name=SMOKE.name)
MODEL = {"effects": [{"name": "delay", "T": 0.126}], "sd": [0.1, 1e-17], "unit": None}
FITTED = Fitted("delay_medium", "mended", 5, 1, {"model": MODEL, "verdict": "delay"}, 7.5)
TRAINED = Trained("0f3a", {"plain": (-1.25, -2.5), "magnet": (-0.1,)}, ((200, -3.5), (400, -2.0)), {"torch": "2"}, 9.0)
DESIGNED = Designed("magnet", "0f3a", 1, (-1.0, -2.0), 3.0)
ALL = {"fits": (FITS, FITTED), "trainings": (TRAININGS, TRAINED), "designs": (DESIGNS, DESIGNED)}


@pytest.fixture(params=ALL)
def table(request):
    return ALL[request.param]


def sibling(answer):
    """Another answer, with a key that sorts before it."""
    if isinstance(answer, Trained):
        return dataclasses.replace(answer, key="0000")
    return dataclasses.replace(answer, seed=0)


def test_what_went_in_comes_out_again_sorted(table, tmp_path):
    own, answer = table
    with mismatch_results(tmp_path, SMOKE) as results:
        assert results.all(own) == []
        results.add(own, [answer, sibling(answer)])
    with mismatch_results(tmp_path, SMOKE) as results:
        assert results.all(own) == [sibling(answer), answer]


def test_a_second_answer_takes_the_place_of_the_first(table, tmp_path):
    own, answer = table
    second = dataclasses.replace(answer, seconds=0.5)
    with mismatch_results(tmp_path, SMOKE) as results:
        results.add(own, [answer, sibling(answer)])
        results.add(own, [second])
        assert results.all(own) == [sibling(answer), second]


def test_answers_are_kept_all_or_none(table, tmp_path):
    own, answer = table
    broken = dataclasses.replace(sibling(answer), seconds=object())
    with mismatch_results(tmp_path, SMOKE) as results:
        with pytest.raises(sqlite3.Error):
            results.add(own, [answer, broken])
        assert results.all(own) == []


@pytest.mark.parametrize("field", ["plant", "strategy", "n", "seed"])
def test_every_rollout_of_every_strategy_has_its_own_fit(field, tmp_path):
    other = dataclasses.replace(FITTED, **{field: 0 if field in ("n", "seed") else "another"})
    with mismatch_results(tmp_path, SMOKE) as results:
        results.add(FITS, [FITTED, other])
        assert results.all(FITS) == sorted([other, FITTED], key=lambda fit: fit.trial)


def test_a_finished_population_has_no_progress_left(tmp_path):
    with mismatch_results(tmp_path, SMOKE) as results:
        assert results.training_seconds("first") == 0.0
        results.note_training("first", 12.5)
        results.note_training("first", 25.0)
        results.note_training("second", 3.0)
        assert results.training_seconds("first") == 25.0
        results.add(TRAININGS, [TRAINED], ["first"])
        assert results.training_seconds("first") == 0.0
        assert results.training_seconds("second") == 3.0


def test_the_folder_of_another_kind_is_refused(tmp_path):
    mismatch_results(tmp_path / "mismatch", SMOKE).close()
    with pytest.raises(InvalidInput, match="format 'mismatch 2', expected '2'"):
        sweep_results(tmp_path / "mismatch", SWEEP)
    sweep_results(tmp_path / "study", SWEEP).close()
    with pytest.raises(InvalidInput, match="format '2', expected 'mismatch 2'"):
        mismatch_results(tmp_path / "study", SMOKE)
