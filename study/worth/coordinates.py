"""The coordinates in which what is known of a machine's parameters is normal: those in which its motion is linear.

    theta_ddot = u / J + (G / J) sin theta + ...

A torque tells of 1/J, not of J: a log of weak torques leaves room for a far heavier machine, and hardly for a lighter
one. So 1/J and G/J, in units of their fitted values, stand for the one or two parameters of the plant that are free,
which they are products of powers of. All other parameters stand for themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sysid import Model
from sysid.physics.ops import Array

STEP = 1e-6
"""Relative change of a parameter that its power in 1/J and G/J is told from."""


@dataclass(frozen=True, eq=False)
class NormalCoordinates:
    """x (P,) of parameters p (P,).

    x_i = prod_j (p_j / fitted_j)^power_ij   for i, j in `shown`,    x_i = p_i   for the others
    """

    fitted: Array
    shown: list[int] = field(default_factory=list)
    power: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def of(cls, model: Model, names: tuple[str, ...]) -> NormalCoordinates:
        """Those of the free parameters `names` of a fitted model."""
        values = {name: float(model.parameters[name].value) for name in names}
        fitted, plant = np.array(list(values.values())), set(model.plant.parameters)
        shown = [i for i, (name, value) in enumerate(values.items()) if name in plant and value > 0.0]
        if len(shown) not in (1, 2):
            return cls(fitted)

        def logs(**moved: float) -> Array:
            plant = model.with_parameters(moved).plant
            J, G = float(plant.inertia()), abs(float(plant.gravity_torque(0.5 * math.pi)))
            return np.array([-math.log(J), math.log(max(G, 1e-300) / J)])

        def powers(i: int) -> Array:
            upwards = fitted[i] * (1.0 + STEP) <= model.parameters[names[i]].bounds[1]
            share = 1.0 + STEP if upwards else 1.0 - STEP
            return (logs(**{names[i]: share * fitted[i]}) - logs()) / math.log(share)

        power = np.array([powers(i) for i in shown]).T
        if len(shown) == 1:
            power = power[np.argmax(np.abs(power[:, 0]))][None]
        return cls(fitted, shown, power) if abs(np.linalg.det(power)) > 1e-3 else cls(fitted)

    @property
    def slope(self) -> Array:
        """dx/dp (P, P) at the fitted parameters."""
        slope = np.eye(len(self.fitted))
        slope[np.ix_(self.shown, self.shown)] = self.power / self.fitted[self.shown]
        return slope

    def numbers(self, p: Array) -> Array:
        """x (..., P) of parameters p (..., P)."""
        x = np.array(p, dtype=float)
        x[..., self.shown] = np.exp(np.log(x[..., self.shown] / self.fitted[self.shown]) @ self.power.T)
        return x

    def parameters(self, x: Array) -> Array:
        """p (..., P) of x (..., P), nan where 1/J or G/J is not positive."""
        p = np.array(x, dtype=float)
        logs = np.log(np.where(p[..., self.shown] > 0.0, p[..., self.shown], np.nan))
        p[..., self.shown] = self.fitted[self.shown] * np.exp(logs @ np.linalg.pinv(self.power).T)
        return p
