"""Effects between the joint's state and the readings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sysid.physics import ops
from sysid.physics.effects.effect import Joint, Memory, OutputEffect, Reading
from sysid.physics.effects.timing import DeadTime, decaying, first_order
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import doubling, parameter


@dataclass(frozen=True, eq=False)
class AngleOffset(OutputEffect):
    """An encoder whose zero is off."""

    label = "an offset of the angle readings"
    rarity = 1.0
    imitates = "theta"
    moves_rest = True
    formula = "reading = theta + offset"
    confused = ("tilt", "torque_bias", "eccentricity")
    offset: Value = parameter(0.0, unit="rad", bounds=(-1.0, 1.0), neutral=0.0)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        return reading._replace(theta=reading.theta + self.offset), memory


@dataclass(frozen=True, eq=False)
class VelocityBias(OutputEffect):
    """The offset of a gyroscope or a tachometer."""

    label = "an offset of the speed readings"
    formula = "reading = theta_dot + bias"
    bias: Value = parameter(0.0, unit="rad/s", bounds=(-10.0, 10.0), neutral=0.0)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        return reading._replace(theta_dot=reading.theta_dot + self.bias), memory


@dataclass(frozen=True, eq=False)
class VelocityGain(OutputEffect):
    """The scale of a gyroscope or a tachometer, off by the factor c."""

    label = "a factor on the speed readings"
    formula = "reading = c theta_dot"
    c: Value = parameter(1.0, unit="1", bounds=(0.1, 10.0), neutral=1.0)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        return reading._replace(theta_dot=self.c * reading.theta_dot), memory


@dataclass(frozen=True, eq=False)
class SensorDelay(DeadTime, OutputEffect):
    """Readings of angle and speed that both come T late, at most `longest` [s].

    Between instants the angle is the Hermite cubic that meets angle and speed at both ends, and the speed is its slope.
    With x the share of an interval, counted backwards from its end, and m = -theta_dot dt:

        theta(x) = theta_0 + m_0 x + (3 d - 2 m_0 - m_1) x^2 + (m_0 + m_1 - 2 d) x^3,   d = theta_1 - theta_0

    Before its log began the joint is taken to have moved at its first speed.
    """

    label = "a delay of the readings"
    formula = "reading(t) = state(t - T)"
    confused = ("delay", "lag", "stamp", "backlash", "filtered_speed")
    stage = 1
    longest: float = 0.2

    def recurrences(self, theta: Array, t: Array, u: Array) -> float:
        """None without a command: a late motion is the motion of a later clock then."""
        return math.inf if np.any(u) else 0.0

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        """(theta, theta_dot) at the instants before this one, the latest first."""
        past = range(1, self.intervals(dt) + 1)
        return tuple(value for c in past for value in (theta - c * dt * theta_dot, theta_dot))

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """The reading T ago: the present one and its change over the share x of each interval that T covers."""
        states, seen, back = (*reading, *memory), reading, self.T / dt
        for c in range(len(memory) // 2):
            x = ops.minimum(back, 1.0) if c == 0 else ops.clip(back - c, 0.0, 1.0)
            change = _change(Reading(*states[2 * c : 2 * c + 2]), Reading(*states[2 * c + 2 : 2 * c + 4]), x, dt)
            seen = Reading(seen.theta + change.theta, seen.theta_dot + change.theta_dot)
        return seen, states[: len(memory)]

    def whole(self, reading: Reading, t: Array, dt: float) -> Reading:
        """The readings (..., N+1) of a whole record, each from the one cubic that T reaches back to."""
        c = min(int(self.T / dt), self.intervals(dt) - 1)
        x = self.T / dt - c
        first, speed = reading.theta[..., :1], reading.theta_dot[..., :1]
        before = -dt * np.arange(c + 1, 0, -1)
        theta = np.concatenate([first + before * speed, reading.theta], axis=-1)
        theta_dot = np.concatenate([np.repeat(speed, c + 1, axis=-1), reading.theta_dot], axis=-1)
        N = reading.theta.shape[-1]
        near = Reading(theta[..., 1 : 1 + N], theta_dot[..., 1 : 1 + N])
        change = _change(near, Reading(theta[..., :N], theta_dot[..., :N]), x, dt)
        return Reading(near.theta + change.theta, near.theta_dot + change.theta_dot)


def _change(now: Reading, before: Reading, x: Value, dt: float) -> Reading:
    """How angle and speed, a share x of an interval dt [s] before its end, differ from those at its end."""
    d, m_0, m_1 = before.theta - now.theta, -dt * now.theta_dot, -dt * before.theta_dot
    square, cube = 3.0 * d - 2.0 * m_0 - m_1, m_0 + m_1 - 2.0 * d
    return Reading(x * (m_0 + x * (square + x * cube)), -x * (2.0 * square + 3.0 * x * cube) / dt)


@dataclass(frozen=True, eq=False)
class FilteredSpeed(OutputEffect):
    """A drive that smooths the speed in its firmware; the angle is shown as it is.

    Exact for a speed that is linear over an interval, from theta_dot_0 to theta_dot_1, and safe at T -> 0:

        w' = theta_dot_1 + (w - theta_dot_0) exp(-dt/T) - (theta_dot_1 - theta_dot_0) (T/dt) (1 - exp(-dt/T))

    A log begins at w = theta_dot. A sensor delay would make the angle late, too.
    """

    label = "a filter of the speed readings"
    rarity = 2.5
    formula = "T w_dot = theta_dot - w, reading = w"
    confused = ("sensor_delay", "delay", "lag")
    stage = 1
    T: Value = parameter(0.0, unit="s", bounds=(0.0, 1.0), neutral=0.0, probe=doubling(0.3))

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        """(theta_dot, w) at the instant before this one, w = theta_dot."""
        return theta_dot, theta_dot

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        (before, w), now = memory, reading.theta_dot
        decay, share = first_order(self.T, dt)
        w = now + (w - before) * decay - (now - before) * share
        return reading._replace(theta_dot=w), (now, w)

    def whole(self, reading: Reading, t: Array, dt: float) -> Reading:
        now, (decay, share) = reading.theta_dot, first_order(self.T, dt)
        change = np.diff(now, prepend=now[..., :1])
        entering = now - decay * (now - change) - change * share
        entering[..., 0] = now[..., 0]
        return reading._replace(theta_dot=decaying(entering, decay))


@dataclass(frozen=True, eq=False)
class Backlash(OutputEffect):
    """Play between the joint and its encoder, which reads y.

    The encoder stays where it is until the joint has crossed the gap; its speed is the joint's while they touch and 0
    in the gap. A log begins in the middle of the gap, y = theta.
    """

    label = "backlash at the encoder"
    formula = "y = min(max(y, theta - width/2), theta + width/2)"
    confused = ("sensor_delay",)
    stage = 0
    width: Value = parameter(0.0, unit="rad", bounds=(0.0, 1.0), neutral=0.0)

    def resolved(self, sd: float, reach: float, joint: Joint) -> bool:
        """Whether half of the play is more than the sd: the rounding of an encoder lags by as much."""
        return 0.5 * float(self.width) > sd

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        return (theta,)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        (y,) = memory
        half, behind = 0.5 * self.width, y - reading.theta
        touching = ops.abs(behind) >= half
        y = reading.theta + ops.where(behind > 0.0, ops.minimum(behind, half), ops.maximum(behind, -half))
        return Reading(y, ops.where(touching, reading.theta_dot, 0.0 * reading.theta_dot)), (y,)

    def whole(self, reading: Reading, t: Array, dt: float) -> Reading:
        """The readings (..., N+1) of a whole record. Two limits of y in succession are again one limit, so that those
        of 2, 4, 8, ... instants can be combined."""
        theta, half = reading.theta, 0.5 * self.width
        low, high = theta - half, theta + half
        span = 1
        while span < theta.shape[-1]:
            before_low, before_high = low[..., :-span], high[..., :-span]
            after_low, after_high = low[..., span:], high[..., span:]
            low = np.concatenate([low[..., :span], np.clip(before_low, after_low, after_high)], axis=-1)
            high = np.concatenate([high[..., :span], np.clip(before_high, after_low, after_high)], axis=-1)
            span *= 2
        y = np.clip(theta[..., :1], low, high)
        before = np.concatenate([theta[..., :1], y[..., :-1]], axis=-1)
        return Reading(y, np.where(np.abs(before - theta) >= half, reading.theta_dot, 0.0))


@dataclass(frozen=True, eq=False)
class Eccentricity(OutputEffect):
    """An encoder whose disc turns about a point beside its centre.

    The speed, from the same disc, is that reading's derivative: (1 + a cos(theta) - b sin(theta)) theta_dot.
    A disc of radius R whose centre is e beside the axis reads wrong by up to e / R. Within less than a turn that looks
    like an offset and a scale; it is believed only if it repeats over turns.
    """

    label = "an encoder's disc beside its centre"
    rarity = 3.0
    imitates = "theta"
    formula = "reading = theta + a sin(theta) + b cos(theta)"
    confused = ("angle_offset", "tilt", "ripple")
    stage = 0
    a: Value = parameter(0.0, unit="rad", bounds=(-0.3, 0.3), neutral=0.0)
    b: Value = parameter(0.0, unit="rad", bounds=(-0.3, 0.3), neutral=0.0)

    def recurrences(self, theta: Array, t: Array, u: Array) -> float:
        """Turns along the motion."""
        return float(np.ptp(theta)) / (2.0 * math.pi)

    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        theta, theta_dot = reading
        sin, cos = ops.sin(theta), ops.cos(theta)
        return Reading(theta + self.a * sin + self.b * cos, (1.0 + self.a * cos - self.b * sin) * theta_dot), memory
