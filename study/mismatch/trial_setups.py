"""What each strategy makes of the rollouts that a seed draws on a hidden plant, and the agents that train on it."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from policies.environments.randomization import Fixed, SingleEffect
from study.mismatch.magnitudes import MAGNITUDES
from study.mismatch.mismatch_plan import FREE, SHARED, Plan, StrategyKey, TrialKey
from study.paper.protocol import BOUNDS
from study.pipeline.tables import ResultTable
from study.trials.ground_truth import PRIOR, ground_truth, oracle
from study.trials.hidden_plant import HiddenPlant
from study.trials.populations import AgentToTrain
from study.trials.rollout_budget import AT_ONCE, Budget
from study.trials.training_setup import TrainingSetup, training_setup_of
from sysid import InvalidInput, Model, Record, Sensor, effect, simulate


@dataclass(frozen=True)
class Fitted:
    """What a strategy made of the n rollouts that a seed draws on a hidden plant: TrainingSetup.to_json."""

    plant: str
    strategy: str
    n: int
    seed: int
    payload: dict[str, Any]
    seconds: float

    @property
    def trial(self) -> TrialKey:
        return TrialKey(self.plant, self.strategy, self.n, self.seed)


FITS = ResultTable(
    "fits", Fitted, "plant TEXT, strategy TEXT, n INTEGER, seed INTEGER, payload TEXT, seconds REAL", keys=4
)


def fitted(
    plan: Plan, plant: str, seed: int, strategies: Sequence[str], progress: Callable[[float], None]
) -> list[Fitted]:
    """What every strategy makes of the rollouts of a seed."""
    made = training_setups(plan, plan.plant(plant), seed, strategies)
    return [
        Fitted(plant, strategy, n, seed, setup.to_json(), seconds) for (strategy, n), (setup, seconds) in made.items()
    ]


def sensor(plan: Plan) -> Sensor:
    """The sensor that reads the hidden plant: an encoder and a poor tachometer."""
    return Sensor(theta=plan.sd[0], theta_dot=plan.sd[1])


def rollouts(plan: Plan, plant: HiddenPlant, seed: int) -> list[Record]:
    """The largest budget's rollouts; smaller budgets are its first ones. Torques are uniform within +-u_max."""
    n, rng = max(plan.budgets), np.random.default_rng(seed)
    if n < 1:
        raise InvalidInput(f"budgets {plan.budgets}: expected at least one rollout")
    model = ground_truth(plant)
    u = rng.uniform(-model.u_max, model.u_max, (n, plan.length))
    theta, theta_dot = rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n)
    return sensor(plan).measure(simulate(model, u, theta, theta_dot), rng)


def training_setups(
    plan: Plan, plant: HiddenPlant, seed: int, strategies: Sequence[str]
) -> dict[tuple[str, int], tuple[TrainingSetup, float]]:
    """What each strategy makes of each budget, and the seconds that it took."""
    found: dict[tuple[str, int], tuple[TrainingSetup, float]] = {}
    free, spent = [w for w in strategies if w in FREE], [w for w in strategies if w not in FREE]
    for strategy in free:
        found[strategy, 0] = _without_rollouts(strategy, plant), 0.0
    records = rollouts(plan, plant, seed) if spent else []
    for n in plan.budgets if spent else ():
        budget = Budget(records[:n], sensor(plan), seed, plan.band)
        for strategy in spent:
            begin = time.perf_counter()
            found[strategy, n] = budget.setup(strategy), time.perf_counter() - begin
    return found


def _without_rollouts(strategy: str, plant: HiddenPlant) -> TrainingSetup:
    if strategy == StrategyKey.ORACLE:
        return TrainingSetup(oracle(plant), Fixed())
    if strategy == StrategyKey.PRIOR:
        return TrainingSetup(PRIOR, Fixed())
    model = dataclasses.replace(PRIOR, effects=tuple(effect(name) for name in AT_ONCE))
    neutral = {f"{name}.{key}": value for name in AT_ONCE for key, value in MAGNITUDES[name].numbers(0.0).items()}
    kinds = tuple(plausible_ranges(model, name) for name in AT_ONCE)
    return TrainingSetup(model, SingleEffect({"m": BOUNDS, "l": BOUNDS}, kinds, neutral))


def plausible_ranges(model: Model, name: str) -> dict[str, tuple[float, float]]:
    """The range of each of an effect's numbers: from nothing to the largest plausible, and as far to the other side
    where the model allows it and that is something else."""
    found, parameters = {}, model.parameters
    nothing, most = MAGNITUDES[name].numbers(0.0), MAGNITUDES[name].numbers(MAGNITUDES[name].largest)
    for key, end in most.items():
        p, other = parameters[f"{name}.{key}"], 2.0 * nothing[key] - end
        signed = p.bounds[0] <= other <= p.bounds[1] and nothing[key] == p.neutral
        found[f"{name}.{key}"] = (min(end, other), max(end, other)) if signed else tuple(sorted((nothing[key], end)))
    return found


def agents_of(plan: Plan, fits: Sequence[Fitted]) -> tuple[dict[TrialKey, str], list[AgentToTrain]]:
    """The key of the agent behind every trial, and the agents in the order of trials; equal setups share an agent."""
    made = {f.trial: f.payload for f in fits}
    keys: dict[TrialKey, str] = {}
    agents: dict[str, AgentToTrain] = {}
    for trial in plan.trials:
        payload = made[trial]
        key = keys[trial] = f"{training_setup_of(payload).key}-{trial.seed}"
        plants = tuple(p.name for p in plan.plants) if trial.strategy in SHARED else (trial.plant,)
        known = agents[key].plants if key in agents else ()
        agents[key] = AgentToTrain(key, payload, trial.seed, tuple(dict.fromkeys((*known, *plants))))
    return keys, list(agents.values())
