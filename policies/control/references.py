"""What else can be had on a model: the optimum, and two controllers of the textbook.

for reference in references(machine, *fresh_start_states(0, 200)):
    print(reference.name, reference.evaluation or reference.note)
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

from policies.control.design_model import has_third_axis, is_periodic
from policies.control.dynamic_programming import Grid
from policies.control.lqr import design_lqr
from policies.control.predictive import design_predictive
from policies.control.swing_up import design_swing_up
from policies.environments import task
from policies.evaluation import Evaluation, Policy, evaluate
from sysid import DeadZone, Effect, InvalidInput, Model
from sysid.physics.ops import Array

FINE, COARSE = Grid(), Grid(theta=180, theta_dot=181)
"""Tables of the optimum; the second where it costs many times as much."""
LONG = 1000
"""Steps in an episode from which a fine table, kept for each of them, takes a gigabyte."""
SPEED = 8.0
"""Least speed [rad/s] up to which dynamic programming looks, and the paper's."""


@dataclass(frozen=True, eq=False)
class ReferenceReturn:
    """A controller's returns on a model; None where it cannot be had. The note says why, or what it does not know."""

    name: str
    evaluation: Evaluation | None
    note: str = ""


def references(model: Model, theta: Array, theta_dot: Array) -> tuple[ReferenceReturn, ...]:
    """Optimum, swing-up + LQR and LQR on the model, from the same start states.

    The optimum knows the state. The other two act on what the sensors show, and are designed without what has no linear
    feedback: memory of the input path, dead zones, dry friction, sensing.
    """
    sensing = model.output_effects
    remembering = (e for e in model.input_effects if e.rest(model.dt) or isinstance(e, DeadZone))
    left_out = (*remembering, *model.dry_frictions, *sensing)
    note = f"designed without {', '.join(e.name for e in left_out)}" if left_out else ""
    known, simple = _without(model, sensing), _without(model, left_out)

    def returned(name: str, design: Callable[[Model], Policy], on: Model, plant: Model, said: str) -> ReferenceReturn:
        try:
            return ReferenceReturn(name, evaluate(design(on), plant, theta, theta_dot), said)
        except InvalidInput as error:
            return ReferenceReturn(name, None, " ".join(str(error).split()))

    return (
        returned("optimum (dynamic programming)", _optimal, known, known, ""),
        returned("swing-up, then LQR", design_swing_up, simple, model, note),
        returned("LQR", design_lqr, simple, model, note),
    )


def _without(model: Model, effects: tuple[Effect, ...]) -> Model:
    return dataclasses.replace(model, effects=tuple(e for e in model.effects if e not in effects))


def _optimal(model: Model) -> Policy:
    costly = not is_periodic(model) or has_third_axis(model) or task.horizon(model.dt) > LONG
    grid = COARSE if costly else FINE
    return design_predictive(model, spanning(grid, model))


def spanning(grid: Grid, model: Model) -> Grid:
    """The same nodes over the speeds that the model reaches: up to where it clips them, else to 1.5 times that of a
    fall from the upright."""
    clipped = getattr(model.integrator, "theta_dot_max", math.inf)
    G = abs(float(model.plant.largest_gravity_torque))
    fastest = min(clipped, max(SPEED, 1.5 * math.sqrt(1.0 + 4.0 * G / float(model.inertia()))))
    return dataclasses.replace(grid, theta_dot_max=fastest)
