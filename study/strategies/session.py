"""A strategy's dialogue with the plant and with training, as far as the agents go that are trained already.

    reached = advance(strategy, situation, plant, agents)     Waiting for agents, or Finished
    rounds = case_rounds(plan, current, cases, folder, progress)     of many dialogues, as plain data

Nothing of a dialogue is stored but its agents: the plant gives the same rollouts again, and strategies draw from the
situation's generator, so that it is repeated to where it stopped. So a study can be interrupted anywhere, and a round
of many dialogues trains one population.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from policies.network_policy import NetworkPolicy
from study.pipeline.population_task import read_policy
from study.pipeline.settings import digest
from study.pipeline.tables import ResultTable
from study.strategies.plant import BudgetedPlant
from study.strategies.strategy import Choice, Learn, Play, Request, Situation, Strategy, Train, TrainedAgent, Try
from study.strategies.trial_plan import Case, TrialPlan
from study.trials.ground_truth import PRIOR
from study.trials.training_setup import TrainingSetup
from sysid import InvalidInput

PolicyLookup = Callable[[str], NetworkPolicy | None]
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
    strategy: Strategy, situation: Situation, plant: BudgetedPlant, policy_of: PolicyLookup, where: str
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
                requested = [key_of(setup, situation.seed, request.critics) for setup in request.setups]
                policies = [policy_of(key) for key in requested]
                if None in policies:
                    return Waiting(dict(zip(requested, request.setups, strict=True)))
                keys += [key for key in requested if key not in keys]
                answer = tuple(map(TrainedAgent, requested, policies))
            case Learn():
                plant.spend(request.rollouts)
                start = request.start.key if request.start else ""
                key = f"{digest([where, start, request.rollouts])}-{situation.seed}"
                policy = policy_of(key)
                if policy is None:
                    return Waiting({}, learn=(key, start, request.rollouts))
                answer = TrainedAgent(key, policy)
            case _:
                raise InvalidInput(f"a strategy asked for {request!r}: expected Play, Try, Train or Learn")


@dataclass(frozen=True)
class CaseRound:
    """A round of a case. payload, plain data:

    setups   by key, TrainingSetups to train on (TrainingSetup.to_json)
    learn    (key, start's key or "", rollouts) of an agent that learns on the plant; None without one
    answer   what the strategy gave back, with what it spent: it is the last round
    """

    case: Case
    round: int
    payload: dict[str, Any]
    seconds: float


STEPS = ResultTable(
    "steps", CaseRound,
    "plant TEXT, sensing TEXT, strategy TEXT, n INTEGER, seed INTEGER, round INTEGER, payload TEXT, seconds REAL",
    keys=6,
)  # fmt: skip


def case_rounds(
    plan: TrialPlan, current: int, cases: Sequence[Case], folder: Path, progress: Callable[[float], None]
) -> list[CaseRound]:
    """A round of the cases of one seed on one plant; folder: of the results, with the agents that are trained."""
    rounds, policy = list[CaseRound](), cache(partial(read_policy, folder))
    for case in cases:
        begin = time.perf_counter()
        payload = step(plan, case, policy)
        rounds.append(CaseRound(case, current, payload, time.perf_counter() - begin))
        progress(len(rounds) / len(cases))
    return rounds


def step(plan: TrialPlan, case: Case, policy_of: PolicyLookup) -> dict[str, Any]:
    """How far a case's dialogue comes with the agents that are found. Raises InvalidInput as `advance` does."""
    strategy, plant = plan.strategy_on(plan.plant(case.plant), case.strategy), plan.plant_of(case)
    rng = np.random.default_rng([case.seed, int(digest(case.strategy), 16)])
    situation = Situation(PRIOR, plant.sensor, case.n, case.seed, rng)
    try:
        came = advance(strategy, situation, plant, policy_of, case.plant)
    except InvalidInput as error:
        raise InvalidInput(f"strategy {case.strategy!r} on {case.plant}, seed {case.seed}: {error}") from None
    if isinstance(came, Waiting):
        return {"setups": {key: setup.to_json() for key, setup in came.setups.items()}, "learn": came.learn}
    deployed, best = came.choice.deployed, came.choice.best
    deployed_key = deployed.key if isinstance(deployed, TrainedAgent) else key_of(deployed, case.seed)
    setups = {} if isinstance(deployed, TrainedAgent) else {deployed_key: deployed.to_json()}
    trained = {*came.keys, *setups}
    learners = sum(key.endswith(CRITICS) for key in trained)
    answer = {
        "deployed": deployed_key,
        "best": best.key if best else None,
        "observed": came.choice.observed if best else None,
        "rollouts": came.rollouts,
        "simulated": came.simulated + (len(trained) - learners) * plan.steps + learners * plan.of_learners.steps,
    }
    return {"setups": setups, "learn": None, "answer": answer}
