"""Presets: what the issue asks for, and a partition that depends on nothing else."""

import dataclasses
from collections import Counter

import pytest

from study.paper.presets import PAPER, PAPER_PRESETS, QUICK, Cell
from study.paper.published_numbers import CELLS, Spot


@pytest.mark.parametrize("size", ["", "-small"])
def test_paper_and_robustness_are_the_published_cells_and_plants(size):
    presets = [PAPER_PRESETS[f"{name}{size}"] for name in ("paper", "robustness")]
    cells = Counter(Spot(*cell[:3]) for preset in presets for cell in preset.cells)
    assert cells == {spot: cell.seeds for spot, cell in CELLS.items()}
    truths, sigmas = {"small_gap": (1.5, 1.2), "large_gap": (2.5, 2.0)}, {"low_noise": 0.5, "high_noise": 2.0}
    for point in (point for preset in presets for point in preset.points):
        conditions = point.truth, point.prior, point.sigma
        assert conditions == (truths.get(point.name, (2.0, 1.5)), (1.0, 1.0), sigmas.get(point.name, 1.0))
    assert presets[1].companion == presets[0].name


@pytest.mark.parametrize("preset", PAPER_PRESETS.values(), ids=PAPER_PRESETS)
@pytest.mark.parametrize("device", ["cpu", "cuda:1"])
def test_populations_hold_every_run_once(preset, device):
    together = [cell for population in preset.populations(device) for cell in population]
    assert together == list(preset.cells)
    assert len(set(together)) == len(together)
    assert set(together) == {
        Cell(p.name, n, w, s) for p in preset.points for n in p.budgets for w in p.widths for s in p.seeds
    }
    sizes = set(map(len, preset.populations(device)))
    assert max(sizes) <= preset.population if device == "cpu" else sizes == {len(preset.cells)}


@pytest.mark.parametrize("preset", PAPER_PRESETS.values(), ids=PAPER_PRESETS)
def test_a_population_ends_within_25_minutes_on_a_core(preset):
    seconds_a_step = 4e-3 if preset.hidden == (256, 256) else 0.6e-3
    assert seconds_a_step * preset.steps * preset.population <= 25 * 60.0


def test_two_cores_share_quick_evenly_and_the_first_populations_of_paper_are_the_column_w_0():
    assert [len(p) for p in QUICK.populations()] == [9, 9]
    assert all(cell.w == 0.0 for p in PAPER.populations()[:10] for cell in p)


CHANGES = {str: lambda v: v + "x", int: lambda v: v + 1, float: lambda v: v + 1.0, tuple: lambda v: v[:-1]}


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(QUICK)])
def test_every_setting_changes_the_fingerprint(field):
    value = getattr(QUICK, field)
    other = "paper" if value is None else CHANGES[type(value)](value)
    assert dataclasses.replace(QUICK, **{field: other}).fingerprint != QUICK.fingerprint
    assert dataclasses.replace(QUICK).fingerprint == QUICK.fingerprint


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(QUICK.points[0])])
def test_every_property_of_a_point_changes_the_fingerprint(field):
    (point,) = QUICK.points
    value = getattr(point, field)
    changed = dataclasses.replace(point, **{field: CHANGES[type(value)](value)})
    assert dataclasses.replace(QUICK, points=(changed,)).fingerprint != QUICK.fingerprint
