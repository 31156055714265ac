"""Coordinates: unbounded numbers that stand for bounded parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import expit, logit

from sysid.physics.ops import Array
from sysid.physics.parameters import Parameter


class Coordinates:
    """The map p = g(s) from numbers s on the real line to parameters p within their bounds:

        low + (high - low) / (1 + exp(-s))     between two bounds
        low + c exp(s),  high - c exp(s)       with one bound
        c s                                    without bounds

    c is the parameter's scale. Any s (..., P) gives parameters (..., P) within their bounds.
    """

    def __init__(self, parameters: Sequence[Parameter]) -> None:
        low, high = np.array([p.bounds for p in parameters], dtype=float).T
        scale = np.array([p.scale for p in parameters], dtype=float)
        lower, upper = np.isfinite(low), np.isfinite(high)
        self._logistic, self._exponential = lower & upper, lower ^ upper
        self._origin = np.where(lower, low, np.where(upper, high, 0.0))
        self._factor = np.where(lower & upper, high - low, np.where(upper & ~lower, -scale, scale))

    def __call__(self, s: Array) -> Array:
        """Parameters (..., P) at s (..., P)."""
        unit = np.where(self._logistic, expit(s), s)
        if np.any(self._exponential):
            unit = np.where(self._exponential, np.exp(np.where(self._exponential, s, 0.0)), unit)
        p: Array = self._origin + self._factor * unit
        return p

    def inverse(self, p: Array) -> Array:
        """s (P,) of parameters (P,); a number at its bound is moved inside by 3 % of the width (or scale)."""
        unit = (p - self._origin) / self._factor
        bounded = self._logistic | self._exponential
        unit = np.where(bounded & (unit < 1e-9), 0.03, unit)
        unit = np.where(self._logistic & (unit > 1.0 - 1e-9), 0.97, unit)
        s = np.where(self._exponential, np.log(np.where(self._exponential, unit, 1.0)), unit)
        return np.where(self._logistic, logit(np.where(self._logistic, unit, 0.5)), s)

    def slope(self, s: Array) -> Array:
        """dp/ds (P,) at s (P,)."""
        share = expit(s)
        exponential = np.exp(np.where(self._exponential, s, 0.0))
        unit = np.where(self._logistic, share * (1.0 - share), np.where(self._exponential, exponential, 1.0))
        d: Array = self._factor * unit
        return d
