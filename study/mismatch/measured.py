"""The rollouts of a hidden plant that a seed stands for, and what is trained on where none are asked for."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np

from policies.environments.randomization import Fixed, SingleEffect
from policies.environments.task import HORIZON
from study.mismatch.magnitudes import MAGNITUDES
from study.paper.protocol import BOUNDS
from study.strategies.plant import SENSORS, BudgetedPlant
from study.strategies.strategy import Play
from study.trials.ground_truth import PRIOR, ground_truth, oracle
from study.trials.hidden_plant import HiddenPlant
from study.trials.rollout_budget import AT_ONCE
from study.trials.training_setup import TrainingSetup
from sysid import InvalidInput, Model, Record, effect, simulate


class MeasuredPlant(BudgetedPlant):
    """A hidden plant whose rollouts were measured before anybody asks: so many of a seed were drawn together, and
    smaller budgets are the first ones of larger ones."""

    def __init__(self, plant: HiddenPlant, budget: int, seed: int, drawn: int) -> None:
        super().__init__(ground_truth(plant), "encoder", budget, seed)
        self.hidden, self.drawn = plant, drawn

    def play(self, asked: Play) -> list[Record]:
        if asked.torques is not None or asked.at_rest:
            raise InvalidInput("this plant was measured under random torques: expected to be asked for those alone")
        chosen = self.spend(asked.rollouts)
        return list(measured_rollouts(self.hidden, self.seed, self.drawn)[chosen.start : chosen.stop])


@lru_cache(maxsize=1)
def measured_rollouts(plant: HiddenPlant, seed: int, count: int) -> tuple[Record, ...]:
    """So many rollouts as the sensors read them. Torques are uniform within +-u_max."""
    rng, model = np.random.default_rng(seed), ground_truth(plant)
    u = rng.uniform(-model.u_max, model.u_max, (count, HORIZON))
    theta, theta_dot = rng.uniform(-np.pi, np.pi, count), rng.uniform(-1.0, 1.0, count)
    return tuple(SENSORS["encoder"].measure(simulate(model, u, theta, theta_dot), rng))


def known_setup(strategy: str, plant: HiddenPlant) -> TrainingSetup:
    """The hidden plant itself, which nobody knows; what an engineer would assume; or breadth over m, l and one effect
    of any kind at a time."""
    if strategy in ("oracle", "prior"):
        return TrainingSetup(oracle(plant) if strategy == "oracle" else PRIOR, Fixed())
    model = dataclasses.replace(PRIOR, effects=tuple(effect(name) for name in AT_ONCE))
    neutral = {f"{name}.{key}": value for name in AT_ONCE for key, value in MAGNITUDES[name].numbers(0.0).items()}
    kinds = tuple(plausible_ranges(model, name) for name in AT_ONCE)
    return TrainingSetup(model, SingleEffect({"m": BOUNDS, "l": BOUNDS}, kinds, neutral))


def plausible_ranges(model: Model, name: str) -> dict[str, tuple[float, float]]:
    """The range of each of an effect's numbers: from nothing to the largest plausible, and as far to the other side
    where the model allows it and that is something else."""
    ranges, parameters = {}, model.parameters
    nothing, most = MAGNITUDES[name].numbers(0.0), MAGNITUDES[name].numbers(MAGNITUDES[name].largest)
    for key, end in most.items():
        p, other = parameters[f"{name}.{key}"], 2.0 * nothing[key] - end
        signed = p.bounds[0] <= other <= p.bounds[1] and nothing[key] == p.neutral
        ranges[f"{name}.{key}"] = (min(end, other), max(end, other)) if signed else tuple(sorted((nothing[key], end)))
    return ranges
