"""States and summaries of readings, for strategies that compare rollouts with simulated ones."""

from __future__ import annotations

from functools import cache

import numpy as np

from sysid import Record, Sensor
from sysid.physics.ops import Array

REACH = 4
"""Readings on either side that a smoothed state is fitted to: 0.2 s at 50 ms."""


def smoothed(record: Record, sensor: Sensor) -> tuple[Array, Array]:
    """theta (N+1,) [rad] and theta_dot (N+1,) [rad/s] of a record; see `smooth`."""
    assert record.theta is not None and record.theta_dot is not None
    return smooth(record.theta, record.theta_dot, sensor, float(record.t[1] - record.t[0]))


def smooth(theta: Array, theta_dot: Array, sensor: Sensor, dt: float) -> tuple[Array, Array]:
    """States (..., N+1) from readings theta (..., N+1) or (..., 1) and theta_dot (..., N+1): at every instant a cubic
    through the readings around it.

    Least squares with the weights of the sensor's errors. Where the angle was read at the start alone, it is that plus
    the integral of the speed.
    """
    count, whole = theta_dot.shape[-1], reads_angles(theta)
    of_angles, of_speeds = _operators(count, round(dt, 9), sensor.theta if whole else None, sensor.theta_dot)
    if whole:
        angle, speed = (theta @ of_angles[i].T + theta_dot @ of_speeds[i].T for i in (0, 1))
        return angle, speed
    speed = theta_dot @ of_speeds[1].T
    turned = np.cumsum(0.5 * dt * (speed[..., 1:] + speed[..., :-1]), axis=-1)
    return theta + np.concatenate([0.0 * turned[..., :1], turned], axis=-1), speed


def smoothing_covariance(sensor: Sensor, dt: float) -> Array:
    """Of the error (2, 2) of a smoothed state amid a record whose angle was read all the time."""
    return _projector(REACH, REACH, dt, sensor.theta, sensor.theta_dot)[1]


@cache
def _operators(count: int, dt: float, theta: float | None, theta_dot: float | None) -> tuple[Array, Array]:
    """What angles, and what speeds, are multiplied with to give both states at every instant (2, N+1, N+1)."""
    operators = np.zeros((2, 2, count, count))
    for k in range(count):
        before, after = min(k, REACH), min(count - 1 - k, REACH)
        rows, _ = _projector(before, after, dt, theta, theta_dot)
        parts = [0.0 * rows, rows] if theta is None else np.split(rows, 2, axis=1)
        for channel, part in zip(operators, parts, strict=True):
            channel[:, k, k - before : k + after + 1] = part
    return operators[0], operators[1]


@cache
def _projector(before: int, after: int, dt: float, theta: float | None, theta_dot: float | None) -> tuple[Array, Array]:
    """What readings around an instant are multiplied with to give the state there (2, R), and its covariance (2, 2).

    theta = a + b s + c s^2 / 2 + d s^3 / 6,   theta_dot = b + c s + d s^2 / 2
    """
    s = dt * np.arange(-before, after + 1)
    one = np.ones_like(s)
    angle = np.stack([one, s, s**2 / 2.0, s**3 / 6.0], 1)
    speed = np.stack([0.0 * one, one, s, s**2 / 2.0], 1)
    rows = [(basis, sd) for basis, sd in ((angle, theta), (speed, theta_dot)) if sd is not None]
    weight = np.concatenate([np.full(len(s), 1.0 / sd) for _, sd in rows])
    solved = np.linalg.pinv(np.concatenate([basis / sd for basis, sd in rows]))
    return (solved * weight)[:2], (solved @ solved.T)[:2, :2]


def sensed(
    theta: Array, theta_dot: Array, sensor: Sensor, whole: bool, rng: np.random.Generator
) -> tuple[Array, Array]:
    """What a sensor makes of states (..., N+1): angles all the time if `whole`, or else at the start alone, speeds."""
    angle = theta if whole else theta[..., :1]
    first = angle + (sensor.theta or 0.0) * rng.standard_normal(angle.shape)
    return first, theta_dot + (sensor.theta_dot or 0.0) * rng.standard_normal(theta_dot.shape)


def reads_angles(theta: Array) -> bool:
    """Whether readings of the angle (..., N+1) are more than that of the start (..., 1)."""
    return theta.shape[-1] > 1


def summary_statistics(u: Array, theta_dot: Array, theta: Array | None = None) -> Array:
    """Statistics (..., F) of speeds (..., N+1) under torques u (..., N), and of angles (..., N+1) where they are known.

    Of the change d of the speed from an instant to the next: its mean, the log of its variance, and its mean products
    with the torque and with sin theta, the latter squared too. The products with actions and states, means and
    variances of Ramos, Possas and Fox, "BayesSim", RSS 2019, with the angle as gravity sees it.
    """
    d = np.diff(theta_dot, axis=-1)
    features = [np.mean(d, -1), np.log(np.var(d, -1) + 1e-12), np.mean(d * u, -1)]
    if theta is not None:
        side = np.sin(theta[..., :-1])
        features += [np.mean(d * side, -1), np.mean(side**2, -1)]
    return np.stack(features, -1)
