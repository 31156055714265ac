"""Rounds of dialogues as plain data: how far every case comes with the agents that are trained by then."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from policies.network_policy import NetworkPolicy
from study.pipeline.policy_files import FOLDER, read_policies
from study.pipeline.settings import digest
from study.pipeline.tables import ResultTable
from study.strategies.session import CRITICS, Found, Waiting, advance, key_of
from study.strategies.strategy import Situation, TrainedAgent
from study.strategies.trial_plan import Case, TrialPlan
from study.trials.ground_truth import PRIOR
from sysid import InvalidInput


@dataclass(frozen=True)
class CaseRound:
    """A round of a case. payload, plain data:

    setups   by key, TrainingSetups to train on (TrainingSetup.to_json)
    learn    (key, start's key or "", rollouts) of an agent that learns on the plant; None without one
    answer   what the strategy gave back, with what it spent: it is the last round
    """

    plant: str
    sensing: str
    strategy: str
    n: int
    seed: int
    round: int
    payload: dict[str, Any]
    seconds: float

    @property
    def case(self) -> Case:
        return Case(self.plant, self.sensing, self.strategy, self.n, self.seed)


STEPS = ResultTable(
    "steps", CaseRound,
    "plant TEXT, sensing TEXT, strategy TEXT, n INTEGER, seed INTEGER, round INTEGER, payload TEXT, seconds REAL",
    keys=6,
)  # fmt: skip


def steps(
    plan: TrialPlan,
    current: int,
    cases: Sequence[Case],
    stems: Mapping[str, str],
    folder: Path,
    progress: Callable[[float], None],
) -> list[CaseRound]:
    """A round of the cases of one seed on one plant; stems: of the files of policies, by the key of each agent that
    these have waited for so far."""
    read, found = dict[str, NetworkPolicy](), list[CaseRound]()

    def policy(key: str) -> NetworkPolicy | None:
        if key not in read and key in stems:
            read.update(read_policies(folder / FOLDER / f"{stems[key]}.npz"))  # type: ignore[arg-type]
        return read.get(key)

    for case in cases:
        begin = time.perf_counter()
        payload = step(plan, case, policy)
        found.append(CaseRound(*case, current, payload, time.perf_counter() - begin))
        progress(len(found) / len(cases))
    return found


def step(plan: TrialPlan, case: Case, found: Found) -> dict[str, Any]:
    """How far a case's dialogue comes with the agents that are found. Raises InvalidInput as `advance` does."""
    strategy, plant = plan.strategy_of(case), plan.plant_of(case)
    strategy.check(case.strategy, case.n, case.sensing)
    rng = np.random.default_rng([case.seed, int(digest(case.strategy), 16)])
    situation = Situation(PRIOR, plant.sensor, case.n, case.seed, rng)
    try:
        came = advance(strategy, situation, plant, found, case.plant)
    except InvalidInput as error:
        raise InvalidInput(f"strategy {case.strategy!r} on {case.plant}, seed {case.seed}: {error}") from None
    if isinstance(came, Waiting):
        return {"setups": {key: setup.to_json() for key, setup in came.setups.items()}, "learn": came.learn}
    deployed, best = came.choice.deployed, came.choice.best
    own = deployed.key if isinstance(deployed, TrainedAgent) else key_of(deployed, case.seed)
    setups = {} if isinstance(deployed, TrainedAgent) else {own: deployed.to_json()}
    trained = {*came.keys, *setups}
    learners = sum(key.endswith(CRITICS) for key in trained)
    answer = {
        "deployed": own,
        "best": best.key if best else None,
        "observed": came.choice.observed if best else None,
        "rollouts": came.rollouts,
        "simulated": came.simulated + (len(trained) - learners) * plan.steps + learners * plan.of_learners.steps,
    }
    return {"setups": setups, "learn": None, "answer": answer}
