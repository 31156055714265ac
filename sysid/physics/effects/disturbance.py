"""Torques that come from outside, whatever the joint does."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sysid.physics import ops
from sysid.physics.effects.effect import Joint, JointEffect
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Extent, parameter

_MOST_FREQUENCIES = 200
PERIODIC = 0.8
"""Autocorrelation from which a motion counts as periodic."""
ALMOST = 0.97
"""The first peak of at least this share of the largest autocorrelation is the period, the largest a multiple."""


@dataclass(frozen=True, eq=False)
class TorqueBias(JointEffect):
    """A constant torque: the offset of a torque sensor or an amplifier, a preloaded cable."""

    label = "a constant torque"
    begins: ClassVar[Mapping[str, float]] = {"tau_0": 0.0}
    rarity = 1.0
    imitates = "theta"
    moves_rest = True
    formula = "tau = tau_0"
    confused = ("spring", "tilt", "drift", "asymmetric_coulomb", "angle_offset")
    tau_0: Value = parameter(0.0, unit="N m", bounds=(-math.inf, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return self.tau_0


def _frequencies(extent: Extent) -> tuple[float, ...]:
    """Frequencies at half of the log's resolution, from two periods in it to 12 Hz or 0.8 of the Nyquist frequency."""
    low, high = 2.0 / extent.duration, min(0.4 / extent.dt, 12.0)
    count = int(2.0 * max(high - low, 0.0) * extent.duration) + 1
    return tuple(np.linspace(low, max(high, low), min(count, _MOST_FREQUENCIES)).tolist())


@dataclass(frozen=True, eq=False)
class Periodic(JointEffect):
    """A periodic torque: a fan, mains hum, an unbalanced machine on the same table.

    t is the time from the start of each record.
    """

    label = "a periodic torque"
    rarity = 4.0
    formula = "tau = a sin(2 pi f t) + b cos(2 pi f t)"
    confused = ("ripple", "drift")
    a: Value = parameter(0.0, unit="N m", bounds=(-math.inf, math.inf), neutral=0.0)
    b: Value = parameter(0.0, unit="N m", bounds=(-math.inf, math.inf), neutral=0.0)
    f: Value = parameter(1.0, unit="Hz", bounds=(1e-3, 100.0), probe=_frequencies)

    def recurrences(self, theta: Array, t: Array, u: Array) -> float:
        """Periods in the record; -inf if the motion repeats with them: the torque may then be a function of it."""
        waves = float(self.f) * period_of(theta, t)
        returns = waves > 0.5 and abs(waves - round(waves)) < 0.1
        return -math.inf if returns else float(self.f * np.ptp(t))

    def torque(self, joint: Joint) -> Value:
        phase = 2.0 * math.pi * self.f * joint.t
        return self.a * ops.sin(phase) + self.b * ops.cos(phase)


@dataclass(frozen=True, eq=False)
class Drift(JointEffect):
    """A torque that grows while the record runs (warming, a leak); t is the time from its start."""

    label = "a torque that drifts"
    rarity = 3.0
    formula = "tau = r t"
    confused = ("torque_bias", "periodic", "warming_friction")
    r: Value = parameter(0.0, unit="N m/s", bounds=(-math.inf, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return self.r * joint.t


def period_of(theta: Array, t: Array) -> float:
    """The period [s] of a motion; 0 if it does not repeat within three quarters of the record.

    It is the first high peak of the autocorrelation, as multiples of the period have peaks, too; 1 is an exact
    repetition: c_k = sum_i x_i x_(i+k) / sqrt(sum_i x_i^2 sum_i x_(i+k)^2).
    """
    x = theta - np.mean(theta)
    n, lags = len(x), 3 * len(x) // 4
    products = np.fft.irfft(np.abs(np.fft.rfft(x, 2 * n)) ** 2)[:lags]
    head = np.cumsum(x**2)[::-1][:lags]
    tail = np.cumsum(x[::-1] ** 2)[::-1][:lags]
    correlation = products / np.sqrt(np.maximum(head * tail, 1e-300))
    below = np.flatnonzero(correlation < 0.0)
    if not len(below):
        return 0.0
    later = correlation[below[0] :]
    if np.max(later) < PERIODIC:
        return 0.0
    near = int(np.argmax(later > max(PERIODIC, ALMOST * float(np.max(later)))))
    far = near + int(np.argmax(np.append(later[near:] < 0.0, True)))
    peak = int(below[0]) + near + int(np.argmax(later[near:far]))
    return float(t[peak] - t[0])
