"""A general joint: the two combinations of mass, length and gravity that motion alone can show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sysid.physics import ops
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter
from sysid.physics.plants.plant import Plant


@dataclass(frozen=True, eq=False)
class GeneralJoint(Plant):
    """One joint with inertia J [kg m^2] and largest gravity torque G [N m].

        J theta_ddot = G sin(theta) + tau

    A torque-driven pendulum of any shape, with J and G in place of (m, l, g), of which only these two
    combinations show in the motion. G = 0 is a flywheel.
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
