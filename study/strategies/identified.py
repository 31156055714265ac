"""Strategies that train once: without rollouts, or on what came out of their identification."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from policies.environments.randomization import Band, Ranges
from study.strategies.strategy import Dialogue, Play, Situation, Strategy
from study.trials.rollout_budget import Budget, center
from study.trials.training_setup import TrainingSetup
from sysid import Estimate, Record, Sensor, fit
from sysid.planning.design import Conditions, Hypothesis, precision, search, yardsticks
from sysid.planning.excitation import Limits

SPLIT_ROLLOUTS = 1
"""Played at random before anything can be designed."""


@dataclass(frozen=True, eq=False)
class Unmeasured(Strategy):
    """No rollouts: what is trained on is known beforehand."""

    setup: Callable[[Situation], TrainingSetup]
    short: str = ""
    source: str = ""
    group: ClassVar[str] = "nothing"
    least: ClassVar[int] = 0
    most: ClassVar[int] = 0

    def spend(self, situation: Situation) -> Dialogue:
        """Training on the setup, without a rollout."""
        return self.setup(situation)
        yield  # a generator that asks for nothing


PRIOR_ALONE = Unmeasured(
    lambda situation: TrainingSetup(situation.prior, Band(situation.named(situation.believed))), "prior"
)
"""The agent is trained at what an engineer would assume."""

WHOLE_PRIOR_RANGE = Unmeasured(
    lambda situation: TrainingSetup(situation.prior, Ranges.of(situation.prior, situation.names)),
    "prior range",
    "Tobin 2017, Peng 2018",
)
"""Every episode draws the parameters from all that is plausible. Tobin et al., "Domain randomization for transferring
deep neural networks from simulation to the real world", IROS 2017; Peng et al., ICRA 2018, of whom the policy's memory
is left out but for its last commands."""


@lru_cache(maxsize=4)
def budget_of(records: tuple[Record, ...], sensor: Sensor, seed: int) -> Budget:
    """What can be made of rollouts: the same for all strategies that share them, so that no fit is made twice."""
    return Budget(records, sensor, seed)


@dataclass(frozen=True)
class Identified(Strategy):
    """All rollouts under random torques, and then one of the setups that can be made of them (`Budget.setup`)."""

    made: str
    short: str = ""
    source: str = ""
    needs_angle: bool = False

    def spend(self, situation: Situation) -> Dialogue:
        """All rollouts at once, then the setup that is made of them."""
        records = yield Play(situation.budget)
        return budget_of(tuple(records), situation.sensor, situation.seed).setup(self.made)


POINT_ESTIMATE = Identified("fitted", "point estimate")
"""Least squares for m and l over whole rollouts (output error), and training at the estimate."""

GRID_ESTIMATE = Identified("grid", "paper's grid", "the paper", needs_angle=True)
"""The paper's grid search for m and l, over single steps of the same readings."""

KALMAN_ESTIMATE = Identified("kalman", "Kalman filter", needs_angle=True)
"""The estimate of m and l by an unscented Kalman filter over the same readings, and training there."""

RELATIVE_BAND = Identified("band", "band, 30 %", "the paper")
"""The point estimate with a band of +- 30 % about it: the paper's randomization."""

POSTERIOR_OF_FIT = Identified("fitted_posterior", "posterior")
"""The fit's normal distribution of m and l instead of a point."""

UNDER_RANDOM_FORCE = Identified("random_force", "random force", "Valassakis 2020", needs_angle=True)
"""The point estimate, and random torques in training. Valassakis, Ding and Johns, "Crossing the gap", IROS 2020; size
and memory of the torques are those that the rollouts leave unexplained, where the source tunes them."""

MENDED_MODEL = Identified("mended", "mended model", "this project", needs_angle=True)
"""This project's: the missing effect is named, added and fitted; where it is unknown, random torques."""


@dataclass(frozen=True)
class DesignedExcitation(Strategy):
    """Torques designed for information about m and l, then least squares over all rollouts. Sobanbabu et al.,
    "Sampling-based system identification with active exploration" (SPI-Active), 2025.

    One random rollout gives the model to design on. The source raises the Fisher information of what a policy's
    commands excite; here a rollout's torque itself is searched for, so that the widest interval shrinks, and played
    from rest. All further rollouts are designed together.
    """

    short: ClassVar[str] = "designed excitation"
    source: ClassVar[str] = "Sobanbabu 2025"
    least: ClassVar[int] = 2

    def spend(self, situation: Situation) -> Dialogue:
        """A random rollout, designed ones for the rest of the budget, then training at the fit of all."""
        records = yield Play(SPLIT_ROLLOUTS)
        rough = fit(situation.prior, records, situation.sensor, situation.names)
        torques = designed_torques(rough, situation, situation.budget - SPLIT_ROLLOUTS, records[0].t[-1])
        records += yield Play(len(torques), torques, at_rest=True)
        estimate = fit(rough.model, records, situation.sensor, situation.names)
        return TrainingSetup(estimate.model, center(estimate))


def designed_torques(rough: Estimate, situation: Situation, rollouts: int, duration: float) -> np.ndarray:
    """Torques (rollouts, N) [N m] from rest, of which the fit expects the narrowest intervals."""
    model, names = rough.model, situation.names
    limits = Limits(model.u_max, duration=duration, rollouts=rollouts, start=0.0)
    assumed = [Hypothesis("", model, names)]
    goal = precision(yardsticks(model, names))
    best = search(goal, assumed, Conditions(limits, situation.sensor), situation.rng)[0]
    steps = math.floor(duration / model.dt + 0.5)
    return np.array([signal.torque(steps, model.dt) for signal in best.signals])
