"""A linear axis: a mass that a force drives, without gravity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sysid.physics.ops import Value
from sysid.physics.parameters import parameter
from sysid.physics.plants.plant import Plant


@dataclass(frozen=True, eq=False)
class LinearAxis(Plant):
    """A carriage of mass m on a straight guide.

        m x_ddot = F

    What is called theta, theta_dot, u elsewhere means x [m], x_dot [m/s] and the force F [N] here, and every unit
    of an effect changes with it: N for N m, m for rad.
    """

    turns: ClassVar[bool] = False
    rest: ClassVar[float] = 0.0
    units: ClassVar[Mapping[str, str]] = {"kg m^2": "kg", "N m": "N", "rad": "m"}
    m: Value = parameter(1.0, unit="kg", bounds=(1e-9, 1e6))

    def inertia(self) -> Value:
        """m [kg]."""
        return self.m

    def gravity_torque(self, theta: Value) -> Value:
        """None, in the shape and back end of theta."""
        return 0.0 * theta
