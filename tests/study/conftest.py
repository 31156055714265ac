"""A finished study of invented numbers, whose answer is known beforehand."""

import dataclasses
import math

import numpy as np
import pytest

from study.paper.finished_runs import Run
from study.paper.presets import QUICK
from study.paper.reference_controllers import LQR, OPTIMAL, SWING_UP, Reference
from study.paper.sweep_findings import PointFindings

OPTIMUM, ESTIMATE_COST, WIDTH_COST, LEARNING_COST = -330.0, {0: 500.0, 5: 80.0, 50: 2.0}, 180.0, 4.0
ESTIMATES = {0: (1.0, 1.0), 5: (3.0, 1.3), 50: (2.1, 1.5)}


def study(point=QUICK.points[0], start_effect=20.0):
    """The answer of a point: J = optimum - cost of the estimate - cost of width and learning + worth of the starts."""
    preset = dataclasses.replace(QUICK, points=(point,))
    starts = {seed: start_effect * np.sin(1.0 + seed) for seed in preset.reference_seeds}

    def episodes(mean, seed):
        return tuple(mean + starts[seed] + 30.0 * np.cos(np.arange(20) * math.pi / 10.0))

    def run(cell):
        mean = OPTIMUM - ESTIMATE_COST[cell.n] - LEARNING_COST - WIDTH_COST * (cell.w > 0)
        episode_returns, fresh = (episodes(value, cell.seed) for value in (mean, -400.0))
        theta, reached = ESTIMATES[cell.n], (np.mean(episode_returns), np.std(episode_returns), np.mean(fresh))
        curve = tuple((200 * (k + 1), -1000.0 / (k + 1)) for k in range(23))
        settings = {"sac": {"steps": preset.steps, "polyak": 0.005}}
        error = math.dist(theta, point.truth)
        return Run(
            cell, theta, error, *map(float, reached), 60.0, episode_returns, fresh, curve, settings, {"torch": "2.x"}
        )

    runs = [run(cell) for cell in preset.cells]
    returns = {(OPTIMAL, point.truth): OPTIMUM, (LQR, point.truth): -960.0, (SWING_UP, point.truth): -335.0}
    returns |= {(OPTIMAL, theta): OPTIMUM - ESTIMATE_COST[n] for n, theta in ESTIMATES.items()}
    references = [
        Reference(
            controller, theta, point.truth, seed, float(np.mean(episodes(mean, seed))), mean, {"numpy": "2.x"}, 5.0
        )
        for (controller, theta), mean in returns.items()
        for seed in starts
    ]
    return PointFindings(preset, point, runs, references)


@pytest.fixture(scope="session")
def answer():
    return study()


@pytest.fixture(scope="session", params=["one seed", "one width", "one budget", "one cell", "no n = 0"])
def small_answer(request):
    one = {"one seed": "seeds", "one width": "widths", "one budget": "budgets"}
    fields = [one[request.param]] if request.param in one else list(one.values())
    point = QUICK.points[0]
    if request.param == "no n = 0":
        return study(dataclasses.replace(point, budgets=point.budgets[1:]))
    return study(dataclasses.replace(point, **{name: getattr(point, name)[:1] for name in fields}))
