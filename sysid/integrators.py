"""Time steps: how theta_ddot becomes the state one control interval later."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from sysid import ops
from sysid.errors import InvalidInput
from sysid.ops import Value

Acceleration = Callable[[Value, Value, Value, Value], Value]
"""theta_ddot(theta, theta_dot, t, drive) [rad/s^2]."""
Deceleration = Callable[[Value, Value, Value, Value], tuple[Value, Value]]
"""What dry friction can take from positive and from negative speed (theta, theta_dot, t, drive) [rad/s^2], both >= 0."""


@dataclass(frozen=True)
class Integrator(ABC):
    """Advances (theta, theta_dot) over dt, in `substeps`; each substep sees its own mean drive torque.

    Dry friction comes after the smooth torques of a substep, see `stick_slip`.
    """

    substeps: int = 1
    order: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if self.substeps != int(self.substeps) or self.substeps < 1:
            raise InvalidInput(f"substeps = {self.substeps}: expected a whole number >= 1")

    def advance(
        self,
        acceleration: Acceleration,
        theta: Value,
        theta_dot: Value,
        t: Value,
        drives: Sequence[Value],
        dt: float,
        deceleration: Deceleration | None = None,
    ) -> tuple[Value, Value]:
        """(theta, theta_dot) after dt [s], under drive torques [N m], one per substep."""
        h = dt / self.substeps
        for j, drive in enumerate(drives):
            theta_next, theta_dot_next = self.substep(acceleration, theta, theta_dot, t + j * h, drive, h)
            if deceleration is not None:
                plus, minus = deceleration(theta_next, theta_dot_next, t + (j + 1) * h, drive)
                slowed, shift = stick_slip(theta_dot, theta_dot_next, plus, minus, h)
                # a first-order step advances the angle with its last speed
                theta_next = theta_next + (shift if self.order > 1 else h * (slowed - theta_dot_next))
                theta_dot_next = slowed
            theta, theta_dot = theta_next, theta_dot_next
        return theta, theta_dot

    @abstractmethod
    def substep(
        self, acceleration: Acceleration, theta: Value, theta_dot: Value, t: Value, drive: Value, h: float
    ) -> tuple[Value, Value]:
        """(theta, theta_dot) after h [s] under a constant drive torque [N m]."""


def stick_slip(v: Value, v_smooth: Value, plus: Value, minus: Value, h: float) -> tuple[Value, Value]:
    """Speed after a substep h with dry friction, and how far friction moved the angle, from the speeds v before and
    v_smooth after the same substep without it [rad/s].

    With a = (v_smooth - v) / h constant and friction c = plus or minus [rad/s^2] against the motion, the joint slides
    until t = min(h, |v| / (c - a sign v)); then it stays, or leaves with a -+ c where a is beyond friction's limit.
    Exact for constant torques; else the split costs O(h^2). A joint that is stuck has speed 0 exactly.
    """
    a = (v_smooth - v) / h
    sign = ops.where(v > 0.0, 1.0, -1.0)
    slowing = ops.where(v > 0.0, plus, minus) - sign * a
    sliding = ops.minimum(h, sign * v / ops.maximum(slowing, 1e-9))
    leaving = a - ops.clip(a, -minus, plus)
    resting = h - sliding
    slowed = v - sign * slowing * sliding + leaving * resting
    moved = v * sliding - 0.5 * sign * slowing * sliding * sliding + 0.5 * leaving * resting * resting
    # rounding must not set a stuck joint in motion
    slowed = ops.where(ops.abs(slowed) < 1e-12, 0.0 * slowed, slowed)
    return slowed, moved - h * v - 0.5 * h * h * a


@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """Gymnasium's and the paper's step; first order; the speed is clipped before the angle is advanced.

    theta_dot' = clip(theta_dot + h theta_ddot, -theta_dot_max, theta_dot_max)
    theta' = theta + h theta_dot'
    """

    theta_dot_max: float = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.theta_dot_max > 0.0:
            raise InvalidInput(f"theta_dot_max = {self.theta_dot_max}: expected a positive speed [rad/s]")

    def substep(
        self, acceleration: Acceleration, theta: Value, theta_dot: Value, t: Value, drive: Value, h: float
    ) -> tuple[Value, Value]:
        """One step of the equation above."""
        theta_dot = theta_dot + h * acceleration(theta, theta_dot, t, drive)
        theta_dot = ops.clip(theta_dot, -self.theta_dot_max, self.theta_dot_max)
        return theta + h * theta_dot, theta_dot


@dataclass(frozen=True)
class RK4(Integrator):
    """The classical fourth-order Runge-Kutta step (Hairer, Norsett, Wanner: Solving ODEs I, Table II.1.2)."""

    order: ClassVar[int] = 4

    def substep(
        self, acceleration: Acceleration, theta: Value, theta_dot: Value, t: Value, drive: Value, h: float
    ) -> tuple[Value, Value]:
        """One step of size h; the drive is held, so the order holds for a drive constant over a substep."""
        half = 0.5 * h
        v1, a1 = theta_dot, acceleration(theta, theta_dot, t, drive)
        v2 = theta_dot + half * a1
        a2 = acceleration(theta + half * v1, v2, t + half, drive)
        v3 = theta_dot + half * a2
        a3 = acceleration(theta + half * v2, v3, t + half, drive)
        v4 = theta_dot + h * a3
        a4 = acceleration(theta + h * v3, v4, t + h, drive)
        sixth = h / 6.0
        return (
            theta + sixth * (v1 + 2.0 * v2 + 2.0 * v3 + v4),
            theta_dot + sixth * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
        )
