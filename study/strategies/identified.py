"""Strategies that spend their rollouts on identification, and train once on what came out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from policies.environments.randomization import Band, PriorRange
from study.strategies.strategy import Dialogue, Play, Situation, Strategy
from study.trials.rollout_budget import Budget, center
from study.trials.training_setup import TrainingSetup
from sysid import Estimate, Record, Sensor, fit
from sysid.planning.design import Conditions, Hypothesis, precision, search, yardsticks
from sysid.planning.excitation import Limits

SPLIT_ROLLOUTS = 1
"""Played at random before anything can be designed."""


@dataclass(frozen=True)
class PriorAlone(Strategy):
    """No rollouts: the agent is trained at what an engineer would assume."""

    short: ClassVar[str] = "prior"
    group: ClassVar[str] = "nothing"
    least: ClassVar[int] = 0
    most: ClassVar[int] = 0

    def spend(self, situation: Situation) -> Dialogue:
        """Training at the prior's own numbers, without a rollout."""
        return TrainingSetup(situation.prior, Band(situation.named(situation.believed)))
        yield  # a generator that asks for nothing


@dataclass(frozen=True)
class WholePriorRange(Strategy):
    """No rollouts: every episode draws the parameters from all that is plausible. Tobin et al., "Domain randomization
    for transferring deep neural networks from simulation to the real world", IROS 2017; Peng et al., ICRA 2018, of whom
    the policy's memory is left out but for its last commands."""

    short: ClassVar[str] = "prior range"
    source: ClassVar[str] = "Tobin 2017, Peng 2018"
    group: ClassVar[str] = "nothing"
    least: ClassVar[int] = 0
    most: ClassVar[int] = 0

    def spend(self, situation: Situation) -> Dialogue:
        """Training over the whole prior range, without a rollout."""
        return TrainingSetup(situation.prior, PriorRange(situation.names))
        yield


@lru_cache(maxsize=4)
def budget_of(records: tuple[Record, ...], sensor: Sensor, seed: int) -> Budget:
    """What can be made of rollouts: the same for all strategies that share them, so that no fit is made twice."""
    return Budget(records, sensor, seed)


@dataclass(frozen=True)
class Identified(Strategy):
    """All rollouts under random torques, and then one of the setups that can be made of them (`Budget.setup`)."""

    made: str

    def spend(self, situation: Situation) -> Dialogue:
        """All rollouts at once, then the setup that is made of them."""
        records = yield Play(situation.budget)
        return budget_of(tuple(records), situation.sensor, situation.seed).setup(self.made)


@dataclass(frozen=True)
class PointEstimate(Identified):
    """Least squares for m and l over whole rollouts (output error), and training at the estimate."""

    made: str = "fitted"
    short: ClassVar[str] = "point estimate"


@dataclass(frozen=True)
class GridEstimate(Identified):
    """The paper's grid search for m and l, over single steps of the same readings."""

    made: str = "grid"
    short: ClassVar[str] = "paper's grid"
    source: ClassVar[str] = "the paper"
    needs_angle: ClassVar[bool] = True


@dataclass(frozen=True)
class KalmanEstimate(Identified):
    """The estimate of m and l by an unscented Kalman filter over the same readings, and training there."""

    made: str = "kalman"
    short: ClassVar[str] = "Kalman filter"
    needs_angle: ClassVar[bool] = True


@dataclass(frozen=True)
class RelativeBand(Identified):
    """The point estimate with a band of +- 30 % about it: the paper's randomization."""

    made: str = "band"
    short: ClassVar[str] = "band, 30 %"
    source: ClassVar[str] = "the paper"


@dataclass(frozen=True)
class PosteriorOfFit(Identified):
    """The fit's normal distribution of m and l instead of a point."""

    made: str = "fitted_posterior"
    short: ClassVar[str] = "posterior"


@dataclass(frozen=True)
class UnderRandomForce(Identified):
    """The point estimate, and random torques in training. Valassakis, Ding and Johns, "Crossing the gap", IROS 2020;
    size and memory of the torques are those that the rollouts leave unexplained, where the source tunes them."""

    made: str = "random_force"
    short: ClassVar[str] = "random force"
    source: ClassVar[str] = "Valassakis 2020"
    needs_angle: ClassVar[bool] = True


@dataclass(frozen=True)
class MendedModel(Identified):
    """This project's: the missing effect is named, added and fitted; where it is unknown, random torques."""

    made: str = "mended"
    short: ClassVar[str] = "mended model"
    source: ClassVar[str] = "this project"
    needs_angle: ClassVar[bool] = True


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
        torques = designed(rough, situation, situation.budget - SPLIT_ROLLOUTS, records[0].t[-1])
        records += yield Play(len(torques), torques, at_rest=True)
        found = fit(rough.model, records, situation.sensor, situation.names)
        return TrainingSetup(found.model, center(found))


def designed(rough: Estimate, situation: Situation, rollouts: int, duration: float) -> np.ndarray:
    """Torques (rollouts, N) [N m] from rest, of which the fit expects the narrowest intervals."""
    model, names = rough.model, situation.names
    limits = Limits(model.u_max, duration=duration, rollouts=rollouts, start=0.0)
    assumed = [Hypothesis("", model, names)]
    goal = precision(yardsticks(model, names))
    best = search(goal, assumed, Conditions(limits, situation.sensor), situation.rng)[0]
    steps = math.floor(duration / model.dt + 0.5)
    return np.array([signal.torque(steps, model.dt) for signal in best.signals])
