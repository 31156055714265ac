"""Dynamic programming in the place of training: how much of a gap is structure, how much identification.

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
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from policies.control.dynamic_programming import Grid
from policies.evaluation import Policy, batch_returns, fresh_start_states
from study.mismatch.ground_truth import DESIGN_SUBSTEPS, design, ground_truth, machine, oracle
from study.mismatch.mismatch_results import DESIGNS, Designed
from study.mismatch.plan import Plan
from study.mismatch.trainings import TrainingSetup, training_setup_of
from study.pipeline.executor import Brief, Link
from study.pipeline.settings import digest
from sysid import InvalidInput, Model

OPTIMUM, PLAIN = "optimum", "plain"


def model_key(setup: TrainingSetup) -> str:
    """Sixteen hexadecimal digits of the model at the centre."""
    data = setup.to_json()
    return digest([data["model"], data["outside"]])


@dataclass(frozen=True)
class DesignTask(Brief):
    """Design on the models of some seeds, each once, and run on a hidden plant from the start states of their seeds.

    models   by key, as TrainingSetup.to_json; wanted: (seed, key) of what is run beside optimum and plain
    """

    plan: Plan
    plant: str
    seeds: tuple[int, ...]
    models: tuple[tuple[str, dict[str, Any]], ...]
    wanted: tuple[tuple[int, str], ...]
    activity: ClassVar[str] = "dynamic programming"
    table: ClassVar[Any] = DESIGNS

    @property
    def name(self) -> str:
        return f"designs for {self.plant}, seeds {self.seeds[0]} to {self.seeds[-1]}"

    @property
    def work(self) -> float:
        return 3.0 * (len(self.models) + 2) * (self.plan.grid / 120.0) ** 2

    def run(self, link: Link) -> list[Designed]:
        """The returns of every design; none of a model that no table can be made for."""
        begin = time.perf_counter()
        made = self._designs(link)
        pairs = [(seed, key) for seed in self.seeds for key in (OPTIMUM, PLAIN)] + list(self.wanted)
        pairs = [(seed, key) for seed, key in pairs if key in made]
        starts = [fresh_start_states(seed, self.plan.episodes) for seed, _ in pairs]
        plant = ground_truth(self.plan.plant(self.plant))
        reached = batch_returns([made[key] for _, key in pairs], plant, *map(np.array, zip(*starts, strict=True)))
        seconds = (time.perf_counter() - begin) / len(pairs)
        return [
            Designed(self.plant, key, seed, tuple(row), seconds)
            for (seed, key), row in zip(pairs, reached.tolist(), strict=True)
        ]

    def _designs(self, link: Link) -> dict[str, Policy]:
        models: list[tuple[str, Model]] = [(OPTIMUM, oracle(self.plan.plant(self.plant)))]
        models.append((PLAIN, machine(substeps=DESIGN_SUBSTEPS)))
        models += [(key, training_setup_of(data).model) for key, data in self.models]
        grid, made = Grid(theta=self.plan.grid, theta_dot=self.plan.grid + 1), dict[str, Policy]()
        for k, (key, model) in enumerate(models):
            try:
                made[key] = design(model, grid)
            except InvalidInput:  # a fitted model that no table can be made for has no row
                if key in (OPTIMUM, PLAIN):
                    raise
            link.progress((k + 1) / (len(models) + 1))
        return made
