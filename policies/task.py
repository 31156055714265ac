"""The swing-up task: what a step costs, what a controller sees, how long an episode lasts and where it starts.

    cost = wrap(theta)^2 + 0.1 theta_dot^2 + 0.001 u^2        from the state before the step
    return = -(sum of the costs over 200 steps)

Gymnasium's Pendulum-v1 (Farama Foundation), with theta = 0 upright. The formulas go through sysid.ops, so that one
definition serves NumPy (evaluation, dynamic programming) and torch (training).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sysid import State, ops

HORIZON = 200
"""Steps in an episode."""

START_HIGH = (math.pi, 1.0)
"""Bounds of the start state: |theta| [rad], |theta_dot| [rad/s]."""


def cost(state: State, u: Any) -> Any:
    """Cost of one control interval, from the state before it and the command u [N m]; same shape as the state."""
    return ops.wrap(state.theta) ** 2 + 0.1 * state.theta_dot**2 + 0.001 * u**2


def reward(state: State, u: Any) -> Any:
    """The negative cost."""
    return -cost(state, u)


def observation(state: State) -> tuple[Any, Any, Any]:
    """(cos theta, sin theta, theta_dot), unscaled, in the precision and back end of the state; stack it as you need."""
    return ops.cos(state.theta), ops.sin(state.theta), state.theta_dot


def start_state(rng: np.random.Generator) -> tuple[float, float]:
    """Draw theta ~ U(-pi, pi) [rad] and theta_dot ~ U(-1, 1) [rad/s], in one call as Gymnasium's Pendulum does."""
    high = np.array(START_HIGH)
    theta, theta_dot = rng.uniform(low=-high, high=high)
    return float(theta), float(theta_dot)
