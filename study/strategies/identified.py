"""Strategies that spend their rollouts on identification, and train once on what came out.

What they make of the records is made where the mismatch experiment makes it, too (`Budget`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from policies.environments.randomization import Band, PriorRange
from study.strategies.strategy import Dialogue, Play, Situation, Strategy
from study.trials.rollout_budget import Budget, center, posterior_of
from study.trials.training_setup import TrainingSetup
from sysid import Estimate, UnscentedKalman, fit
from sysid.planning.design import Conditions, Hypothesis, precision, search, yardsticks
from sysid.planning.signals import Limits

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
        return TrainingSetup(situation.prior, PriorRange(situation.names))
        yield


@dataclass(frozen=True)
class Identified(Strategy):
    """All rollouts under random torques, and then what the mismatch experiment makes of them."""

    made: ClassVar[str]

    def spend(self, situation: Situation) -> Dialogue:
        records = yield Play(situation.budget)
        return Budget(records, situation.sensor, situation.seed).setup(self.made)


class PointEstimate(Identified):
    """Least squares for m and l over whole rollouts (output error), and training at the estimate."""

    short: ClassVar[str] = "point estimate"
    made: ClassVar[str] = "fitted"


class GridEstimate(Identified):
    """The paper's grid search for m and l, over single steps of the same readings."""

    short: ClassVar[str] = "paper's grid"
    source: ClassVar[str] = "the paper"
    needs_angle: ClassVar[bool] = True
    made: ClassVar[str] = "grid"


class RelativeBand(Identified):
    """The point estimate with a band of +- 30 % about it: the paper's randomization."""

    short: ClassVar[str] = "band, 30 %"
    source: ClassVar[str] = "the paper"
    made: ClassVar[str] = "band"


class UnderRandomForce(Identified):
    """The point estimate, and random torques in training. Valassakis, Ding and Johns, "Crossing the gap", IROS 2020;
    size and memory of the torques are those that the rollouts leave unexplained, where the source tunes them."""

    short: ClassVar[str] = "random force"
    source: ClassVar[str] = "Valassakis 2020"
    needs_angle: ClassVar[bool] = True
    made: ClassVar[str] = "random_force"


class MendedModel(Identified):
    """This project's: the missing effect is named, added and fitted; where it is unknown, random torques."""

    short: ClassVar[str] = "mended model"
    source: ClassVar[str] = "this project"
    needs_angle: ClassVar[bool] = True
    made: ClassVar[str] = "mended"


@dataclass(frozen=True)
class KalmanEstimate(Strategy):
    """The estimate of m and l by an unscented Kalman filter over the same readings, and training there."""

    short: ClassVar[str] = "Kalman filter"
    needs_angle: ClassVar[bool] = True

    def spend(self, situation: Situation) -> Dialogue:
        records = yield Play(situation.budget)
        found = UnscentedKalman(situation.names, situation.sensor).fit(situation.prior, records)
        return TrainingSetup(found.model, center(found))


@dataclass(frozen=True)
class PosteriorOfFit(Strategy):
    """The fit's normal distribution of m and l instead of a point."""

    short: ClassVar[str] = "posterior"

    def spend(self, situation: Situation) -> Dialogue:
        records = yield Play(situation.budget)
        found = Budget(records, situation.sensor, situation.seed).fitted
        return TrainingSetup(found.model, posterior_of(found))


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
    best, *_ = search(goal, assumed, Conditions(limits, situation.sensor), situation.rng)
    steps = math.floor(duration / model.dt + 0.5)
    return np.array([signal.torque(steps, model.dt) for signal in best])
