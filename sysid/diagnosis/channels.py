"""Channels: which of a log's readings a diagnosis relies on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.physics.model import Model

SPAN = 0.1
"""Time [s] over which a speed is compared with what the angle's readings say of it."""
LITTLE = 3.0
"""A speed whose mean over SPAN errs this many times as much as the angle's slope tells a tenth of what that tells."""
INCONSISTENT = 3.0
"""Mean square of what a speed's integral misses of the angle's change, in units of what their noises explain."""


def relied_on(model: Model, records: Sequence[Record], sensor: Sensor) -> Sensor:
    """The sensor without a speed that tells little beside the angle, or that is not the angle's speed.

    A drive's speed is often filtered and late, and no white noise describes its error: over spans of 0.1 s its integral
    is compared with the change of the angle, which needs no model. What is worth a tenth is not worth that risk. Where
    the model has an effect of the speed's sensor, the speed stays.
    """
    if sensor.theta is None or sensor.theta_dot is None or model.output_effects:
        return sensor
    count = max(SPAN / records[0].dt, 1.0)
    slope = sensor.theta * math.sqrt(12.0 / count) / SPAN
    mean = sensor.theta_dot / math.sqrt(count)
    if mean > LITTLE * slope or _excess(records, sensor) > INCONSISTENT:
        return replace(sensor, theta_dot=None)
    return sensor


def _excess(records: Sequence[Record], sensor: Sensor) -> float:
    """How much more the speed's integral misses than both noises explain; offset and scale of the speed are no miss."""
    targets, regressors, expected = [], [], 0.0
    for r in records:
        m = max(2, round(SPAN / r.dt))
        if r.theta is None or r.theta_dot is None or len(r) < 4 * m:
            continue
        v = r.theta_dot
        integral = r.dt * np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))])
        k = np.arange(0, len(r) - m, m)
        change = r.theta[k + m] - r.theta[k]
        targets.append(change - (integral[k + m] - integral[k]))
        regressors.append(np.column_stack([np.ones(len(k)), change]))
        expected = 2.0 * float(sensor.theta or 0.0) ** 2 + r.dt**2 * m * float(sensor.theta_dot or 0.0) ** 2
    if not targets:
        return 0.0
    A, b = np.concatenate(regressors), np.concatenate(targets)
    rest = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    return float(rest @ rest) / max(len(b) - 2, 1) / expected
