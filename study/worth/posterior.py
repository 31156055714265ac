"""What is known of a machine's parameters: a normal distribution within their bounds, in the coordinates in which the
machine's motion is linear.

    theta_ddot = u / J + (G / J) sin theta + ...

A torque tells of 1/J, not of J: a log of weak torques leaves room for a far heavier machine, and hardly for a lighter
one. So 1/J and G/J, in units of their fitted values, stand for the one or two parameters of the plant that are free,
which they are products of powers of. All other parameters stand for themselves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sysid import Estimate, InvalidInput, Model
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
            J, G = float(plant.inertia()), abs(float(plant.largest_gravity_torque))
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


TRIED = 4096
"""Draws of the normal distribution of which those within the bounds are taken."""

FEWEST_DRAWS = 20
"""Draws within the bounds below which too little of the distribution lies there for its mean to be taken from them."""


@dataclass(frozen=True, eq=False)
class BoundedNormal:
    """x ~ N(mean (P,), covariance (P, P)), where the parameters p(x) lie within bounds (P, 2)."""

    coordinates: NormalCoordinates
    mean: Array
    covariance: Array
    bounds: Array

    @classmethod
    def of(cls, estimate: Estimate) -> BoundedNormal:
        """What a fit knows. Raises InvalidInput for a covariance that is not finite: nothing can be drawn then."""
        lost = [n for n, sd in estimate.sd.items() if not np.isfinite(sd)]
        if lost:
            raise InvalidInput(
                f"the log does not determine {', '.join(lost)}: expected a fit with finite intervals; fix what is "
                "known (--set), or measure first (sysid experiment)"
            )
        coordinates = NormalCoordinates.of(estimate.model, estimate.names)
        bounds = np.array([estimate.model.parameters[name].bounds for name in estimate.names])
        slope = coordinates.slope
        return cls(coordinates, coordinates.numbers(coordinates.fitted), slope @ estimate.covariance @ slope.T, bounds)

    @cached_property
    def root(self) -> Array:
        """R (P, P) of covariance = R R'."""
        value, vector = np.linalg.eigh(self.covariance)
        return vector * np.sqrt(np.maximum(value, 0.0))

    def draws(self, rng: np.random.Generator, count: int) -> Array:
        """So many parameters (count, P). Where hardly any lie within the bounds, others are moved to the nearest."""
        inside = np.zeros((0, len(self.mean)))
        for _ in range(8):
            inside = np.concatenate([inside, self._within(rng.standard_normal((TRIED, len(self.mean))))])
            if len(inside) >= count:
                return self.coordinates.parameters(inside[:count])
        near = np.clip(self.coordinates.fitted, *self.bounds.T)
        missing = np.broadcast_to(near, (count - len(inside), len(near)))
        return np.concatenate([self.coordinates.parameters(inside), missing])

    @cached_property
    def centre(self) -> Array:
        """The parameters (P,) at the mean of what lies within the bounds."""
        inside = self._within(np.random.default_rng(0).standard_normal((TRIED, len(self.mean))))
        if len(inside) == TRIED:
            return self.coordinates.parameters(self.mean)
        if len(inside) < FEWEST_DRAWS:
            positive, shown = self.mean.copy(), self.coordinates.shown
            positive[shown] = np.maximum(positive[shown], 1e-3)
            return np.clip(self.coordinates.parameters(positive), *self.bounds.T)
        return np.clip(self.coordinates.parameters(np.mean(inside, axis=0)), *self.bounds.T)

    def _within(self, z: Array) -> Array:
        """Those x (D, P) of standard normal z whose parameters are within the bounds."""
        x = self.mean + z @ self.root.T
        p, (low, high) = self.coordinates.parameters(x), self.bounds.T
        return x[np.all((p >= low) & (p <= high), axis=1)]

    def after(self, information: Array, true: Array, z: Array) -> BoundedNormal:
        """What will be known after a log that tells F (P, P) of the parameters, where these are `true` (P,).

            C' = (C^-1 + F)^-1,    mean' = mean + C' (F (x_true - mean) + F^(1/2) z)

        in coordinates x; z (P,) ~ N(0, 1) is the log's noise.
        """
        R, back = self.root, np.linalg.inv(self.coordinates.slope)
        F = back.T @ information @ back
        covariance = R @ np.linalg.inv(np.eye(len(R)) + R.T @ F @ R) @ R.T
        value, vector = np.linalg.eigh(F)
        noise = vector @ (np.sqrt(np.maximum(value, 0.0)) * z)
        mean = self.mean + covariance @ (F @ (self.coordinates.numbers(true) - self.mean) + noise)
        return replace(self, mean=mean, covariance=covariance)
