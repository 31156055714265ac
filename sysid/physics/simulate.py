"""Simulation: rollouts of a model, one or thousands at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import InvalidInput
from sysid.physics.model import Model
from sysid.physics.ops import Array, Value


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Noise-free rollouts: t (N+1,) [s], u (..., N) [N m], theta and theta_dot (..., N+1) [rad], [rad/s].

    theta_read and theta_dot_read (..., N+1) are what perfect sensors would show: the states themselves, where the
    model has no output effect.
    """

    t: Array
    u: Array
    theta: Array
    theta_dot: Array
    theta_read: Array
    theta_dot_read: Array


def simulate(model: Model, u: ArrayLike, theta: ArrayLike, theta_dot: ArrayLike) -> Trajectory:
    """Roll a model out from theta [rad], theta_dot [rad/s] (...,) under the commands u (..., N) [N m].

    Leading shapes broadcast, also against array-valued parameters: one call runs one rollout or thousands.
    Raises InvalidInput for an empty u, for numbers that are not finite and for |u| beyond the model's limit.
    """
    try:
        u, theta, theta_dot = (np.asarray(a, dtype=float) for a in (u, theta, theta_dot))
    except (TypeError, ValueError):
        raise InvalidInput("u, theta or theta_dot is ragged or not numeric: expected arrays of numbers") from None
    if u.ndim == 0 or u.shape[-1] == 0:
        raise InvalidInput(f"u has shape {u.shape}: expected (..., N) with at least one command")
    if not np.all(np.isfinite(u)):
        raise InvalidInput("u has values that are not finite: expected torques [N m]")
    if np.max(np.abs(u)) > model.u_max * (1.0 + 1e-9):
        largest = np.max(np.abs(u))
        raise InvalidInput(f"|u| reaches {largest:g} N m, beyond the model's limit {model.u_max:g} N m")
    if not (np.all(np.isfinite(theta)) and np.all(np.isfinite(theta_dot))):
        raise InvalidInput("the start state is not finite: expected theta [rad] and theta_dot [rad/s]")
    shapes = [u.shape[:-1], theta.shape, theta_dot.shape, *(np.shape(p.value) for p in model.parameters.values())]
    try:
        shape = np.broadcast_shapes(*shapes)
    except ValueError:
        came = ", ".join(map(str, sorted(set(shapes) - {()})))
        raise InvalidInput(f"rollouts, start states and parameters have shapes {came}: they do not broadcast") from None
    n = u.shape[-1]
    now: tuple[Value, Value] = np.broadcast_to(theta, shape), np.broadcast_to(theta_dot, shape)
    states: Value = np.empty((2, n + 1, *shape))
    seen: Value = np.empty((2, n + 1, *shape))
    drives = model.drives(list(np.moveaxis(u, -1, 0)), now[0])
    sensing = model.sensing(*now)
    for k in range(n + 1):
        states[:, k] = now
        seen[:, k], sensing = model.read(*now, sensing, k * model.dt)
        if k < n:
            now = model.move(*now, next(drives), k * model.dt)
    rows = np.moveaxis(np.concatenate([states, seen]), 1, -1)
    return Trajectory(
        t=model.dt * np.arange(n + 1),
        u=np.broadcast_to(u, (*shape, n)),
        theta=rows[0],
        theta_dot=rows[1],
        theta_read=rows[2],
        theta_dot_read=rows[3],
    )
