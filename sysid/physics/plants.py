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
    """What swings or slides: a body with an inertia J and a gravity torque.

        J theta_ddot = gravity_torque(theta) + tau

    theta = 0 is upright and theta = pi is hanging.

    Parameters
    ----------
    bounds : mapping of str to (float, float), optional
        Other bounds than the declared ones, by field name.

    Attributes
    ----------
    turns : bool
        Whether theta comes back to the same place after a turn.
    rest : float
        The theta [rad] at which gravity lets it rest and a spring is slack.
    scale : str
        The parameter in proportion to all torques: without a known torque, motion cannot show it.
    gravity : str
        The fitted parameter that sets gravity alone; empty if each one sets the inertia, too.
    units : mapping of str to str
        This plant's names for the units of turning, the longest first; empty if it turns.

    Raises
    ------
    InvalidInput
        For numbers that are not finite or are out of bounds, and for bounds of an unknown name or not low < high.
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
        """Where theta is: modulo a turn if the plant turns.

        Parameters
        ----------
        theta : array
            Angles [rad].

        Returns
        -------
        array
            The places [rad], from 0 to 2 pi if the plant turns; else theta itself.
        """
        return np.mod(theta, 2.0 * math.pi) if self.turns else theta

    @abstractmethod
    def inertia(self) -> Value:
        """The inertia J about the axis.

        Returns
        -------
        Value
            J [kg m^2].
        """

    @property
    def largest_gravity_torque(self) -> Value:
        """The torque of gravity [N m] a quarter of a turn from upright; 0 for what no gravity pulls."""
        return self.gravity_torque(0.5 * math.pi)

    @abstractmethod
    def gravity_torque(self, theta: Value) -> Value:
        """The torque of gravity at theta; positive raises theta.

        Parameters
        ----------
        theta : Value
            The angle [rad].

        Returns
        -------
        Value
            The torque [N m].
        """


@dataclass(frozen=True, eq=False)
class RodPendulum(Plant):
    """A uniform rod of mass m and length l, hinged at one end.

        J = m l^2 / 3,   gravity_torque = m g (l / 2) sin(theta)
        theta_ddot = 3 g / (2 l) sin(theta) + 3 / (m l^2) tau

    Parameters
    ----------
    m : float, default 1
        Mass [kg], from 0.001 to 1000.
    l : float, default 1
        Length [m], from 0.01 to 100.
    g : float, default 10
        Acceleration of gravity [m/s^2], from 0 to 30; it is known: no fit changes it unless it is asked to.
    bounds : mapping of str to (float, float), optional
        Other bounds than these, by field name: `RodPendulum(m=5.0, bounds={"m": (1.0, 9.0)})`.

    Raises
    ------
    InvalidInput
        For numbers that are not finite or are out of bounds, and for bounds of an unknown name or not low < high.

    References
    ----------
    Gymnasium's Pendulum-v1.
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

    Parameters
    ----------
    m : float, default 1
        Mass [kg], from 0.001 to 1000.
    l : float, default 1
        Length [m], from 0.01 to 100.
    g : float, default 9.81
        Acceleration of gravity [m/s^2], from 0 to 30; it is known: no fit changes it unless it is asked to.
    bounds : mapping of str to (float, float), optional
        Other bounds than these, by field name.

    Raises
    ------
    InvalidInput
        For numbers that are not finite or are out of bounds, and for bounds of an unknown name or not low < high.
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
    """One joint with inertia J and largest gravity torque G.

        J theta_ddot = G sin(theta) + tau

    It describes a torque-driven pendulum of any shape, since only these two combinations of (m, l, g) show in the
    motion. G = 0 is a flywheel.

    Parameters
    ----------
    J : float, default 0.1
        Inertia [kg m^2], from 1e-9 to 1e6.
    G : float, default 1
        Largest gravity torque [N m], from 0 to 1e6.
    bounds : mapping of str to (float, float), optional
        Other bounds than these, by field name.

    Raises
    ------
    InvalidInput
        For numbers that are not finite or are out of bounds, and for bounds of an unknown name or not low < high.
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
        if isinstance(self.G, float) and self.G == 0.0:
            return 0.0 * theta  # a wheel's log does not wait for sines
        return self.G * ops.sin(theta)


@dataclass(frozen=True, eq=False)
class LinearAxis(Plant):
    """A carriage of mass m on a straight guide.

        m x_ddot = F

    theta, theta_dot and u stand for x [m], x_dot [m/s] and the force F [N] here, and the units of effects change with
    them: N for N m, m for rad.

    Parameters
    ----------
    m : float, default 1
        Mass [kg], from 1e-9 to 1e6.
    bounds : mapping of str to (float, float), optional
        Other bounds than these, by field name.

    Raises
    ------
    InvalidInput
        For numbers that are not finite or are out of bounds, and for bounds of an unknown name or not low < high.
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
