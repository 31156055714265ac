"""The interface of a plant: one rotating degree of freedom, theta = 0 upright."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

from sysid.ops import Value
from sysid.parameters import Parametric


@dataclass(frozen=True, eq=False)
class Plant(Parametric):
    """J theta_ddot = gravity_torque(theta) + tau, with theta = 0 upright and theta = pi hanging."""

    @abstractmethod
    def inertia(self) -> Value:
        """J [kg m^2], about the axis."""

    @abstractmethod
    def gravity_torque(self, theta: Value) -> Value:
        """Torque of gravity [N m] at theta [rad]; positive raises theta."""
