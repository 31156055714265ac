"""What is known of a machine's parameters: a normal distribution, cut off where its bounds are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sysid import Estimate, InvalidInput

Array = NDArray[np.float64]

TRIED = 4096
"""Draws of the normal distribution of which those within the bounds are taken."""

FEW = 20
"""Draws within the bounds below which too little of the distribution lies there for its mean to be taken from them."""


@dataclass(frozen=True, eq=False)
class BoundedNormal:
    """The normal distribution of P parameters with mean (P,) and covariance (P, P), within low (P,) and high (P,)."""

    mean: Array
    covariance: Array
    low: Array
    high: Array

    @classmethod
    def of(cls, estimate: Estimate) -> BoundedNormal:
        """What a fit knows. Raises InvalidInput for a covariance that is not finite: nothing can be drawn then."""
        lost = [n for n, sd in estimate.sd.items() if not np.isfinite(sd)]
        if lost:
            raise InvalidInput(
                f"the log does not determine {', '.join(lost)}: expected a fit with finite intervals; fix what is "
                "known (--set), or measure first (sysid experiment)"
            )
        parameters = estimate.model.parameters
        low, high = np.array([parameters[name].bounds for name in estimate.names]).T
        return cls(np.array(list(estimate.values.values())), estimate.covariance, low, high)

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
                return found[:count]
        drawn = self.mean + rng.standard_normal((count, len(self.mean))) @ self.root.T
        return np.concatenate([found, np.clip(drawn, self.low, self.high)])[:count]

    @cached_property
    def centre(self) -> Array:
        """The mean (P,) of what lies within the bounds."""
        found = self._within(np.random.default_rng(0).standard_normal((TRIED, len(self.mean))))
        if len(found) == TRIED:
            return self.mean
        return np.asarray(np.mean(found, axis=0) if len(found) >= FEW else np.clip(self.mean, self.low, self.high))

    def _within(self, z: Array) -> Array:
        drawn = self.mean + z @ self.root.T
        return drawn[np.all((drawn >= self.low) & (drawn <= self.high), axis=1)]

    def after(self, information: Array, true: Array, z: Array) -> BoundedNormal:
        """What will be known after a log that tells F (P, P) of parameters `true` (P,), with noise z (P,) ~ N(0, 1).

        C' = (C^-1 + F)^-1,    mean' = mean + C' (F (true - mean) + F^(1/2) z)
        """
        R = self.root
        covariance = R @ np.linalg.inv(np.eye(len(R)) + R.T @ information @ R) @ R.T
        value, vector = np.linalg.eigh(information)
        noise = vector @ (np.sqrt(np.maximum(value, 0.0)) * z)
        mean = self.mean + covariance @ (information @ (true - self.mean) + noise)
        return BoundedNormal(mean, covariance, self.low, self.high)
