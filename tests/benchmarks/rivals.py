"""What each catalogue effect could do along a true motion: the rivals that decidability weighs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tests.benchmarks.decidability import Family, Motions
from tests.benchmarks.truth import Array

ORDERS = range(2, 13)
SPEEDS = (0.1, 0.3, 0.8)  # [rad/s] of Stribeck's curve
MOST_ROWS = 5.0


def rivals(motions: Motions) -> Mapping[str, list[Family]]:
    """Every effect's families, by name. Twins (see decidability.TWINS) stand once."""
    return _friction(motions) | _angle_and_time(motions) | _command(motions) | _sensors(motions)


def _friction(x: Motions) -> dict[str, list[Family]]:
    v = x.cells(x.theta_dot)
    way = np.sign(v)
    transmitted = x.u - x.G * x.cells(np.sin(x.theta))
    forward, back = np.maximum(way, 0.0), np.minimum(way, 0.0)

    def family(*torques: Array) -> Family:
        return Family(-np.stack(torques), signed=False)

    return {
        "viscous": [family(v)],
        "coulomb": [family(way)],
        "stribeck": [family(way, way * np.exp(-((v / s) ** 2))) for s in SPEEDS],
        "drag": [family(np.abs(v) * v)],
        "asymmetric_viscous": [family(np.maximum(v, 0.0), np.minimum(v, 0.0))],
        "asymmetric_coulomb": [family(forward, back)],
        "load_friction": [family(np.abs(transmitted) * way)],
    }


def _angle_and_time(x: Motions) -> dict[str, list[Family]]:
    theta = x.cells(x.theta)
    t = x.cells(x.t) + np.zeros_like(theta)
    ends = x.t[-1]
    frequencies = np.arange(1.0 / ends, min(0.4 / x.world.log.dt, 6.0), 0.5 / ends)
    return {
        "torque_bias": [Family(np.ones_like(theta)[None])],
        "tilt": [Family(np.cos(theta)[None])],
        "spring": [Family(theta[None] - np.pi)],
        "ripple": [Family(np.stack([np.sin(k * theta), np.cos(k * theta)])) for k in ORDERS],
        "periodic": [Family(np.stack([np.sin(2.0 * np.pi * f * t), np.cos(2.0 * np.pi * f * t)])) for f in frequencies],
        "drift": [Family(t[None])],
    }


def _command(x: Motions) -> dict[str, list[Family]]:
    dt, peak = x.world.log.dt, float(np.max(np.abs(x.u)))
    rows = np.arange(1, round(MOST_ROWS / 0.125) + 1) * 0.125

    def path(*commands: Array) -> Family:
        return Family(np.stack(commands) - x.u, path=True)

    late = [_shifted(x, r * dt) for r in rows]
    return {
        "stamp": [path(*late[:8]), path(*(_shifted(x, -r * dt) for r in rows[:8]))],
        "delay": [Family(np.stack(late[7:]) - x.u, path=True, begins=True)],
        "lag": [path(*(lagged(x.u, T, x.h) for T in dt * 2.0 ** np.arange(-4.0, 3.5, 0.5)))],
        "dead_zone": [path(*(x.u - np.clip(x.u, -d, d) for d in peak * 2.0 ** np.arange(-9.0, -1.5, 0.5)))],
        "saturation": [path(*(np.clip(x.u, -s * peak, s * peak) for s in np.arange(0.975, 0.2, -0.025)))],
    }


def _shifted(x: Motions, T: float) -> Array:
    """The command T [s] later, as means over the cells."""
    edges = x.h * np.arange(x.u.shape[1] + 1)
    total = np.concatenate([np.zeros((len(x.u), 1)), np.cumsum(x.u, axis=1) * x.h], axis=1)
    return np.array([np.diff(np.interp(edges - T, edges, row)) / x.h for row in total])


def lagged(u: Array, T: float, h: float) -> Array:
    """Means of a lag's answer over cells of h [s] to commands u (L, C) that are held over them."""
    decay = np.exp(-h / T)
    z, out = np.zeros(len(u)), np.empty_like(u)
    for c, s in enumerate(u.T):
        out[:, c] = s + (z - s) * T / h * (1.0 - decay)
        z = s + (z - s) * decay
    return out


def _sensors(x: Motions) -> dict[str, list[Family]]:
    theta, theta_dot = x.theta[:, :: x.fine], x.theta_dot[:, :: x.fine]
    none = np.zeros_like(theta)

    def family(angle: Array, speed: Array) -> Family:
        return Family(readings=np.stack([angle, speed], axis=-1)[None])

    play = [np.stack(_played(theta, theta_dot, w), axis=-1) for w in 2.0 ** np.arange(-10.0, -2.0, 0.5)]
    families = {"backlash": [Family(readings=np.stack(play), path=True)]}
    if x.world.log.theta_dot is not None:
        families |= {"velocity_bias": [family(none, none + 1.0)], "velocity_gain": [family(none, theta_dot)]}
    return families


def _played(theta: Array, theta_dot: Array, width: float) -> tuple[Array, Array]:
    """What play between joint and encoder adds to angle and speed."""
    y, angle, speed = theta[:, 0], np.zeros_like(theta), np.zeros_like(theta)
    for k in range(theta.shape[1]):
        moved = np.clip(y, theta[:, k] - 0.5 * width, theta[:, k] + 0.5 * width)
        angle[:, k] = moved - theta[:, k]
        speed[:, k] = np.where(moved == y, -theta_dot[:, k], 0.0)
        y = moved
    return angle, speed
