"""What the hidden plant allows, and what an estimate allows: reference controllers on the study's start states.

    gap of a cell      = J(optimal | truth) - J(agent)
    identification     = J(optimal | truth) - J(optimal | theta_hat)      what a wrong estimate costs a perfect designer
    training           = J(optimal | theta_hat) - J(agent)                what learning and the width of the band cost

J is the mean return on the hidden plant; (controller | theta) was designed on the model at theta and never saw the
plant. The two parts add up to the gap, seed by seed. The second is negative where an agent is more robust against the
error of its estimate than a controller that trusts it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from policies.control.dynamic_programming import Grid, solve
from policies.control.lqr import design_lqr
from policies.control.swing_up import design_swing_up
from policies.evaluation import Policy, evaluate, fresh_start_states, start_states
from study.paper.presets import Estimates, Preset, Theta
from study.paper.protocol import paper_model
from study.pipeline.executor import BriefTask
from study.pipeline.settings import versions
from study.pipeline.tables import ResultTable
from sysid.physics.ops import Array

OPTIMAL, LQR, SWING_UP = "optimal", "lqr", "swing_up_lqr"
CONTROLLERS = (OPTIMAL, LQR, SWING_UP)


@dataclass(frozen=True)
class Reference:
    """The mean returns on the hidden plant at truth of a controller designed at theta, from a seed's start states and,
    fresh, from states that no two seeds share; with what made it."""

    controller: str
    theta: Theta
    truth: Theta
    seed: int
    return_mean: float
    fresh_mean: float
    versions: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def key(self) -> tuple[str, float, float, float, float]:
        """What was run on which plant, whatever the seed."""
        return self.controller, *self.theta, *self.truth


REFERENCES = ResultTable(
    "controllers",
    Reference,
    "controller TEXT, m REAL, l REAL, truth_m REAL, truth_l REAL, seed INTEGER, return_mean REAL, fresh_mean REAL, "
    "versions TEXT, seconds REAL",
    keys=6,
)


def referred(
    preset: Preset, controller: str, theta: Theta, truths: Sequence[Theta], progress: Callable[[float], None]
) -> list[Reference]:
    """Design a controller at theta and run it on hidden plants from both start states of all seeds in question."""
    begin = time.monotonic()
    policy = reference_controller(controller, theta, preset.grid)
    seeds = sorted({*preset.seeds, *preset.reference_seeds})
    starts = [tuple(_starts(drawn, seeds, preset)) for drawn in (start_states, fresh_start_states)]
    rows = {truth: [evaluate(policy, paper_model(*truth), *states).returns for states in starts] for truth in truths}
    seconds, made_with = (time.monotonic() - begin) / (len(seeds) * len(rows)), versions()
    return [
        Reference(controller, theta, truth, seed, *means, made_with, seconds)
        for truth, returns in rows.items()
        for seed, *means in zip(seeds, *np.reshape(returns, (2, len(seeds), -1)).mean(axis=2).tolist(), strict=True)
    ]


def reference_controller(controller: str, theta: Theta, grid: int) -> Policy:
    """The controller for the machine at theta, the optimal one on a table of so many angles."""
    model = paper_model(*theta)
    if controller == LQR:
        return design_lqr(model)
    return design_swing_up(model) if controller == SWING_UP else solve(model, Grid(grid, grid + 1))


def _starts(drawn: Callable[[int, int], tuple[Array, Array]], seeds: Sequence[int], preset: Preset) -> Iterator[Array]:
    """Start states theta and theta_dot of all episodes of these seeds."""
    return map(np.concatenate, zip(*(drawn(seed, preset.episodes) for seed in seeds), strict=True))


def reference_tasks(preset: Preset, estimates: Estimates, known: Set[tuple[Any, ...]]) -> Iterator[BriefTask]:
    """All controllers at every truth, and the optimal one at every estimate, on the plant that this was measured on.

    What is asked of one (controller, theta) is designed once; what is `known`, by `Reference.key`, is left out.
    """
    wanted = [(controller, point.truth, point.truth) for point in preset.points for controller in CONTROLLERS]
    wanted += sorted((OPTIMAL, theta, preset.point(name).truth) for (name, _, _), theta in estimates.items())
    missing: dict[tuple[str, Theta], list[Theta]] = {}
    for controller, theta, truth in dict.fromkeys(wanted):
        if (controller, *theta, *truth) not in known:
            missing.setdefault((controller, theta), []).append(truth)
    for (controller, theta), truths in missing.items():
        name = f"{controller} at m = {theta[0]:.12g}, l = {theta[1]:.12g}"
        work = 2.0 + (3e-5 * preset.grid**2 if controller == OPTIMAL else 0.0)
        yield BriefTask(name, "references", work, REFERENCES, referred, (preset, controller, theta, truths))
