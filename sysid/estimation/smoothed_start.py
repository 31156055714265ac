"""Starting points for a fit: smoothed states without a model, and starting numbers for the parameters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbsv

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.physics.ops import Array
from sysid.physics.parameters import Parameter

JERK = 60.0
"""Density of the white jerk [rad/s^3 s^1/2 per rad of reach] of a machine that swings in some tenths of a second."""
QUICKER = (1.0, 1e2, 1e4, 1e6, 1e8)
"""Factors of that for quicker machines; the first that suffices is taken."""
LARGEST_MISFIT = 5.0
"""The allowed RMS of readings less motion, in units of the noise; a hand's push makes 4."""


def parameter_starts(parameters: Sequence[Parameter]) -> Iterator[Array]:
    """Endless starting numbers (P,): first the model's own, then Halton points about them.

    A number at its bound starts a little inside, since a friction or a delay has no slope to follow at its bound.
    """
    numbers = np.array([float(p.value) for p in parameters])
    low, high = (np.array([p.bounds[side] for p in parameters]) for side in (0, 1))
    inside = 0.05 * np.array([p.scale for p in parameters])
    yield np.where(numbers <= low, low + inside, np.where(numbers >= high, high - inside, numbers))
    from scipy.stats import qmc  # loads for 0.3 s, and most fits need one start

    points = qmc.Halton(len(parameters), scramble=False)
    points.fast_forward(1)  # the first point is a corner
    while True:
        unit = points.random(1)[0]
        yield np.array([_spread(p, s) for p, s in zip(parameters, unit, strict=True)])


def _spread(p: Parameter, unit: float) -> float:
    """A number within narrow bounds, else within a factor of three of the present number, or one scale about zero."""
    (low, high), size = p.bounds, p.scale
    if high - low <= 10.0 * size:
        return low + unit * (high - low)
    spread = p.value * 3.0 ** (2.0 * unit - 1.0) if p.value else size * (2.0 * unit - 1.0)
    return min(max(abs(spread) if low >= 0.0 else spread, low), high)


@lru_cache(maxsize=256)
def smooth_states(record: Record, sensor: Sensor, reach: float = 1.0) -> Array:
    """States (N+1, 2) of the smoothest motion that follows a record's readings, without any model of the machine.

    The first of several densities of the jerk is taken with which the motion follows the readings to a few times their
    noise; only a fast machine needs another than the first.
    """
    for quicker in QUICKER:
        states = _smoothest(record, sensor, reach, JERK * quicker)
        if _misfit(states, record, sensor) < LARGEST_MISFIT:
            break
    return states


def _misfit(states: Array, record: Record, sensor: Sensor) -> float:
    """The RMS of the readings less the states (N+1, 2), in units of the sensor's sd."""
    values, sds = sensor.readings(record)
    read = np.isfinite(sds)
    return float(np.sqrt(np.mean(np.square((values - states)[read] / sds[read]))))


def _smoothest(record: Record, sensor: Sensor, reach: float, jerk: float) -> Array:
    """The smoothest motion (N+1, 2) for one density of the jerk, with an acceleration a that is constant over a step.

        min  sum |reading - state|^2 / sd^2  +  sum (a_(k+1) - a_k)^2 / ((jerk reach)^2 dt),    theta_ddot = a

    This is a Kalman smoother, written as one banded least-squares problem: white noise of density jerk times reach
    [rad/s^3 s^1/2] drives the acceleration (reach as in `Extent`).
    """
    n, dt = len(record), record.dt
    band, right = np.zeros((6, 3 * (n + 1))), np.zeros(3 * (n + 1))  # of the normal equations, which reach five apart

    def add(
        columns: list[NDArray[np.intp]], weights: list[float], sd: Array | float, target: Array | float = 0.0
    ) -> None:
        """Add equations  sum_i weights[i] x[columns[i]] = target  of this sd, one for each row of the columns."""
        for i, weight in zip(columns, weights, strict=True):
            right[i] += weight / sd**2 * target
            for j, other in zip(columns, weights, strict=True):
                if i[0] >= j[0]:
                    band[i - j, j] += weight * other / sd**2

    values, sds = sensor.readings(record)
    for channel in range(2):
        at = np.flatnonzero(np.isfinite(sds[:, channel]))
        if len(at):
            add([3 * at + channel], [1.0], sds[at, channel], values[at, channel])
    k = 3 * np.arange(n)
    exact = 1e-3 * max(reach, sensor.theta_dot or 0.0)  # much less would drown in rounding
    add([k, k + 1, k + 2, k + 3], [1.0, dt, 0.5 * dt * dt, -1.0], exact * dt)
    add([k + 1, k + 2, k + 4], [1.0, dt, -1.0], exact)
    add([k + 2, k + 5], [1.0, -1.0], jerk * reach * math.sqrt(dt))
    # without any reading of the angle the start angle is arbitrary, and hanging is the likeliest; a much weaker pin
    # would drown in the rounding of the equations of motion
    pinned = 1e3 * reach if record.theta is not None and sensor.theta is not None else 1.0
    add([np.array([0])], [1.0], pinned, math.pi)
    _, x, _ = dpbsv(band, right, lower=1)
    return x.reshape(-1, 3)[:, :2]
