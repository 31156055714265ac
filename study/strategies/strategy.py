"""A strategy to spend real rollouts: a generator that asks, observes, and says what the final agent is trained on.

    class PointEstimate(Strategy):
        def spend(self, situation):
            records = yield Play(situation.budget)
            estimate = fit(situation.prior, records, situation.sensor, ("m", "l"))
            return TrainingSetup(estimate.model, center(estimate))

What it may ask for                     and what it is answered
    Play(rollouts, torques)             a Record a rollout of the plant under these torques, or under random ones
    Try(agent, rollouts)                Tried: the same under an agent's policy, and the returns
    Train(setups)                       a TrainedAgent a setup, trained in simulation; all of one request train together
    Learn(rollouts, start)              a TrainedAgent that learned on the plant itself, an episode a rollout

Play, Try and Learn cost rollouts. A strategy gives back a TrainingSetup, which the final agent is trained on, a
TrainedAgent, or a Choice: one of these with the best candidate that it saw. It has to be a function of its situation
and of the answers alone: after an interruption, and in every round, it is asked again and given the same answers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from study.trials.training_setup import TrainingSetup
from sysid import Model, Record, Sensor
from sysid.physics.ops import Array

if TYPE_CHECKING:
    from policies.network_policy import NetworkPolicy


@dataclass(frozen=True)
class TrainedAgent:
    """A trained agent: what its policy is stored under, and the policy."""

    key: str
    policy: NetworkPolicy


@dataclass(frozen=True, eq=False)
class Play:
    """So many rollouts under torques (rollouts, N) [N m], by default uniformly random ones; at_rest: begun hanging down
    at rest, where a machine stands that is left alone, and not from a state of the task's."""

    rollouts: int
    torques: Array | None = None
    at_rest: bool = False


@dataclass(frozen=True)
class Try:
    """So many episodes of an agent on the plant; at_rest as in Play."""

    agent: TrainedAgent
    rollouts: int = 1
    at_rest: bool = True


@dataclass(frozen=True, eq=False)
class Tried:
    """What the sensors read in the episodes, and what the episodes returned."""

    records: list[Record]
    returns: Array

    @property
    def mean(self) -> float:
        return float(np.mean(self.returns))


@dataclass(frozen=True)
class Train:
    """An agent a setup, side by side; critics: of them as much is kept as `Learn` needs to go on."""

    setups: tuple[TrainingSetup, ...]
    critics: bool = False


@dataclass(frozen=True)
class Learn:
    """Reinforcement learning on the plant, an episode a rollout; start: an agent that goes on learning, trained with
    `critics`, or None for one that knows nothing."""

    rollouts: int
    start: TrainedAgent | None = None


@dataclass(frozen=True)
class Choice:
    """What is deployed, and of those candidates whose returns alone were compared the one that returned most.

    observed   its return within the budget: of the best of many, so more than it is worth
    """

    deployed: TrainingSetup | TrainedAgent
    best: TrainedAgent | None = None
    observed: float = float("nan")


Request = Play | Try | Train | Learn
Dialogue = Generator[Request, Any, TrainingSetup | TrainedAgent | Choice]

GROUPS = {
    "nothing": "no rollouts",
    "identified": "identified",
    "adapted": "adapted distributions",
    "compared": "compared returns",
    "plant": "learned on the plant",
}
"""Groups of strategies, in the order of their rows."""


@dataclass
class Situation:
    """What a strategy knows before the first rollout.

    prior      what an engineer would assume; the parameters in `names` may be anywhere within their bounds
    sensor     the noise of the readings
    budget     rollouts that it may spend
    rng        for its own draws
    simulated  steps that it has simulated itself, beside the trainings; it adds them up
    """

    prior: Model
    sensor: Sensor
    budget: int
    seed: int
    rng: np.random.Generator
    names: tuple[str, ...] = ("m", "l")
    simulated: int = 0

    @property
    def bounds(self) -> Array:
        """Of the names (P, 2)."""
        return np.array([self.prior.parameters[name].bounds for name in self.names])

    @property
    def believed(self) -> Array:
        """The prior's own values (P,)."""
        return np.array([float(self.prior.parameters[name].value) for name in self.names])

    def named(self, values: Array) -> dict[str, float]:
        """Values (P,) by name."""
        return dict(zip(self.names, values.tolist(), strict=True))

    def rounds(self, most: int) -> list[int]:
        """How many rollouts each of at most so many rounds has."""
        return [len(own) for own in np.array_split(np.arange(self.budget), min(most, self.budget))]

    def model(self, values: Array) -> Model:
        """The prior's model at values (..., P)."""
        values = np.asarray(values)
        return self.prior.with_parameters({name: values[..., i] for i, name in enumerate(self.names)})


class Strategy(ABC):
    """A way to spend rollouts. Its settings are the fields of a frozen dataclass, fixed before any agent is trained.

    least, most   rollouts that it can make use of; most = 0: it spends none
    in_rounds     whether it trains agents on the way, so that the experiment can afford fewer seeds
    needs_angle   whether the angle has to be read all the time, and not at the start alone
    short         it in up to four words; source: where it was published
    group         what it is drawn with, one of GROUPS
    """

    short: ClassVar[str]
    source: ClassVar[str] = ""
    group: ClassVar[str] = "identified"
    least: ClassVar[int] = 1
    most: ClassVar[int] = 1000
    in_rounds: ClassVar[bool] = False
    needs_angle: ClassVar[bool] = False

    @abstractmethod
    def spend(self, situation: Situation) -> Dialogue:
        """Ask for rollouts and trainings, and return what the final agent is."""
