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

import hashlib
import json
import time
from dataclasses import dataclass
from typing import Any, ClassVar

from policies.abreast import returns
from policies.control.optimal import Grid
from policies.evaluate import Policy, fresh_start_states
from study.executors.executor import Brief, Link
from study.mismatch.effect_cost import design, machine
from study.mismatch.hidden import hidden_machine, oracle
from study.mismatch.plan import Plan
from study.mismatch.recipe import Recipe, recipe_of
from study.mismatch.results import Designed
from sysid import InvalidInput, Model

OPTIMUM, PLAIN = "optimum", "plain"

DESIGNED = ("z", "a", "b", "c")
"""Ways whose models are designed on; b+ and g have b's centre, f has c's."""

CENTER = {"b+": "b", "g": "b", "f": "c"}
"""The way whose model is the centre of another's."""


def model_key(recipe: Recipe) -> str:
    """Sixteen hexadecimal digits of the model at the centre."""
    data = recipe.to_json()
    text = json.dumps([data["model"], data["outside"]], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


@dataclass(frozen=True)
class DesignTask(Brief):
    """Design on each model, and run on a hidden plant from a seed's start states. models: (key, Recipe.to_json)."""

    plan: Plan
    plant: str
    seed: int
    models: tuple[tuple[str, dict[str, Any]], ...]
    activity: ClassVar[str] = "dynamic programming"

    @property
    def name(self) -> str:
        return f"designs for {self.plant}, seed {self.seed}"

    @property
    def work(self) -> float:
        """About how many seconds it takes on one core; only the time left is computed from it."""
        return 3.0 * (len(self.models) + 2) * (self.plan.grid / 120.0) ** 2

    def run(self, link: Link) -> list[Designed]:
        """The returns of every design; none of a model that no table can be made for."""
        plant = self.plan.plant(self.plant)
        models: list[tuple[str, Model]] = [(OPTIMUM, oracle(plant)), (PLAIN, machine(substeps=2))]
        models += [(key, recipe_of(data).model) for key, data in self.models]
        begin, made = time.perf_counter(), dict[str, Policy]()
        for k, (key, model) in enumerate(models):
            try:
                made[key] = design(model, Grid(theta=self.plan.grid, theta_dot=self.plan.grid + 1))
            except InvalidInput:
                continue
            link.progress((k + 1) / (len(models) + 1))
        reached = returns(
            tuple(made.values()), hidden_machine(plant), *fresh_start_states(self.seed, self.plan.episodes)
        )
        seconds = (time.perf_counter() - begin) / len(made)
        return [
            Designed(self.plant, key, self.seed, tuple(row), seconds)
            for key, row in zip(made, reached.tolist(), strict=True)
        ]
