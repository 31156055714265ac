"""Grid searches by sums: they are the product's, and what they scatter by is what theory says."""

import numpy as np
import pytest

from study.paper.identification_scatter import OneStepGrid, Transitions, noise_free_rollouts, scatter
from study.paper.protocol import ROLLOUT_LENGTH as LENGTH
from study.paper.protocol import paper_model, paper_rollouts, transitions
from sysid import GridSearch


@pytest.mark.parametrize("sigma", [0.0, 0.5, 1.0, 2.0])
def test_it_finds_the_cell_that_grid_search_finds(sigma):
    grid = OneStepGrid()
    for seed, n in enumerate((1, 1, 2, 2, 5, 5, 10)):
        rollouts = paper_rollouts(paper_model(2.0, 1.5), n, np.random.default_rng(seed), sigma=sigma)
        columns = [(r.before, r.after, np.sin(r.theta[:LENGTH]), r.u) for r in rollouts]
        samples = Transitions(*(np.concatenate(column) for column in zip(*columns, strict=True)))
        expected = GridSearch().fit(paper_model(), transitions(rollouts)).values
        assert grid.search(samples, [n * LENGTH])[0] == pytest.approx([expected["m"], expected["l"]])


def test_a_budget_is_a_prefix_of_a_larger_one():
    grid, (moved, noise) = OneStepGrid(), noise_free_rollouts((2.0, 1.5), 10, np.random.default_rng(0))
    samples = moved.read(noise)
    first = Transitions(*(x[: 4 * LENGTH] for x in (samples.before, samples.after, samples.sine, samples.u)))
    assert np.array_equal(grid.search(samples, [4 * LENGTH, 10 * LENGTH])[0], grid.search(first, [4 * LENGTH])[0])


def test_without_noise_the_nearest_cells_are_found():
    moved, _ = noise_free_rollouts((2.01, 1.515), 5, np.random.default_rng(1))
    estimates = OneStepGrid().search(moved, [5 * LENGTH])
    assert estimates[0] == pytest.approx([2.01, 1.515])


def test_clean_inputs_leave_the_noise_of_a_step_as_large_as_it_was():
    moved, noise = noise_free_rollouts((2.0, 1.5), 50, np.random.default_rng(2))
    errors = [s.after - s.before - (moved.after - moved.before) for s in
              (moved.read(1.5 * noise), moved.read(1.5 * noise, clean_inputs=True))]  # fmt: skip
    assert np.array_equal(moved.read(1.5 * noise, clean_inputs=True).before, moved.before)
    assert errors[1] == pytest.approx(errors[0])
    assert np.std(errors[0]) == pytest.approx(1.5 * 2**0.5, rel=0.02)


def test_where_the_box_is_far_away_the_error_falls_as_one_over_the_root_of_n():
    measured = scatter(np.random.default_rng(3), seeds=60, budgets=(5, 10, 25, 50), sigmas=(0.1,))
    p, low, high = measured.exponent(0.1, 5, 50, np.random.default_rng(0))
    assert low < -0.43
    assert high > -0.5
    assert low < p < high
    assert measured.at_bound(0.1, 50) == 0.0


def test_at_the_papers_noise_it_does_not():
    measured = scatter(np.random.default_rng(4), seeds=60, budgets=(5, 10, 25, 50), sigmas=(1.0,))
    assert measured.exponent(1.0, 5, 50, np.random.default_rng(0))[1] > -0.4
    assert measured.at_bound(1.0, 5) > 0.2
