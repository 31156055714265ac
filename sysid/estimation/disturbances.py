"""Disturbances: the random torque beside a model, and the error of the angle beside white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sysid.physics.ops import Array

CORRELATION_TIMES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Correlation times [s] of d that are tried; the likeliest is reported."""


@dataclass(frozen=True)
class Disturbances:
    """Two stationary Gaussian processes that a model does not explain.

        d:  random acceleration [rad/s^2], sd s, correlation time T [s]; times the inertia it is the random torque
        o:  error of the angle's reading [rad] that neighbouring readings share, sd sigma_o, correlation time T_o [s]:
            rounding at slow speed, stamps that jitter, a vibration of the structure. Where speeds alone are read it may
            be the speed's [rad/s], averaged over turns of an encoder, say (`Samples.shared`)

    Both are Ornstein-Uhlenbeck processes, x(t + dt) = exp(-dt / T) x(t) + w. Since d accumulates in the motion and o
    does not, d explains slow errors and o fast ones. With s = sigma_o = 0 a fit is that of output error.

    Source: Kristensen, Madsen, Jorgensen, Automatica 40 (2004) 225, for d (stochastic grey-box models).
    """

    s: float
    T: float = 1.0
    sigma_o: float = 0.0
    T_o: float = 0.1

    def moved(self, step: Array) -> Disturbances:
        """The same with s and sigma_o multiplied by exp(step) (2,)."""
        return Disturbances(self.s * math.exp(step[0]), self.T, self.sigma_o * math.exp(step[1]), self.T_o)

    def with_memory(self, T: float) -> Disturbances:
        """The same with another correlation time T [s] of d; s is such that d changes as much from sample to sample."""
        return replace(self, s=self.s * math.sqrt(T / self.T), T=T)

    def discrete(self, dt: float) -> tuple[Array, Array, Array]:
        """Factors (2,), variances of the increments (2,) and stationary variances (2,) of d and o over dt [s]."""
        factor = np.exp(-dt / np.array([self.T, self.T_o]))
        variance = np.square([self.s, self.sigma_o])
        return factor, variance * (1.0 - factor**2), variance


NO_DISTURBANCE = Disturbances(0.0)
