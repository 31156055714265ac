"""Jitter: stamps that are early or late at random, as of a bus that is polled or a message that waits.

A joint that moves was then read that much earlier or later, which is an error of its angle of theta_dot times as much.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sysid.physics.ops import Array

SPAN = 0.1
"""Seconds over which a speed is averaged that says how far a late reading is off."""
ORDERS = (4, 6, 8)
"""Orders of difference of which the motion leaves ever less, and jitter the same."""
BINS, FEWEST = 8, 40
"""Bins of the speed in which the errors are told, and errors that each needs."""
RATIOS = tuple(2.0**k for k in range(1, 25))
"""Mean squares of what jitter makes of the angle, over that of its own error, that are tried: jitter is most of it."""
BETTER = 0.75
"""Share of the misfit without jitter that is left where there is one."""
AGREE = 1.5
"""Ratio of the jitter by the lowest and by the highest order from which it is the motion."""


def speed_about(theta: Array, dt: float) -> Array:
    """The mean speed (K,) [rad/s] over a tenth of a second about each reading, or over four samples."""
    half = max(2, round(0.5 * SPAN / dt))
    at = np.arange(len(theta))
    after, before = np.minimum(at + half, len(theta) - 1), np.maximum(at - half, 0)
    return (theta[after] - theta[before]) / np.maximum((after - before) * dt, 1e-300)


def stamp_jitter(angles: Sequence[Array], dt: float, floor: float) -> tuple[float, float]:
    """The sd of the stamps [s], and that of the angle's own error [rad]; (0, 0) where jitter is not most of the error.

        var(D^m theta) / C(2m, m) = sd^2 + jitter^2 theta_dot^2

    of the m-th difference D^m of the readings, by the medians of |D^m theta| in bins of the speed (least absolute
    deviations of their logarithms, which one odd bin does not bend); an error below the `floor` [rad] is rounding.
    Where the motion is faster than the readings, what it leaves falls with m.
    """
    found = [_by_order(angles, dt, m, floor) for m in ORDERS]
    if any(jitter == 0.0 for jitter, _ in found) or found[0][0] > AGREE * found[-1][0]:
        return 0.0, 0.0
    return min(found)


def _by_order(angles: Sequence[Array], dt: float, m: int, floor: float) -> tuple[float, float]:
    """(jitter, sd) by differences of one order; (0, 0) where the jitter does not show, or is not most of the error."""
    errors, speeds = [np.zeros(0)], [np.zeros(0)]
    for theta in angles:
        if len(theta) > 2 * m:
            errors.append(np.abs(np.diff(theta, m)) / math.sqrt(math.comb(2 * m, m)))
            speeds.append(np.abs(speed_about(theta, dt))[m // 2 : len(theta) - (m - m // 2)])
    error, speed = np.concatenate(errors), np.concatenate(speeds)
    if len(error) < BINS * FEWEST:
        return 0.0, 0.0
    bins = np.array_split(np.argsort(speed), BINS)
    variance = np.array([max(float(np.median(error[own])) / 0.6745, floor) ** 2 for own in bins])
    square = np.array([float(np.mean(speed[own] ** 2)) for own in bins])
    mean = float(np.mean(square))
    if not (mean > 0.0 and np.all(variance > 0.0)):
        return 0.0, 0.0
    ratios = np.array([0.0, *RATIOS])
    own = np.log(variance) - np.log1p(ratios[:, None] * square / mean)
    misfit = np.sum(np.abs(own - np.median(own, axis=1, keepdims=True)), axis=1)
    best = int(np.argmin(misfit))
    if misfit[best] >= BETTER * misfit[0]:
        return 0.0, 0.0
    sd = math.exp(0.5 * float(np.median(own[best])))
    return sd * math.sqrt(float(ratios[best]) / mean), sd
