"""The swing-up task: what a step costs, what a controller sees, how long an episode lasts and where it starts.

    cost = wrap(theta)^2 + 0.1 theta_dot^2 + 0.001 u^2        from the state before the step
    return = -(sum of dt/0.05 cost over 10 s)

Gymnasium's Pendulum-v1 (Farama Foundation), with theta = 0 upright. There dt = 0.05 s, so that the costs of 200 steps
are summed as they are; at another interval between commands the return is the same integral, in the same unit. The
formulas go through sysid.ops: one definition serves NumPy (evaluation, dynamic programming) and torch (training).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid import InvalidInput
from sysid.physics import ops
from sysid.physics.ops import Array

if TYPE_CHECKING:
    from sysid import Reading, State

DURATION = 10.0
"""Length of an episode [s]."""
INTERVAL = 0.05
"""Time between two commands [s] at which `cost` counts once."""
HORIZON = 200
"""Steps in an episode at INTERVAL."""
START_HIGH = (math.pi, 1.0)
"""Bounds of the start state: |theta| [rad], |theta_dot| [rad/s]."""


def horizon(dt: float) -> int:
    """Steps in an episode whose commands are held for dt [s]."""
    return max(1, round(DURATION / dt))


def check_history(history: int, dt: float) -> None:
    """Raise InvalidInput for fewer past commands than none, or more than an episode has."""
    if not 0 <= history <= horizon(dt):
        raise InvalidInput(f"history = {history}: expected 0 to {horizon(dt)}, the commands of an episode")


def cost(state: State, u: Any) -> Any:
    """Cost of one control interval, from the state before it and the command u [N m]; same shape as the state."""
    return ops.wrap(state.theta) ** 2 + 0.1 * state.theta_dot**2 + 0.001 * u**2


def reward(state: State, u: Any, dt: float = INTERVAL) -> Any:
    """What a step of dt [s] adds to the return: -dt/0.05 cost."""
    return -(dt / INTERVAL) * cost(state, u)


def observation(seen: State | Reading, past_commands: Sequence[Any] = ()) -> tuple[Any, ...]:
    """(cos theta, sin theta, theta_dot, *past_commands), unscaled, in the precision and back end of what is seen.

    past_commands: the last k, divided by u_max, the latest first, 0 before the start. A policy needs them where
    commands under way decide what comes, as with a delay. The entries are yet to be stacked.
    """
    return ops.cos(seen.theta), ops.sin(seen.theta), seen.theta_dot, *past_commands


def observation_names(history: int = 0) -> tuple[str, ...]:
    """What the entries of an observation with so many past commands are."""
    return "cos theta", "sin theta", "theta_dot [rad/s]", *(f"u[-{i + 1}] / u_max" for i in range(history))


def start_state(rng: np.random.Generator) -> tuple[float, float]:
    """Draw theta ~ U(-pi, pi) [rad] and theta_dot ~ U(-1, 1) [rad/s]: the numbers that Gymnasium's Pendulum draws."""
    theta, theta_dot = (rng.uniform(-high, high) for high in START_HIGH)
    return theta, theta_dot


def draw_start_states(rngs: Iterable[np.random.Generator]) -> Array:
    """Draw a start state from each generator in turn: theta and theta_dot, the rows of (2, E). [rng] * E draws all of
    them from one."""
    return np.array([start_state(rng) for rng in rngs]).reshape(-1, 2).T
