"""Integrators: from theta_ddot to the state one control interval later."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from sysid.errors import InvalidInput, is_real
from sysid.limits import SUBSTEPS, check_size
from sysid.physics import ops
from sysid.physics.ops import Value

Acceleration = Callable[[Value, Value, Value, Value], Value]
"""theta_ddot(theta, theta_dot, t, drive) [rad/s^2]."""
Slope = Callable[[Value, Value, Value], Value]
"""theta_ddot(theta, theta_dot, t) [rad/s^2] under the drive torque of a substep."""
Deceleration = Callable[[Value, Value, Value, Value], tuple[Value, Value]]
"""Dry friction's limits against positive and negative speed (theta, theta_dot, t, drive) [rad/s^2], both >= 0."""


@dataclass(frozen=True)
class Integrator(ABC):
    """A scheme that advances (theta, theta_dot) over dt, in `substeps`; each substep sees its own mean drive torque.

    Dry friction c, taken at the middle of a substep, joins the other torques as if the joint slid all the time, which
    keeps the scheme's order. `stick_slip` corrects substeps in which the joint stops, stays at rest or breaks away.

    Parameters
    ----------
    substeps : int, default 1
        The number of steps of a control interval, from 1 to 10,000.

    Attributes
    ----------
    order : int
        The order of the scheme.

    Raises
    ------
    InvalidInput
        For substeps that are not a whole number from 1 to 10,000.
    """

    substeps: int = 1
    order: ClassVar[int] = 1

    def __post_init__(self) -> None:
        whole = isinstance(self.substeps, int | float) and not isinstance(self.substeps, bool)
        if not whole or not 1 <= self.substeps < math.inf or self.substeps != int(self.substeps):
            raise InvalidInput(f"substeps = {self.substeps!r}: expected a whole number >= 1")
        check_size("substeps =", self.substeps, SUBSTEPS)
        object.__setattr__(self, "substeps", int(self.substeps))

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
        """The state after one control interval under drive torques, one per substep.

        Parameters
        ----------
        acceleration : function
            theta_ddot(theta, theta_dot, t, drive) [rad/s^2], without dry friction.
        theta, theta_dot : Value
            The state at the begin [rad], [rad/s].
        t : Value
            The instant of the begin [s].
        drives : sequence of Value
            The drive torques [N m], one per substep.
        dt : float
            The control interval [s].
        deceleration : function, optional
            The limits of dry friction against positive and negative speed (theta, theta_dot, t, drive) [rad/s^2], both
            >= 0; by default there is no dry friction.

        Returns
        -------
        theta, theta_dot : Value
            The state at the end [rad], [rad/s].
        """
        h = dt / self.substeps
        for j, drive in enumerate(drives):
            theta, theta_dot = self._driven(acceleration, deceleration, theta, theta_dot, t + j * h, drive, h)
        return theta, theta_dot

    def _driven(
        self,
        acceleration: Acceleration,
        deceleration: Deceleration | None,
        theta: Value,
        v: Value,
        t: Value,
        drive: Value,
        h: float,
    ) -> tuple[Value, Value]:
        """A substep: with dry friction c taken at its middle, a step under it, and the correction for sticking."""

        def free(theta: Value, v: Value, t: Value) -> Value:
            return acceleration(theta, v, t, drive)

        first = free(theta, v, t)
        if deceleration is None:
            return self.substep(free, first, theta, v, t, h)
        ahead, moved, _ = stick_slip(v, first, *deceleration(theta, v, t, drive), h)
        middle = 0.5 * (v + ahead)
        plus, minus = deceleration(theta + 0.5 * moved, middle, t + 0.5 * h, drive)
        c = ops.where(middle > 0.0, plus, -minus)
        end, v_end = self.substep(lambda *state: free(*state) - c, first - c, theta, v, t, h)
        slowed, moved, moving = stick_slip(v, (v_end - v) / h + c, plus, minus, h)
        if self.order == 1:
            return theta + h * slowed, slowed
        # the scheme's deviation from a parabola counts for the share of h in which the joint moved
        return theta + moved + moving * (end - theta - 0.5 * h * (v + v_end)), slowed

    @abstractmethod
    def substep(
        self, acceleration: Slope, first: Value, theta: Value, theta_dot: Value, t: Value, h: float
    ) -> tuple[Value, Value]:
        """One step of the scheme under a constant drive torque.

        Parameters
        ----------
        acceleration : function
            theta_ddot(theta, theta_dot, t) [rad/s^2] under the drive torque of the substep.
        first : Value
            The acceleration at the begin of the step [rad/s^2].
        theta, theta_dot : Value
            The state at the begin [rad], [rad/s].
        t : Value
            The instant of the begin [s].
        h : float
            The length of the step [s].

        Returns
        -------
        theta, theta_dot : Value
            The state after h [rad], [rad/s].
        """


def stick_slip(v: Value, a: Value, plus: Value, minus: Value, h: float) -> tuple[Value, Value, Value]:
    """Speed [rad/s] after h [s], angle moved [rad], and the share of h in motion, from speed v under an acceleration a.

    Friction c, `plus` or `minus` [rad/s^2], acts against the motion. The joint slides for min(h, |v| / (c - a sign v)).
    Then it stays, with speed 0 exactly, or leaves with a -+ c if a is beyond friction's limit. Exact at constant a, c.
    """
    forward = v > 0.0
    sign, slowing = ops.where(forward, 1.0, -1.0), ops.where(forward, plus, -minus) - a
    speed, against = sign * v, sign * slowing
    sliding = ops.minimum(h, speed / ops.maximum(against, 1e-9))
    resting = h - sliding
    gained = ops.where(a > 0.0, ops.maximum(a - plus, 0.0), ops.minimum(a + minus, 0.0)) * resting
    slowed = ops.where(speed < against * h, gained, v - slowing * h)
    moved = v * sliding - 0.5 * slowing * sliding * sliding + 0.5 * gained * resting
    return slowed, moved, (sliding + gained * a / (a * a + 1e-30)) / h


@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """Gymnasium's and the paper's step, of first order; the speed is clipped before it advances the angle.

        theta_dot' = clip(theta_dot + h theta_ddot, -theta_dot_max, theta_dot_max)
        theta' = theta + h theta_dot'

    Parameters
    ----------
    substeps : int, default 1
        The number of steps of a control interval, from 1 to 10,000.
    theta_dot_max : float, default inf
        The largest speed [rad/s].

    Raises
    ------
    InvalidInput
        For substeps that are not a whole number from 1 to 10,000, and a largest speed that is not positive.
    """

    theta_dot_max: float = math.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (is_real(self.theta_dot_max) and self.theta_dot_max > 0.0):
            raise InvalidInput(f"theta_dot_max = {self.theta_dot_max!r}: expected a positive speed [rad/s]")

    def substep(
        self, acceleration: Slope, first: Value, theta: Value, theta_dot: Value, t: Value, h: float
    ) -> tuple[Value, Value]:
        """One step of the equation above."""
        theta_dot = theta_dot + h * first
        theta_dot = ops.clip(theta_dot, -self.theta_dot_max, self.theta_dot_max)
        return theta + h * theta_dot, theta_dot


@dataclass(frozen=True)
class RK4(Integrator):
    """The classical Runge-Kutta step, of fourth order.

    Parameters
    ----------
    substeps : int, default 1
        The number of steps of a control interval, from 1 to 10,000.

    Raises
    ------
    InvalidInput
        For substeps that are not a whole number from 1 to 10,000.

    References
    ----------
    Hairer, Norsett, Wanner: Solving ODEs I, Table II.1.2.
    """

    order: ClassVar[int] = 4

    def substep(
        self, acceleration: Slope, first: Value, theta: Value, theta_dot: Value, t: Value, h: float
    ) -> tuple[Value, Value]:
        """One step of size h, of fourth order for a drive that is constant over it."""
        half = 0.5 * h
        v1, a1 = theta_dot, first
        v2 = theta_dot + half * a1
        a2 = acceleration(theta + half * v1, v2, t + half)
        v3 = theta_dot + half * a2
        a3 = acceleration(theta + half * v2, v3, t + half)
        v4 = theta_dot + h * a3
        a4 = acceleration(theta + h * v3, v4, t + h)
        sixth = h / 6.0
        return (
            theta + sixth * (v1 + 2.0 * v2 + 2.0 * v3 + v4),
            theta_dot + sixth * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
        )
