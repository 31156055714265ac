"""What the sensors make of the joint's state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sysid.physics import ops
from sysid.physics.effects.dead_time import DeadTime, doubling
from sysid.physics.effects.effect import Memory, OutputEffect, Reading
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Extent, parameter

_TINY = 1e-15
_LONGEST_FILTER = 0.3


@dataclass(frozen=True, eq=False)
class AngleOffset(OutputEffect):
    """An encoder whose zero is off."""

    words: ClassVar[str] = "an offset of the angle readings"
    rarity: ClassVar[float] = 1.0
    imitates: ClassVar[str] = "theta"
    formula: ClassVar[str] = "reading = theta + offset"
    confused: ClassVar[tuple[str, ...]] = ("tilt", "torque_bias", "eccentricity")
    offset: Value = parameter(0.0, unit="rad", bounds=(-1.0, 1.0), neutral=0.0)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """theta + offset; the speed as it is."""
        return reading._replace(theta=reading.theta + self.offset), memory


@dataclass(frozen=True, eq=False)
class VelocityBias(OutputEffect):
    """The offset of a gyroscope or a tachometer."""

    words: ClassVar[str] = "an offset of the speed readings"
    rarity: ClassVar[float] = 2.0
    formula: ClassVar[str] = "reading = theta_dot + bias"
    confused: ClassVar[tuple[str, ...]] = ()
    bias: Value = parameter(0.0, unit="rad/s", bounds=(-10.0, 10.0), neutral=0.0)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """theta_dot + bias; the angle as it is."""
        return reading._replace(theta_dot=reading.theta_dot + self.bias), memory


@dataclass(frozen=True, eq=False)
class VelocityGain(OutputEffect):
    """The scale of a gyroscope or a tachometer, off by the factor c."""

    words: ClassVar[str] = "a factor on the speed readings"
    rarity: ClassVar[float] = 2.0
    formula: ClassVar[str] = "reading = c theta_dot"
    confused: ClassVar[tuple[str, ...]] = ()
    c: Value = parameter(1.0, unit="1", bounds=(0.1, 10.0), neutral=1.0)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """c theta_dot; the angle as it is."""
        return reading._replace(theta_dot=self.c * reading.theta_dot), memory


@dataclass(frozen=True, eq=False)
class SensorDelay(DeadTime, OutputEffect):
    """Sensors that both show what was T ago, at most `longest` [s].

    Between instants the angle is the cubic that meets angle and speed at both ends (Hermite), and the speed is that
    cubic's slope; with x the share of an interval, counted backwards from its end, and m = -theta_dot dt:

        theta(x) = theta_0 + m_0 x + (3 d - 2 m_0 - m_1) x^2 + (m_0 + m_1 - 2 d) x^3,   d = theta_1 - theta_0

    Before its log began the joint is taken to have moved at its first speed.
    Raises InvalidInput for a `longest` that is not a positive time.
    """

    words: ClassVar[str] = "a delay of the readings"
    rarity: ClassVar[float] = 2.0
    formula: ClassVar[str] = "reading(t) = state(t - T)"
    confused: ClassVar[tuple[str, ...]] = ("delay", "lag", "stamp", "backlash", "filtered_speed")
    stage: ClassVar[int] = 1
    longest: float = 0.2

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        """(theta, theta_dot) at the instants before this one, the latest first."""
        past = range(1, self.intervals(dt) + 1)
        return tuple(value for c in past for value in (theta - c * dt * theta_dot, theta_dot))

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """The reading of T ago: a sum over the intervals back to it, each of which T covers by a share x."""
        states = (*reading, *memory)
        theta, theta_dot = reading
        back = self.T / dt
        for c in range(len(memory) // 2):
            theta_0, theta_dot_0, theta_1, theta_dot_1 = states[2 * c : 2 * c + 4]
            x = ops.minimum(back, 1.0) if c == 0 else ops.clip(back - c, 0.0, 1.0)
            d, m_0, m_1 = theta_1 - theta_0, -dt * theta_dot_0, -dt * theta_dot_1
            square, cube = 3.0 * d - 2.0 * m_0 - m_1, m_0 + m_1 - 2.0 * d
            theta = theta + x * (m_0 + x * (square + x * cube))
            theta_dot = theta_dot - x * (2.0 * square + 3.0 * x * cube) / dt
        return Reading(theta, theta_dot), states[: len(memory)]

    def whole(self, reading: Reading, t: Array, dt: float) -> Reading:
        """The readings (..., N+1) of a whole record: the one cubic that T reaches back to."""
        c = min(int(self.T / dt), self.intervals(dt) - 1)
        x = self.T / dt - c
        first, speed = reading.theta[..., :1], reading.theta_dot[..., :1]
        before = -dt * np.arange(c + 1, 0, -1)
        theta = np.concatenate([first + before * speed, reading.theta], axis=-1)
        theta_dot = np.concatenate([np.repeat(speed, c + 1, axis=-1), reading.theta_dot], axis=-1)
        N = reading.theta.shape[-1]
        theta_0, theta_1 = theta[..., 1 : 1 + N], theta[..., :N]
        m_0, m_1 = -dt * theta_dot[..., 1 : 1 + N], -dt * theta_dot[..., :N]
        d = theta_1 - theta_0
        square, cube = 3.0 * d - 2.0 * m_0 - m_1, m_0 + m_1 - 2.0 * d
        slope = m_0 + x * (2.0 * square + 3.0 * x * cube)
        return Reading(theta_0 + x * (m_0 + x * (square + x * cube)), -slope / dt)


@dataclass(frozen=True, eq=False)
class Backlash(OutputEffect):
    """Play between the joint and its encoder, which reads y.

    The encoder stays where it is until the joint has crossed the gap; its speed is the joint's while they touch and 0
    in the gap. A log begins in the middle of the gap, y = theta.
    """

    words: ClassVar[str] = "backlash at the encoder"
    rarity: ClassVar[float] = 2.0
    formula: ClassVar[str] = "y = min(max(y, theta - width/2), theta + width/2)"
    confused: ClassVar[tuple[str, ...]] = ("sensor_delay",)
    stage: ClassVar[int] = 0
    width: Value = parameter(0.0, unit="rad", bounds=(0.0, 1.0), neutral=0.0)

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        """y = theta."""
        return (theta,)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """The encoder's angle and speed, and its angle for the next instant."""
        (y,) = memory
        half, behind = 0.5 * self.width, y - reading.theta
        touching = ops.abs(behind) >= half
        y = reading.theta + ops.where(behind > 0.0, ops.minimum(behind, half), ops.maximum(behind, -half))
        return Reading(y, ops.where(touching, reading.theta_dot, 0.0 * reading.theta_dot)), (y,)


@dataclass(frozen=True, eq=False)
class Eccentricity(OutputEffect):
    """An encoder whose disc turns about a point beside its centre.

    The speed, from the same disc, is that reading's derivative: (1 + a cos(theta) - b sin(theta)) theta_dot.
    A disc of radius R whose centre is e beside the axis reads wrong by up to e / R. Within less than a turn it looks
    like an offset and a scale, so that it has to come back over turns to be believed.
    """

    words: ClassVar[str] = "an encoder's disc beside its centre"
    rarity: ClassVar[float] = 3.0
    imitates: ClassVar[str] = "theta"
    formula: ClassVar[str] = "reading = theta + a sin(theta) + b cos(theta)"
    confused: ClassVar[tuple[str, ...]] = ("angle_offset", "tilt", "ripple")
    stage: ClassVar[int] = 0
    a: Value = parameter(0.0, unit="rad", bounds=(-0.3, 0.3), neutral=0.0)
    b: Value = parameter(0.0, unit="rad", bounds=(-0.3, 0.3), neutral=0.0)

    def recurrences(self, theta: Array, t: Array) -> float:
        """Turns along the motion."""
        return float(np.ptp(theta)) / (2.0 * math.pi)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """theta + a sin(theta) + b cos(theta) and its derivative."""
        theta, theta_dot = reading
        sin, cos = ops.sin(theta), ops.cos(theta)
        return Reading(theta + self.a * sin + self.b * cos, (1.0 + self.a * cos - self.b * sin) * theta_dot), memory


def _filter_times(extent: Extent) -> tuple[float, ...]:
    return doubling(extent, _LONGEST_FILTER)


@dataclass(frozen=True, eq=False)
class FilteredSpeed(OutputEffect):
    """A drive that smooths the speed in its firmware; the angle is shown as it is.

    Exact for a speed that is linear over an interval, from theta_dot_0 to theta_dot_1, and safe at T -> 0:

        w' = theta_dot_1 + (w - theta_dot_0) exp(-dt/T) - (theta_dot_1 - theta_dot_0) (T/dt) (1 - exp(-dt/T))

    A log begins at w = theta_dot. A delay of both readings is late by T at the angle, too.
    """

    words: ClassVar[str] = "a filter of the speed readings"
    rarity: ClassVar[float] = 2.5
    formula: ClassVar[str] = "T w_dot = theta_dot - w, reading = w"
    confused: ClassVar[tuple[str, ...]] = ("sensor_delay", "delay", "lag")
    stage: ClassVar[int] = 1
    T: Value = parameter(0.0, unit="s", bounds=(0.0, 1.0), neutral=0.0, probe=_filter_times)

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        """(theta_dot, w) at the instant before this one, w = theta_dot."""
        return theta_dot, theta_dot

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """w, and (theta_dot, w) for the next instant."""
        (before, w), now = memory, reading.theta_dot
        T = self.T + _TINY
        decay = ops.exp(-dt / T)
        w = now + (w - before) * decay - (now - before) * (T / dt) * (1.0 - decay)
        return reading._replace(theta_dot=w), (now, w)

    def whole(self, reading: Reading, t: Array, dt: float) -> Reading:
        """The readings (..., N+1) of a whole record: w is a first-order filter of the speed."""
        from scipy.linalg import solve_banded  # scipy.signal's filter would take half a second to load

        now, T = reading.theta_dot, self.T + _TINY
        decay = ops.exp(-dt / T)
        change = np.diff(now, prepend=now[..., :1])
        entering = now - decay * (now - change) - change * (T / dt) * (1.0 - decay)
        entering[..., 0] = now[..., 0]
        band = np.stack([np.ones(now.shape[-1]), np.full(now.shape[-1], -decay)])
        w = solve_banded((1, 0), band, entering.reshape(-1, now.shape[-1]).T).T.reshape(now.shape)
        return reading._replace(theta_dot=w)
