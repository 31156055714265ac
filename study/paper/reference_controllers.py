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
from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from policies.evaluation import Policy, evaluate, fresh_start_states, start_states
from study.paper.presets import Preset, Theta
from study.paper.protocol import paper_model
from study.paper.runs import hidden_plant
from study.pipeline.executor import Brief, Link
from study.pipeline.tables import ResultTable
from study.pipeline.versions import versions

OPTIMAL, LQR, SWING_UP = "optimal", "lqr", "swing_up_lqr"
CONTROLLERS = (OPTIMAL, LQR, SWING_UP)


Designs = dict[Theta, set[Theta]]
"""The truths that an optimal controller designed at each theta is run on."""


@dataclass(frozen=True)
class Reference:
    """Returns (E,) on the hidden plant `truth`, from a seed's start states, of a controller designed at theta."""

    controller: str
    theta: Theta
    truth: Theta
    seed: int
    returns: tuple[float, ...]
    versions: dict[str, str]
    seconds: float

    @property
    def mean(self) -> float:
        return float(np.mean(self.returns))


@dataclass(frozen=True)
class Rating:
    """The mean return on the hidden plant (truth_m, truth_l), from a seed's start states, of a controller designed at
    (m, l) on a table of so many angles."""

    controller: str
    m: float
    l: float  # noqa: E741
    truth_m: float
    truth_l: float
    seed: int
    return_mean: float
    grid: int
    episodes: int


RATINGS = "ratings.csv"
"""The table of references, seed by seed."""
REFERENCES = ResultTable(
    "controllers",
    Reference,
    "controller TEXT, m REAL, l REAL, truth_m REAL, truth_l REAL, seed INTEGER, returns TEXT, versions TEXT, "
    "seconds REAL",
    keys=6,
)


@dataclass(frozen=True)
class ReferenceTask(Brief):
    """Design a controller at theta and run it on hidden plants from the start states of all seeds in question."""

    preset: Preset
    controller: str
    theta: Theta
    truths: tuple[Theta, ...]
    activity: ClassVar[str] = "references"
    table: ClassVar[Any] = REFERENCES

    @property
    def name(self) -> str:
        return f"{self.controller} at m = {self.theta[0]:.12g}, l = {self.theta[1]:.12g}"

    @property
    def work(self) -> float:
        return 2.0 + (3e-5 * self.preset.grid**2 if self.controller == OPTIMAL else 0.0)

    def run(self, link: Link) -> list[Reference]:
        begin = time.monotonic()
        policy = self.design()
        seeds = sorted({*self.preset.seeds, *self.preset.reference_seeds})
        starts = [start_states(seed, self.preset.episodes) for seed in seeds]
        theta, theta_dot = (np.concatenate(column) for column in zip(*starts, strict=True))
        rows = {truth: evaluate(policy, hidden_plant(truth), theta, theta_dot).returns for truth in self.truths}
        seconds, found = (time.monotonic() - begin) / (len(seeds) * len(rows)), versions()
        return [
            Reference(self.controller, self.theta, truth, seed, tuple(row), found, seconds)
            for truth, returns in rows.items()
            for seed, row in zip(seeds, returns.reshape(len(seeds), -1).tolist(), strict=True)
        ]

    def design(self) -> Policy:
        """The controller for the machine at theta."""
        m, l = self.theta  # noqa: E741
        model = paper_model(m, l)
        if self.controller == LQR:
            from policies.control.lqr import design_lqr

            return design_lqr(model)
        if self.controller == SWING_UP:
            from policies.control.swing_up import design_swing_up

            return design_swing_up(model)
        from policies.control.dynamic_programming import Grid, solve

        return solve(model, Grid(self.preset.grid, self.preset.grid + 1))


def fresh_optimum(preset: Preset, truth: Theta, seeds: Sequence[int]) -> float:
    """J(optimal | truth) from start states that no two seeds share; nothing keeps it, and it takes some seconds."""
    starts = [fresh_start_states(seed, preset.episodes) for seed in seeds]
    theta, theta_dot = (np.concatenate(column) for column in zip(*starts, strict=True))
    policy = ReferenceTask(preset, OPTIMAL, truth, (truth,)).design()
    return evaluate(policy, hidden_plant(truth), theta, theta_dot).mean


def reference_tasks(
    preset: Preset, designs: Designs, known: Set[tuple[str, Theta, Theta]] = frozenset()
) -> list[ReferenceTask]:
    """All controllers at every truth, and the optimal one at every estimate, on the truths where each is asked for.

    What is asked of one (controller, theta) is designed once; `known` (controller, theta, truth) is left out.
    """
    wanted: dict[tuple[str, Theta], set[Theta]] = {}
    for truth in dict.fromkeys(point.truth for point in preset.points):
        for controller in CONTROLLERS:
            wanted.setdefault((controller, truth), set()).add(truth)
    for theta in sorted(designs):
        wanted.setdefault((OPTIMAL, theta), set()).update(designs[theta])
    missing = {
        (controller, theta): tuple(sorted(t for t in truths if (controller, theta, t) not in known))
        for (controller, theta), truths in wanted.items()
    }
    return [ReferenceTask(preset, c, theta, truths) for (c, theta), truths in missing.items() if truths]
