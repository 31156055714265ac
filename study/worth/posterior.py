"""What is known of a machine's parameters: a normal distribution in coordinates of its motion, within their bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from study.worth.coordinates import NormalCoordinates
from sysid import Estimate, InvalidInput
from sysid.physics.ops import Array

TRIED = 4096
"""Draws of the normal distribution of which those within the bounds are taken."""

FEW = 20
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
        root: Array = vector * np.sqrt(np.maximum(value, 0.0))
        return root

    def draws(self, rng: np.random.Generator, count: int) -> Array:
        """So many parameters (count, P). Where hardly any lie within the bounds, others are moved to the nearest."""
        found = np.zeros((0, len(self.mean)))
        for _ in range(8):
            found = np.concatenate([found, self._within(rng.standard_normal((TRIED, len(self.mean))))])
            if len(found) >= count:
                return self.coordinates.parameters(found[:count])
        near = np.clip(self.coordinates.fitted, *self.bounds.T)
        missing = np.broadcast_to(near, (count - len(found), len(near)))
        return np.concatenate([self.coordinates.parameters(found), missing])

    @cached_property
    def centre(self) -> Array:
        """The parameters (P,) at the mean of what lies within the bounds."""
        found = self._within(np.random.default_rng(0).standard_normal((TRIED, len(self.mean))))
        if len(found) == TRIED:
            return self.coordinates.parameters(self.mean)
        if len(found) < FEW:
            positive, shown = self.mean.copy(), self.coordinates.shown
            positive[shown] = np.maximum(positive[shown], 1e-3)
            return np.clip(self.coordinates.parameters(positive), *self.bounds.T)
        return np.clip(self.coordinates.parameters(np.mean(found, axis=0)), *self.bounds.T)

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
