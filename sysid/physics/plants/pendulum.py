"""Pendulums: a uniform rod (Gymnasium's) and a point mass on a massless rod."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.physics import ops
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter
from sysid.physics.plants.plant import Plant


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
    g: Value = parameter(9.81, unit="m/s^2", bounds=(0.0, 30.0), known=True)

    def inertia(self) -> Value:
        """J = m l^2 [kg m^2]."""
        return self.m * self.l * self.l

    def gravity_torque(self, theta: Value) -> Value:
        """m g l sin(theta) [N m]."""
        return self.m * self.g * self.l * ops.sin(theta)
