"""Simulation: rollouts of a model, one or thousands at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import InvalidInput
from sysid.physics.model import Model, check_model
from sysid.physics.ops import Array, Value


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Rollouts without noise.

    Attributes
    ----------
    t : array (N+1,)
        Instants [s].
    u : array (..., N)
        The commands [N m].
    theta, theta_dot : array (..., N+1)
        The states [rad], [rad/s].
    theta_read, theta_dot_read : array (..., N+1)
        What perfect sensors would show [rad], [rad/s]: the states themselves, where the model has no output effect.
    """

    t: Array
    u: Array
    theta: Array
    theta_dot: Array
    theta_read: Array
    theta_dot_read: Array


def simulate(model: Model, u: ArrayLike, theta: ArrayLike, theta_dot: ArrayLike) -> Trajectory:
    """Roll a model out under commands; one call runs one rollout or thousands.

    Parameters
    ----------
    model : Model
        Its parameters may be arrays, which broadcast with the leading shapes of the others.
    u : array (..., N)
        Commands, each held over the model's dt, in the unit of its actuator, a torque [N m] without one.
    theta, theta_dot : array (...)
        The start states [rad], [rad/s].

    Returns
    -------
    Trajectory
        N + 1 instants of each rollout, without noise; `Sensor.measure` reads them.

    Raises
    ------
    InvalidInput
        For an empty u, for numbers that are not finite, for |u| beyond the model's limit and for shapes that do not
        broadcast.
    """
    check_model(model)
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
    sensing, inner = model.sensing(*now), model.inner_rest(now[0])
    for k in range(n + 1):
        states[:, k] = now
        seen[:, k], sensing = model.read(*now, sensing, k * model.dt)
        if k < n:
            theta, theta_dot, inner = model.move_with_inner(*now, inner, next(drives), k * model.dt)
            now = theta, theta_dot
    rows = np.moveaxis(np.concatenate([states, seen]), 1, -1)
    return Trajectory(
        t=model.dt * np.arange(n + 1),
        u=np.broadcast_to(u, (*shape, n)),
        theta=rows[0],
        theta_dot=rows[1],
        theta_read=rows[2],
        theta_dot_read=rows[3],
    )
