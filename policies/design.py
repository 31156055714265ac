"""What a controller is designed on: a model seen as the map x' = f(x, u) of x = (theta, theta_dot)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sysid import InvalidInput, Model, ops
from sysid.ops import Value

Step = Callable[[Value, Value, Value], tuple[Value, Value]]
"""(theta, theta_dot) after dt from theta [rad], theta_dot [rad/s] and the torque u [N m] held over dt."""


def step_of(model: Model) -> Step:
    """The model's own step without its bookkeeping, for designs that feed back theta and theta_dot alone.

    Raises InvalidInput for a model with input effects (they may remember past commands), with a parameter
    that is not one number, or with an effect that depends on time.
    """
    if model.input_effects:
        names = ", ".join(e.name for e in model.input_effects)
        raise InvalidInput(
            f"the model has input effects ({names}): a controller is designed on a model without; "
            "drop them with model.without_effect(name) and evaluate the controller on the full model"
        )
    for name, p in model.parameters.items():
        if not ops.is_number(p.value) or np.ndim(p.value):
            raise InvalidInput(f"parameter {name} is {p.value}: a controller's design needs one number")

    def step(theta: Value, theta_dot: Value, u: Value, t: float = 0.0) -> tuple[Value, Value]:
        return model.move(theta, theta_dot, (u,) * model.integrator.substeps, t)

    theta, theta_dot = np.linspace(-3.0, 3.0, 7)[:, None], np.linspace(-4.0, 4.0, 5)
    now = step(theta, theta_dot, 0.0)
    if any(not np.array_equal(now, step(theta, theta_dot, 0.0, t)) for t in (model.dt, 1.7, 9.1)):
        raise InvalidInput("the model's effects depend on time: expected the same step at every instant")
    return step
