"""The interface of a plant: one rotating degree of freedom, theta = 0 upright."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sysid.ops import Value
from sysid.parameters import Parametric


@dataclass(frozen=True, eq=False)
class Plant(Parametric):
    """J theta_ddot = gravity_torque(theta) + tau, with theta = 0 upright and theta = pi hanging.

    turns: whether theta comes back to the same place after a turn.
    """

    turns: ClassVar[bool] = True

    def place(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where theta [rad] is: modulo a turn where the plant turns."""
        return np.mod(theta, 2.0 * math.pi) if self.turns else theta

    @abstractmethod
    def inertia(self) -> Value:
        """J [kg m^2], about the axis."""

    @abstractmethod
    def gravity_torque(self, theta: Value) -> Value:
        """Torque of gravity [N m] at theta [rad]; positive raises theta."""
