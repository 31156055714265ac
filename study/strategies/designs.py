"""Dynamic programming in the place of training: what is the optimum of a hidden plant, and what of a model, there?

    gap             = J(optimum) - J(agent)
    structure       = J(optimum) - J(plain)        what an effect costs that the model lacks; 0 where the model has it
    identification  = J(optimum or plain) - J(fitted)
    training        = J(fitted) - J(agent)

J is the mean return on the hidden plant from the same start states. optimum: designed on the hidden plant; plain: on
the rod with the true m and l and without the effect; fitted: on the model that was trained on, at its centre where a
band is drawn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from policies.control.dynamic_programming import Grid
from policies.evaluation import Policy, batch_returns, fresh_start_states
from study.pipeline.database import Database
from study.pipeline.executor import BriefTask
from study.pipeline.tables import ResultTable
from study.strategies.trial_plan import TrialPlan
from study.trials.ground_truth import DESIGN_SUBSTEPS, ground_truth, hidden_machine, near_optimal, oracle
from study.trials.training_setup import training_setup_of
from sysid import InvalidInput, Model

OPTIMUM, PLAIN_ROD = "optimum", "plain"

TOGETHER = 5
"""Seeds whose models are designed on in one task: what they share, the optimum above all, is designed once."""


@dataclass(frozen=True)
class Designed:
    """Returns (E,) on a hidden plant, from a seed's start states, of dynamic programming on the model of that key."""

    plant: str
    model: str
    seed: int
    returns: tuple[float, ...]
    seconds: float


DESIGNS = ResultTable("designs", Designed, "plant TEXT, model TEXT, seed INTEGER, returns TEXT, seconds REAL", keys=3)


def design_tasks(
    plan: TrialPlan, results: Database, fitted: Iterable[tuple[str, int, dict[str, Any]]] = ()
) -> Iterator[BriefTask]:
    """Designs that the results lack, of some seeds together.

    fitted: (plant, seed, TrainingSetup.to_json) of what is run beside optimum and plain rod
    """
    known = {(plant, seed) for plant, model, seed in results.keys(DESIGNS) if model == OPTIMUM}
    models: dict[str, dict[str, Any]] = {}
    wanted: dict[tuple[str, int], dict[str, None]] = {}
    for plant, seed, payload in fitted:
        key = training_setup_of(payload).model_key
        models[key] = payload
        wanted.setdefault((plant, seed), {})[key] = None
    for plant in (plant.name for plant in plan.plants):
        lacking = [seed for seed in plan.seeds if (plant, seed) not in known]
        for seeds in (lacking[i : i + TOGETHER] for i in range(0, len(lacking), TOGETHER)):
            pairs = [(seed, key) for seed in seeds for key in wanted.get((plant, seed), {})]
            payloads = {key: models[key] for _, key in pairs}
            name, work = f"designs for {plant}, seeds {seeds[0]} to {seeds[-1]}", 3.0 * (len(payloads) + 2)
            work *= (plan.grid / 120.0) ** 2
            yield BriefTask(
                name, "dynamic programming", work, DESIGNS, returns_of_designs, (plan, plant, seeds, payloads, pairs)
            )


def returns_of_designs(
    plan: TrialPlan,
    plant: str,
    seeds: Iterable[int],
    models: Mapping[str, dict[str, Any]],
    wanted: Iterable[tuple[int, str]],
    progress: Callable[[float], None],
) -> list[Designed]:
    """The returns of every design on a hidden plant from the start states of their seeds, each designed once; none of a
    model that no table can be made for.

    models: by key, as TrainingSetup.to_json; wanted: (seed, key) of what is run beside optimum and plain rod
    """
    begin = time.perf_counter()
    made = _designs(plan, plant, models, progress)
    pairs = [*((seed, key) for seed in seeds for key in (OPTIMUM, PLAIN_ROD)), *wanted]
    pairs = [(seed, key) for seed, key in pairs if key in made]
    starts = [fresh_start_states(seed, plan.episodes) for seed, _ in pairs]
    machine = ground_truth(plan.plant(plant))
    reached = batch_returns([made[key] for _, key in pairs], machine, *map(np.array, zip(*starts, strict=True)))
    seconds = (time.perf_counter() - begin) / len(pairs)
    return [
        Designed(plant, key, seed, tuple(row), seconds)
        for (seed, key), row in zip(pairs, reached.tolist(), strict=True)
    ]


def _designs(
    plan: TrialPlan, plant: str, payloads: Mapping[str, dict[str, Any]], progress: Callable[[float], None]
) -> dict[str, Policy]:
    models: dict[str, Model] = {OPTIMUM: oracle(plan.plant(plant))}
    models[PLAIN_ROD] = hidden_machine(substeps=DESIGN_SUBSTEPS)
    models |= {key: training_setup_of(data).model for key, data in payloads.items()}
    grid, made = Grid(theta=plan.grid, theta_dot=plan.grid + 1), dict[str, Policy]()
    for k, (key, model) in enumerate(models.items()):
        try:
            made[key] = near_optimal(model, grid)
        except InvalidInput:  # a fitted model that no table can be made for has no row
            if key in (OPTIMUM, PLAIN_ROD):
                raise
        progress((k + 1) / (len(models) + 1))
    return made
