"""Presets: what the issue asks for, and a partition that depends on nothing else."""

import dataclasses

import pytest

from study.paper.presets import PAPER, PRESETS, QUICK, Cell


def grid(preset, name="main"):
    point = preset.point(name)
    return point.budgets, point.widths, len(point.seeds)


def test_quick_and_paper_are_the_grids_of_the_paper():
    assert grid(QUICK) == ((0, 5, 50), (0.0, 0.5), 3)
    assert (QUICK.hidden, QUICK.steps) == ((64, 64), 30_000)
    assert (PAPER.hidden, PAPER.steps) == ((256, 256), 75_000)
    for preset in (PAPER, PRESETS["paper-small"]):
        assert grid(preset) == ((0, 5, 10, 25, 50), (0.0, 0.1, 0.2, 0.3, 0.5), 10)
    for preset in (QUICK, PAPER):
        (point,) = preset.points
        assert (point.truth, point.prior, point.sigma, preset.episodes) == ((2.0, 1.5), (1.0, 1.0), 1.0, 20)


@pytest.mark.parametrize("name", ["robustness", "robustness-small"])
def test_robustness_is_the_papers_table_and_its_prior_range(name):
    preset = PRESETS[name]
    for gap, truth in (("small_gap", (1.5, 1.2)), ("large_gap", (2.5, 2.0))):
        assert grid(preset, gap) == ((0, 10, 50), (0.0, 0.2, 0.5), 5)
        assert preset.point(gap).truth == truth
    for noise, sigma in (("low_noise", 0.5), ("high_noise", 2.0)):
        assert grid(preset, noise) == ((0, 5, 10, 25, 50), (0.0, 0.5), 5)
        assert preset.point(noise).sigma == sigma
    assert grid(preset, "prior_range") == ((0,), (0.5,), 10)
    assert preset.companion in PRESETS
    assert len(preset.cells) == 200


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
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


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
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
