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

    Dry friction comes after the smooth torques of a substep h: with (theta*, theta_dot*) where these lead,

        theta_dot' = theta_dot* - clip(theta_dot*, -h a_minus, h a_plus),   theta' = theta* + s h (theta_dot' - theta_dot*)

    where s is the share of h over which a constant deceleration moves the angle in this scheme (`slip`). A joint at
    rest stays there as long as the other torques are below friction's limit; while it slides, the split costs O(h^2).
    (Moreau's time stepping for dry friction; e.g. Acary & Brogliato, Numerical Methods for Nonsmooth Systems, Ch. 10.)
    """

    substeps: int = 1
    slip: ClassVar[float] = 0.5

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
            theta, theta_dot = self.substep(acceleration, theta, theta_dot, t + j * h, drive, h)
            if deceleration is not None:
                plus, minus = deceleration(theta, theta_dot, t + (j + 1) * h, drive)
                lost = ops.clip(theta_dot, -h * minus, h * plus)
                theta, theta_dot = theta - self.slip * h * lost, theta_dot - lost
        return theta, theta_dot

    @abstractmethod
    def substep(
        self, acceleration: Acceleration, theta: Value, theta_dot: Value, t: Value, drive: Value, h: float
    ) -> tuple[Value, Value]:
        """(theta, theta_dot) after h [s] under a constant drive torque [N m]."""


@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """Gymnasium's and the paper's step; first order; the speed is clipped before the angle is advanced.

    theta_dot' = clip(theta_dot + h theta_ddot, -theta_dot_max, theta_dot_max)
    theta' = theta + h theta_dot'
    """

    theta_dot_max: float = math.inf
    slip: ClassVar[float] = 1.0

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
