"""The interface of a plant: one rotating degree of freedom, theta = 0 upright."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sysid.physics.ops import Value
from sysid.physics.parameters import Parametric


@dataclass(frozen=True, eq=False)
class Plant(Parametric):
    """J theta_ddot = gravity_torque(theta) + tau, with theta = 0 upright and theta = pi hanging.

    turns: whether theta comes back to the same place after a turn.
    rest: where gravity lets it rest, and a spring is slack.
    scale: the parameter in which motion alone shows no scale: without a known torque it cannot be found.
    gravity: the parameter that is gravity alone, without which the plant has none; empty where each is inertia, too.
    units: what the units of turning are called for this plant, the longest first; empty for what turns.
    """

    turns: ClassVar[bool] = True
    rest: ClassVar[float] = math.pi
    scale: ClassVar[str] = "m"
    gravity: ClassVar[str] = ""
    units: ClassVar[Mapping[str, str]] = {}

    def unit(self, unit: str) -> str:
        """The name that a unit of turning has for this plant.

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

    def place(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Where theta [rad] is: modulo a turn where the plant turns."""
        return np.mod(theta, 2.0 * math.pi) if self.turns else theta

    @abstractmethod
    def inertia(self) -> Value:
        """J [kg m^2], about the axis."""

    @abstractmethod
    def gravity_torque(self, theta: Value) -> Value:
        """Torque of gravity [N m] at theta [rad]; positive raises theta."""
