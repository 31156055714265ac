"""A strategy's dialogue with the plant and with training, as far as the agents go that are trained already.

    reached = advance(strategy, situation, plant, agents)     Waiting for agents, or Finished

Nothing of a dialogue is stored but its agents: the plant gives the same rollouts again, and strategies draw from the
situation's generator, so that it is repeated to where it stopped. So a study can be interrupted anywhere, and a round
of many dialogues trains one population.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from policies.network_policy import NetworkPolicy
from study.pipeline.settings import digest
from study.strategies.plant import BudgetedPlant
from study.strategies.strategy import Choice, Learn, Play, Request, Situation, Strategy, Train, TrainedAgent, Try
from study.trials.training_setup import TrainingSetup
from sysid import InvalidInput

Found = Callable[[str], NetworkPolicy | None]
"""The policy that is stored under a key; None where it is not trained yet."""


@dataclass(frozen=True)
class Waiting:
    """What has to be trained before it goes on: setups by key, or Learn (start's key, rollouts) on the plant."""

    setups: dict[str, TrainingSetup]
    learn: tuple[str, str, int] | None = None


@dataclass(frozen=True)
class Finished:
    """What the strategy gave back; rollouts: that it spent; keys: of the agents that it trained in simulation, in
    order; simulated: steps of the strategy's own simulations."""

    choice: Choice
    rollouts: int
    keys: tuple[str, ...]
    simulated: int


CRITICS = "-critics"
"""What keys of agents end with whose critics are kept."""


def key_of(setup: TrainingSetup, seed: int, critics: bool = False) -> str:
    """What the agent that is trained on a setup with this seed is stored under."""
    return f"{setup.key}-{seed}{CRITICS if critics else ''}"


def advance(
    strategy: Strategy, situation: Situation, plant: BudgetedPlant, found: Found, where: str
) -> Waiting | Finished:
    """Repeat a dialogue, and go on with it until an agent is missing; where: what tells its plant from others.

    Raises InvalidInput for a request that is none, and where the plant refuses.
    """
    dialogue, answer, keys = strategy.spend(situation), None, []
    while True:
        try:
            request: Request = dialogue.send(answer)
        except StopIteration as end:
            choice = end.value if isinstance(end.value, Choice) else Choice(end.value)
            if not isinstance(choice.deployed, TrainingSetup | TrainedAgent):
                kind = type(choice.deployed).__name__
                raise InvalidInput(f"a strategy gave back a {kind}: expected a TrainingSetup or an Agent") from None
            return Finished(choice, plant.spent, tuple(keys), situation.simulated)
        match request:
            case Play():
                answer = plant.play(request)
            case Try():
                answer = plant.run(request.agent.policy, request.rollouts, request.at_rest)
            case Train():
                own = [key_of(setup, situation.seed, request.critics) for setup in request.setups]
                if any(found(key) is None for key in own):
                    return Waiting(dict(zip(own, request.setups, strict=True)))
                keys += [key for key in own if key not in keys]
                answer = tuple(_agent(key, found) for key in own)
            case Learn():
                plant.spend(request.rollouts)
                start = request.start.key if request.start else ""
                key = f"{digest([where, start, request.rollouts])}-{situation.seed}"
                if found(key) is None:
                    return Waiting({}, learn=(key, start, request.rollouts))
                answer = _agent(key, found)
            case _:
                raise InvalidInput(f"a strategy asked for {request!r}: expected Play, Try, Train or Learn")


def _agent(key: str, found: Found) -> Any:
    policy = found(key)
    assert policy is not None
    return TrainedAgent(key, policy)
