"""Presets: what the issue asks for, and a partition that depends on nothing else."""

import dataclasses

import pytest

from study.config import PAPER, PRESETS, QUICK


def test_quick_and_paper_are_the_grids_of_the_paper():
    assert (QUICK.budgets, QUICK.widths, QUICK.seeds) == ((0, 5, 50), (0.0, 0.5), (0, 1, 2))
    assert (QUICK.hidden, QUICK.steps) == ((64, 64), 30_000)
    assert PAPER.budgets == (0, 5, 10, 25, 50)
    assert PAPER.widths == (0.0, 0.1, 0.2, 0.3, 0.5)
    assert (PAPER.seeds, PAPER.hidden, PAPER.steps) == (tuple(range(10)), (256, 256), 75_000)
    for preset in (QUICK, PAPER):
        assert (preset.truth, preset.prior, preset.sigma, preset.episodes) == ((2.0, 1.5), (1.0, 1.0), 1.0, 20)


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_populations_hold_every_run_once(preset):
    together = [cell for population in preset.populations for cell in population]
    assert sorted(together) == sorted(set(together))
    assert set(together) == {(n, w, s) for n in preset.budgets for w in preset.widths for s in preset.seeds}
    assert max(map(len, preset.populations)) <= preset.population


def test_two_cores_share_quick_evenly_and_a_population_of_paper_is_a_whole_grid():
    assert [len(p) for p in QUICK.populations] == [9, 9]
    assert all(len({cell.seed for cell in p}) == 1 for p in PAPER.populations)


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(QUICK)])
def test_every_setting_changes_the_fingerprint(field):
    value = getattr(QUICK, field)
    other = value + "x" if isinstance(value, str) else value[:-1] if isinstance(value, tuple) else value + 1
    assert dataclasses.replace(QUICK, **{field: other}).fingerprint != QUICK.fingerprint
    assert dataclasses.replace(QUICK).fingerprint == QUICK.fingerprint
