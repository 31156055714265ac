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
    """A trained agent.

    Attributes
    ----------
    key : str
        The name under which its policy is stored.
    policy : NetworkPolicy
        The policy.
    """

    key: str
    policy: NetworkPolicy


@dataclass(frozen=True, eq=False)
class Play:
    """A request for rollouts of the plant; it is answered with their records.

    Parameters
    ----------
    rollouts : int
        How many.
    torques : array (rollouts, N), optional
        The commands [N m]; by default they are uniformly random.
    at_rest : bool
        Whether the rollouts begin hanging down at rest, where a machine stands that is left alone, and not in a start
        state of the task.
    """

    rollouts: int
    torques: Array | None = None
    at_rest: bool = False


@dataclass(frozen=True)
class Try:
    """A request for episodes of an agent on the plant; it is answered with `Tried`.

    Parameters
    ----------
    agent : TrainedAgent
        Whose policy acts.
    rollouts : int
        How many episodes; each counts as a rollout.
    at_rest : bool
        As in `Play`.
    """

    agent: TrainedAgent
    rollouts: int = 1
    at_rest: bool = True


@dataclass(frozen=True, eq=False)
class Tried:
    """What episodes on the plant showed.

    Attributes
    ----------
    records : list of Record
        What the sensors read.
    returns : array (E,)
        What the episodes returned.
    """

    records: list[Record]
    returns: Array

    @property
    def mean(self) -> float:
        """The mean return."""
        return float(np.mean(self.returns))


@dataclass(frozen=True)
class Train:
    """A request for agents, one for each setup, which train side by side; it is answered with a tuple of TrainedAgent.

    Parameters
    ----------
    setups : tuple of TrainingSetup
        What each agent trains on.
    critics : bool
        Whether as much of the agents is kept as `Learn` needs to go on from them.
    """

    setups: tuple[TrainingSetup, ...]
    critics: bool = False


@dataclass(frozen=True)
class Learn:
    """A request for reinforcement learning on the plant; it is answered with a TrainedAgent.

    Parameters
    ----------
    rollouts : int
        How many episodes the agent learns from; each counts as a rollout.
    start : TrainedAgent, optional
        An agent that goes on learning, trained with `critics`; by default one that knows nothing.
    """

    rollouts: int
    start: TrainedAgent | None = None


@dataclass(frozen=True)
class Choice:
    """What is deployed, and the candidate that returned most, where the returns of several were compared.

    Parameters
    ----------
    deployed : TrainingSetup or TrainedAgent
        What is deployed.
    best : TrainedAgent, optional
        The candidate that returned most.
    observed : float
        Its return within the budget. It is that of the best of several, and so more than the agent is worth.
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

    Attributes
    ----------
    prior : Model
        What an engineer would assume; the parameters in `names` may be anywhere within their bounds.
    sensor : Sensor
        The noise of the readings.
    budget : int
        How many rollouts it may spend.
    seed : int
        The seed of the run.
    rng : numpy.random.Generator
        For draws of its own.
    names : tuple of str
        The P parameters that are unknown.
    simulated : int
        How many steps it has simulated itself, beside the trainings; it adds them up.
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
        """The bounds of the unknown parameters (P, 2)."""
        return np.array([self.prior.parameters[name].bounds for name in self.names])

    @property
    def believed(self) -> Array:
        """The prior's values of the unknown parameters (P,)."""
        return np.array([float(self.prior.parameters[name].value) for name in self.names])

    def named(self, values: Array) -> dict[str, float]:
        """Values (P,) by name."""
        return dict(zip(self.names, values.tolist(), strict=True))

    def rounds(self, most: int) -> list[int]:
        """How many rollouts each of at most so many rounds has."""
        return [len(part) for part in np.array_split(np.arange(self.budget), min(most, self.budget))]

    def model(self, values: Array) -> Model:
        """The prior's model at values (..., P)."""
        values = np.asarray(values)
        return self.prior.with_parameters({name: values[..., i] for i, name in enumerate(self.names)})


class Strategy(ABC):
    """A way to spend rollouts. Its settings are the fields of a frozen dataclass, fixed before any agent is trained.

    Attributes
    ----------
    short : str
        What it is, in up to four words.
    source : str
        Where it was published.
    group : str
        The group that it is drawn with, a key of GROUPS.
    least, most : int
        The fewest and the most rollouts that it can make use of; with most = 0 it spends none.
    in_rounds : bool
        Whether it trains agents on the way, so that the experiment can afford fewer seeds.
    needs_angle : bool
        Whether the angle has to be read all the time, and not at the start alone.
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
        """Ask for rollouts and trainings, and return what the final agent is.

        Parameters
        ----------
        situation : Situation
            What is known before the first rollout.

        Yields
        ------
        Play, Try, Train or Learn
            A request; what it is answered with is the value of the `yield`.

        Returns
        -------
        TrainingSetup, TrainedAgent or Choice
            What is deployed: the setup that the last agent trains on, or an agent.
        """
