"""Channels: which of a log's readings a fit relies on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.data.noise import sensor_noise
from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.physics.model import Model

COMPARED_OVER = 0.1
"""Time [s] over which a speed is compared with what the angle's readings say of it."""
LARGEST_ERROR = 2.0
"""A speed whose mean over that time errs so many times as much as the angle's slope tells a fifth of what is known."""
LARGEST_MISFIT = 3.0
"""Mean square of what a speed's integral misses of the angle's change, in units of what their noises explain."""
LARGEST_CORRELATION = 1.15
"""A speed whose errors are that much larger in all than from sample to sample was filtered with them."""
LARGEST_OFFSET = 15.0
"""A filtered speed that is off by that many sd (RMS) leads a search astray that does not know of the filter yet."""


def relied_on(model: Model, records: Sequence[Record], sensor: Sensor) -> Sensor:
    """The sensor without a speed that tells little beside the angle, or that is not the angle's speed.

    A drive's speed is often filtered and late, and no white noise describes its error: over spans of 0.1 s its integral
    is compared with the change of the angle, which needs no model. What is worth a fifth is not worth that risk. Where
    the model has an effect of the speed's sensor, the speed stays; also where it is that of a first-order filter and
    its error is white (it was rounded, or sent, behind the filter): that is an effect that a model can have.
    """
    if sensor.theta is None or sensor.theta_dot is None or model.output_effects:
        return sensor
    count = max(COMPARED_OVER / records[0].dt, 1.0)
    slope = _angle_sd(records, sensor) * math.sqrt(12.0 / count) / COMPARED_OVER
    mean = sensor.theta_dot / math.sqrt(count)
    if mean > LARGEST_ERROR * slope:
        return replace(sensor, theta_dot=None)
    if _missed(records, sensor)[0] < LARGEST_MISFIT:
        return sensor
    excess, off = _missed(records, sensor, filtered=True)
    described = excess < LARGEST_MISFIT and off < LARGEST_OFFSET and _white(records)
    return sensor if described else replace(sensor, theta_dot=None)


def found_sensor(model: Model, records: Sequence[Record]) -> Sensor:
    """The noise of the readings that a fit of the model relies on, found from the records."""
    return relied_on(model, records, sensor_noise(records).sensor)


def _angle_sd(records: Sequence[Record], sensor: Sensor) -> float:
    """RMS of what the angle's readings err by, that of their stamps with it."""
    variances = [own.sd**2 for r in records for own in sensor.readings(r) if own.channel == "theta" and r.has_angles]
    return math.sqrt(float(np.mean(np.concatenate(variances)))) if variances else float(sensor.theta or 0.0)


def _missed(records: Sequence[Record], sensor: Sensor, filtered: bool = False) -> tuple[float, float]:
    """How much more the speed's integral misses than both noises explain; offset and scale of the speed are no miss.

    Nor is, where it may be `filtered`, what a first-order filter w of time constant T leaves out, which is off by
    T w_dot: by how many sd (RMS) comes second.

        T w_dot = theta_dot - w,    int w dt = theta(t_1) - theta(t_0) - T (w(t_1) - w(t_0))
    """
    targets, regressors, expected, angle_sd = [], [], 0.0, _angle_sd(records, sensor)
    for r in records:
        m = max(2, round(COMPARED_OVER / r.dt))
        if r.theta is None or r.theta_dot is None or not r.has_angles or len(r) < 4 * m:
            continue
        v = r.theta_dot
        integral = r.dt * np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))])
        k = np.arange(0, len(r) - m, m)
        change = r.theta[k + m] - r.theta[k]
        targets.append(change - (integral[k + m] - integral[k]))
        regressors.append(np.column_stack([np.ones(len(k)), change, filtered * (v[k + m] - v[k])]))
        expected = 2.0 * angle_sd**2 + r.dt**2 * m * float(sensor.theta_dot or 0.0) ** 2
    if not targets:
        return 0.0, 0.0
    A, b = np.concatenate(regressors), np.concatenate(targets)
    found = np.linalg.lstsq(A, b, rcond=None)[0]
    rest = b - A @ found
    off = abs(found[2]) * float(np.sqrt(np.mean(A[:, 2] ** 2))) / COMPARED_OVER / float(sensor.theta_dot or math.inf)
    return float(rest @ rest) / max(len(b) - 2 - filtered, 1) / expected, off


def _white(records: Sequence[Record]) -> bool:
    """Whether the speed's errors are as large from sample to sample (in their sixth differences) as they are in all."""
    try:
        in_all = sensor_noise([replace(r, theta=None) for r in records]).sensor.theta_dot or math.inf
    except InvalidInput:  # too few readings
        return False
    sixth = np.concatenate([np.diff(r.theta_dot, 6) for r in records if r.theta_dot is not None])
    return in_all < LARGEST_CORRELATION * float(np.median(np.abs(sixth))) / 0.6745 / math.sqrt(math.comb(12, 6))
