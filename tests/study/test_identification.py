"""Identification: the paper's estimates, and the same rollouts for every identifier."""

import dataclasses
import math

import pytest

from study.paper.presets import PAPER, Point
from study.paper.sweep import identification_task, identify
from sysid import InvalidInput

(MAIN,) = PAPER.points


def test_without_rollouts_there_is_the_prior():
    assert identify(MAIN, 0, 3) == MAIN.prior


def error(seeds, **changes):
    """The distances of so many estimates from the truth together, after two rollouts each."""
    point = dataclasses.replace(MAIN, **changes)
    return sum(math.dist(identify(point, 2, seed), point.truth) for seed in range(seeds))


@pytest.mark.long
def test_least_squares_and_the_kalman_filter_come_closer_than_the_grid_from_the_same_rollouts():
    grid, *others = (error(3, identifier=name) for name in ("grid", "least_squares", "unscented"))
    assert 4.0 * max(others) < grid


def test_a_noisier_sensor_makes_a_worse_estimate():
    quiet, loud = (error(4, identifier="least_squares", sigma=sigma) for sigma in (0.1, 1.0))
    assert quiet < loud


def test_a_task_estimates_every_budget_of_its_seed():
    point = Point("other", (0, 1, 2), (0.0,), (7,), truth=(1.5, 1.2))
    shares = []

    class Silent:
        progress = staticmethod(shares.append)

    estimates = identification_task(point, 7).run(Silent())
    assert [e[:4] for e in estimates] == [("other", n, 7, identify(point, n, 7)) for n in (0, 1, 2)]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_an_unknown_identifier_is_refused():
    with pytest.raises(InvalidInput, match="'oracle': expected one of grid, least_squares, unscented"):
        identify(dataclasses.replace(MAIN, identifier="oracle"), 1, 0)
