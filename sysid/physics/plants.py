"""Plants: what swings or slides, described by an inertia and a gravity torque."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sysid.physics import ops
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Parametric, parameter

GRAVITY = 9.81
"""[m/s^2], of a plant that has no number for it: a GeneralJoint knows the torque of gravity alone."""


@dataclass(frozen=True, eq=False)
class Plant(Parametric):
    """J theta_ddot = gravity_torque(theta) + tau, with theta = 0 upright and theta = pi hanging.

    turns: whether theta comes back to the same place after a turn.
    rest: the theta at which gravity lets it rest and a spring is slack.
    scale: the parameter in proportion to all torques: without a known torque, motion cannot show it.
    gravity: the fitted parameter that sets gravity alone; empty if each one sets the inertia, too.
    units: this plant's names for the units of turning, the longest first; empty if it turns.
    """

    turns: ClassVar[bool] = True
    rest: ClassVar[float] = math.pi
    scale: ClassVar[str] = "m"
    gravity: ClassVar[str] = ""
    units: ClassVar[Mapping[str, str]] = {}

    def unit(self, unit: str) -> str:
        """Translate a unit of turning into that of this plant.

        Parameters
        ----------
        unit : str
            A unit as effects declare it, "rad/s" or "N m s/rad".

        Returns
        -------
        str
            The same for what turns; "m/s" and "N s/m" for a linear axis.
        """
        for turning, ours in self.units.items():
            unit = re.sub(rf"\b{re.escape(turning)}\b", ours, unit)
        return unit

    @property
    def quantities(self) -> dict[str, str]:
        """The units of "theta", "theta_dot", "torque" and "time" for this plant."""
        turning = {"theta": "rad", "theta_dot": "rad/s", "torque": "N m", "time": "s"}
        return {name: self.unit(unit) for name, unit in turning.items()}

    def place(self, theta: Array) -> Array:
        """Where theta [rad] is: modulo a turn if the plant turns."""
        return np.mod(theta, 2.0 * math.pi) if self.turns else theta

    @abstractmethod
    def inertia(self) -> Value:
        """J [kg m^2], about the axis."""

    @abstractmethod
    def gravity_torque(self, theta: Value) -> Value:
        """Torque of gravity [N m] at theta [rad]; positive raises theta."""


@dataclass(frozen=True, eq=False)
class RodPendulum(Plant):
    """A uniform rod of mass m and length l, hinged at one end.

        J = m l^2 / 3,   gravity_torque = m g (l / 2) sin(theta)
        theta_ddot = 3 g / (2 l) sin(theta) + 3 / (m l^2) tau

    Source: Gymnasium's Pendulum-v1.
    """

    m: Value = parameter(1.0, unit="kg", bounds=(1e-3, 1e3))
    l: Value = parameter(1.0, unit="m", bounds=(1e-2, 1e2))  # noqa: E741 - the field's letter for length
    g: Value = parameter(10.0, unit="m/s^2", bounds=(0.0, 30.0), known=True)

    def inertia(self) -> Value:
        """J = m l^2 / 3 [kg m^2]."""
        return self.m * self.l * self.l / 3.0

    def gravity_torque(self, theta: Value) -> Value:
        """m g (l / 2) sin(theta) [N m]."""
        return 0.5 * self.m * self.g * self.l * ops.sin(theta)


@dataclass(frozen=True, eq=False)
class PointMassPendulum(Plant):
    """A point mass m at the end of a massless rod of length l.

    J = m l^2,   gravity_torque = m g l sin(theta)
    """

    m: Value = parameter(1.0, unit="kg", bounds=(1e-3, 1e3))
    l: Value = parameter(1.0, unit="m", bounds=(1e-2, 1e2))  # noqa: E741
    g: Value = parameter(GRAVITY, unit="m/s^2", bounds=(0.0, 30.0), known=True)

    def inertia(self) -> Value:
        """J = m l^2 [kg m^2]."""
        return self.m * self.l * self.l

    def gravity_torque(self, theta: Value) -> Value:
        """m g l sin(theta) [N m]."""
        return self.m * self.g * self.l * ops.sin(theta)


@dataclass(frozen=True, eq=False)
class GeneralJoint(Plant):
    """One joint with inertia J [kg m^2] and largest gravity torque G [N m].

        J theta_ddot = G sin(theta) + tau

    It describes a torque-driven pendulum of any shape, since only these two combinations of (m, l, g) show in the
    motion. G = 0 is a flywheel.
    """

    scale: ClassVar[str] = "J"
    gravity: ClassVar[str] = "G"
    J: Value = parameter(0.1, unit="kg m^2", bounds=(1e-9, 1e6))
    G: Value = parameter(1.0, unit="N m", bounds=(0.0, 1e6))

    def inertia(self) -> Value:
        """J [kg m^2]."""
        return self.J

    def gravity_torque(self, theta: Value) -> Value:
        """G sin(theta) [N m]."""
        return self.G * ops.sin(theta)


@dataclass(frozen=True, eq=False)
class LinearAxis(Plant):
    """A carriage of mass m on a straight guide.

        m x_ddot = F

    theta, theta_dot and u stand for x [m], x_dot [m/s] and the force F [N] here, and the units of effects change with
    them: N for N m, m for rad.
    """

    turns: ClassVar[bool] = False
    rest: ClassVar[float] = 0.0
    units: ClassVar[Mapping[str, str]] = {"kg m^2": "kg", "N m": "N", "rad": "m"}
    m: Value = parameter(1.0, unit="kg", bounds=(1e-9, 1e6))

    def inertia(self) -> Value:
        """m [kg]."""
        return self.m

    def gravity_torque(self, theta: Value) -> Value:
        """Zero, in the shape and back end of theta."""
        return 0.0 * theta
