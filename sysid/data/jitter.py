"""Jitter: time stamps that are early or late at random, because a bus is polled or a message waits.

A moving joint was then read that much earlier or later: its angle is off by theta_dot times the error of the stamp.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sysid.physics.ops import Array

SPEED_SPAN = 0.1
"""Seconds over which the speed is averaged that turns an error of the stamp into one of the angle."""
DIFFERENCE_ORDERS = (4, 6, 8)
"""Orders of difference: the higher the order, the less is left of the motion, whereas jitter stays the same."""
BINS = 8
"""Bins of speed in each of which the size of the errors is found."""
FEWEST_ERRORS = 40
"""Least number of errors in a bin."""
VARIANCE_RATIOS = tuple(2.0**k for k in range(1, 25))
"""Ratios that are tried of the error variance by jitter to the angle's own; from 2, as jitter must be most of it."""
BETTER = 0.75
"""Jitter is found where it lowers the misfit to less than this share."""
AGREE = 1.5
"""If the lowest order gives this many times the jitter that the highest gives, what it sees is the motion."""


def speed_about(theta: Array, dt: float) -> Array:
    """The mean speed (K,) [rad/s] over a tenth of a second (four samples at least) about each reading."""
    half = max(2, round(0.5 * SPEED_SPAN / dt))
    at = np.arange(len(theta))
    after, before = np.minimum(at + half, len(theta) - 1), np.maximum(at - half, 0)
    return (theta[after] - theta[before]) / np.maximum((after - before) * dt, 1e-300)


def stamp_jitter(angles: Sequence[Array], dt: float, floor: float) -> tuple[float, float]:
    """The sd of the stamps [s], and that of the angle's own error [rad]; (0, 0) where jitter is not most of the error.

        var(D^m theta) / C(2m, m) = sd^2 + jitter^2 theta_dot^2

    for the m-th difference D^m of the readings. The left side is the median of |D^m theta| in bins of speed, at least
    the `floor` [rad] of rounding, squared. The right side is fitted by least absolute deviations of logarithms, which
    one odd bin does not bend. What seems to be jitter but falls with m is fast motion.
    """
    estimates = [_by_order(angles, dt, m, floor) for m in DIFFERENCE_ORDERS]
    if any(jitter == 0.0 for jitter, _ in estimates) or estimates[0][0] > AGREE * estimates[-1][0]:
        return 0.0, 0.0
    return min(estimates)


def _by_order(angles: Sequence[Array], dt: float, m: int, floor: float) -> tuple[float, float]:
    """(jitter, sd) by differences of one order; (0, 0) where the jitter does not show, or is not most of the error."""
    errors, speeds = [np.zeros(0)], [np.zeros(0)]
    for theta in angles:
        if len(theta) > 2 * m:
            errors.append(np.abs(np.diff(theta, m)) / math.sqrt(math.comb(2 * m, m)))
            speeds.append(np.abs(speed_about(theta, dt))[m // 2 : len(theta) - (m - m // 2)])
    error, speed = np.concatenate(errors), np.concatenate(speeds)
    if len(error) < BINS * FEWEST_ERRORS:
        return 0.0, 0.0
    bins = np.array_split(np.argsort(speed), BINS)
    variance = np.array([max(float(np.median(error[rows])) / 0.6745, floor) ** 2 for rows in bins])
    square = np.array([float(np.mean(speed[rows] ** 2)) for rows in bins])
    mean = float(np.mean(square))
    if not (mean > 0.0 and np.all(variance > 0.0)):
        return 0.0, 0.0
    ratios = np.array([0.0, *VARIANCE_RATIOS])
    log_own_variance = np.log(variance) - np.log1p(ratios[:, None] * square / mean)
    misfit = np.sum(np.abs(log_own_variance - np.median(log_own_variance, axis=1, keepdims=True)), axis=1)
    best = int(np.argmin(misfit))
    if misfit[best] >= BETTER * misfit[0]:
        return 0.0, 0.0
    sd = math.exp(0.5 * float(np.median(log_own_variance[best])))
    return sd * math.sqrt(float(ratios[best]) / mean), sd
