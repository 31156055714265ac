"""What a controller is designed on: a model seen as the map x' = f(x, u) of x = (theta, theta_dot)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from sysid import Delay, InvalidInput, Model, ops
from sysid.physics.ops import Value

Step = Callable[[Value, Value, Value], tuple[Value, Value]]
"""(theta, theta_dot) after dt from theta [rad], theta_dot [rad/s] and the torque u [N m] held over dt."""


def step_of(model: Model) -> Step:
    """The model's own step without its bookkeeping, for designs that feed back theta and theta_dot alone.

    Raises InvalidInput for a model whose input effects remember past commands, with a parameter that is not one
    number, or with an effect that depends on time.
    """
    names = [e.name for e in model.input_effects if e.rest(model.dt)]
    if names:
        raise InvalidInput(
            f"the model's input effects ({', '.join(names)}) remember past commands: this controller is designed on a "
            "model without; drop them with model.without_effect(name) and evaluate the controller on the full model"
        )
    check_numbers(model)
    if not is_steady(model):
        raise InvalidInput("the model's effects depend on time: expected the same step at every instant")

    def step(theta: Value, theta_dot: Value, u: Value) -> tuple[Value, Value]:
        drives, _ = model.drive(u, model.rest())
        return model.move(theta, theta_dot, drives)

    return step


def check_numbers(model: Model) -> None:
    """Raise InvalidInput for a parameter that is not one number."""
    for name, p in model.parameters.items():
        if not ops.is_number(p.value) or np.ndim(p.value):
            raise InvalidInput(f"parameter {name} is {p.value}: a controller's design needs one number")


def is_steady(model: Model) -> bool:
    """Whether the joint moves in the same way at every instant."""
    now = _moved(model)
    return all(np.array_equal(now, _moved(model, t=t)) for t in (model.dt, 1.7, 9.1))


def is_periodic(model: Model) -> bool:
    """Whether the joint moves in the same way one turn further on; not where a spring winds up."""
    return bool(np.allclose(_moved(model), _moved(model, turn=2.0 * math.pi), rtol=0.0, atol=1e-9))


def _moved(model: Model, t: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """How far some states move (2, 7, 5) without drive, from t, a `turn` [rad] further on."""
    theta, theta_dot = np.linspace(-3.0, 3.0, 7)[:, None] + turn, np.linspace(-4.0, 4.0, 5)
    after = model.move(theta, theta_dot, (0.0,) * model.integrator.substeps, t)
    return np.stack(np.broadcast_arrays(after[0] - turn, after[1]))


def has_third_axis(model: Model) -> bool:
    """Whether a table of the optimum needs an axis beside theta and theta_dot: for what the input path remembers beyond
    whole samples of delay, or for time."""
    core, _ = without_dead_time(model)
    return any(e.rest(core.dt) for e in core.input_effects) or not is_steady(core)


def without_dead_time(model: Model) -> tuple[Model, int]:
    """The model without the whole samples of its delay, and their number d: its command k acts as the other's k + d.

    What is left of the delay, less than a sample, stays. Whole samples of delay commute with every input effect.
    """
    for e in model.input_effects:
        if isinstance(e, Delay):
            whole = math.floor(e.T / model.dt + 1e-9)
            rest = e.T - whole * model.dt
            left = model.without_effect(e.name)
            if rest > 1e-9 * model.dt:
                left = left.with_effect(dataclasses.replace(e, T=rest, longest=model.dt, bounds={}))
            return left, whole
    return model, 0
