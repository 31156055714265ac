"""Channels: whether a fit relies on the readings of the speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.data.noise import sensor_noise
from sysid.data.record import Record
from sysid.data.sensor import Sensor, check_sensor
from sysid.errors import InvalidInput
from sysid.physics.model import Model

COMPARED_OVER = 0.1
"""Time [s] over which the speed is compared with the slope of the angle's readings."""
LARGEST_ERROR = 2.0
"""Error of the speed's mean over that time, in units of the slope's: at 2 it holds a fifth of what is known."""
LARGEST_ANGLE_MISFIT = 3.0
"""Mean square by which the integral of a true speed misses the angle's change at most, over what the noises explain."""
LARGEST_CORRELATION = 1.15
"""Ratio of a speed's errors in all to those from sample to sample from which the errors were filtered, too."""
LARGEST_OFFSET = 15.0
"""RMS error [sd] by a filter's lag from which a speed leads a search astray, which does not know of the filter yet."""


def relied_on(model: Model, records: Sequence[Record], sensor: Sensor) -> Sensor:
    """The sensor, without its speed if that tells little beside the angle or is not the angle's speed.

    A drive's speed is often filtered and late, and then no white noise describes its error. A speed that holds less
    than a fifth of what is known of the motion is not worth that risk. Any other has to integrate to the change of the
    angle over spans of 0.1 s, a test that needs no model. If it fails, the speed stays only if it is the output of a
    first-order filter with white errors (it was rounded, or sent, behind the filter): a model can have that effect.
    Where the model has an effect of a sensor, the speed always stays.
    """
    check_sensor(sensor)
    if sensor.theta is None or sensor.theta_dot is None or model.output_effects:
        return sensor
    count = max(COMPARED_OVER / records[0].dt, 1.0)
    slope = _angle_sd(records, sensor) * math.sqrt(12.0 / count) / COMPARED_OVER
    mean = sensor.theta_dot / math.sqrt(count)
    if mean > LARGEST_ERROR * slope:
        return replace(sensor, theta_dot=None)
    if _missed(records, sensor)[0] < LARGEST_ANGLE_MISFIT:
        return sensor
    excess, off = _missed(records, sensor, filtered=True)
    described = excess < LARGEST_ANGLE_MISFIT and off < LARGEST_OFFSET and _white(records)
    return sensor if described else replace(sensor, theta_dot=None)


def found_sensor(model: Model, records: Sequence[Record]) -> Sensor:
    """The noise of the readings that a fit of the model relies on, found from the records."""
    return relied_on(model, records, sensor_noise(records).sensor)


def _angle_sd(records: Sequence[Record], sensor: Sensor) -> float:
    """The RMS error of the angle's readings, with the part that comes of their time stamps."""
    variances = [sensor.readings(r)[1][:, 0] ** 2 for r in records if r.has_angles]
    return math.sqrt(float(np.mean(np.concatenate(variances)))) if variances else float(sensor.theta or 0.0)


def _missed(records: Sequence[Record], sensor: Sensor, filtered: bool = False) -> tuple[float, float]:
    """The mean square by which the speed's integral misses the angle's change, over what both noises explain.

    An offset and a scale of the speed are fitted first. A `filtered` speed may be the output w of a first-order filter,
    whose time constant T is fitted, too; the second number is the RMS of its error T w_dot in sd.

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
    solution = np.linalg.lstsq(A, b, rcond=None)[0]
    rest = b - A @ solution
    off = abs(solution[2]) * float(np.sqrt(np.mean(A[:, 2] ** 2))) / COMPARED_OVER / float(sensor.theta_dot or math.inf)
    return float(rest @ rest) / max(len(b) - 2 - filtered, 1) / expected, off


def _white(records: Sequence[Record]) -> bool:
    """Whether the speed's errors are white: as large from sample to sample (in their sixth differences) as in all."""
    try:
        in_all = sensor_noise([replace(r, theta=None, whole=None) for r in records]).sensor.theta_dot or math.inf
    except InvalidInput:  # too few readings
        return False
    sixth = np.concatenate([np.diff(r.theta_dot, 6) for r in records if r.theta_dot is not None])
    return in_all < LARGEST_CORRELATION * float(np.median(np.abs(sixth))) / 0.6745 / math.sqrt(math.comb(12, 6))
