"""Disturbances: the random torque beside a model, and the errors of the angle beside white noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sysid.physics.ops import Array

CORRELATION_TIMES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Correlation times [s] of d that are tried; the likeliest is reported."""


@dataclass(frozen=True)
class Disturbances:
    """Three stationary Gaussian processes that a model does not explain.

        d:  random acceleration [rad/s^2], sd s, correlation time T [s]; times the inertia it is the random torque
        o:  error of the angle's reading [rad] that neighbouring readings share, sd sigma_o, correlation time T_o [s]:
            rounding at slow speed, stamps that jitter, a vibration of the structure. Where speeds alone are read it may
            be the speed's [rad/s], averaged over turns of an encoder, say (`Samples.error_channel`)
        f:  smooth error of the same reading, sd sigma_f, correlation time T_f [s]: a film's perspective, the edge of a
            marker, a swing that leaves its plane; of a speed the pitch of an encoder

    d and o are Ornstein-Uhlenbeck processes, x(t + dt) = exp(-dt / T) x(t) + w. Since d accumulates in the motion and o
    does not, d explains slow errors and o fast ones. f is a Matern process of order 3/2, which has a rate:

        E f(t) f(t + h) = sigma_f^2 (1 + a) exp(-a),    a = 2 h / T_f

    With s = sigma_o = sigma_f = 0 a fit is that of output error.

    Source: Kristensen, Madsen, Jorgensen, Automatica 40 (2004) 225, for d (stochastic grey-box models); Hartikainen,
    Sarkka, Kalman filtering and smoothing solutions to temporal Gaussian process regression models (2010), for f.
    """

    s: float
    T: float = 1.0
    sigma_o: float = 0.0
    T_o: float = 0.1
    sigma_f: float = 0.0
    T_f: float = 0.3

    @property
    def in_readings(self) -> bool:
        """Whether neighbouring readings share an error."""
        return self.sigma_o > 0.0 or self.sigma_f > 0.0

    @property
    def sizes(self) -> Array:
        """The sd (3,) of d, o and f."""
        return np.array([self.s, self.sigma_o, self.sigma_f])

    def scaled(self, by: Array | float) -> Disturbances:
        """The same with all sizes multiplied by a number, or each by its own (3,)."""
        s, sigma_o, sigma_f = (by * self.sizes).tolist()
        return replace(self, s=s, sigma_o=sigma_o, sigma_f=sigma_f)

    def with_memory(self, T: float) -> Disturbances:
        """The same with another correlation time T [s] of d; s is such that d changes as much from sample to sample."""
        return replace(self, s=self.s * math.sqrt(T / self.T), T=T)

    def shared_variance(self, lags: Array) -> Array:
        """The covariance [rad^2] of o + f with itself `lags` [s] later."""
        a = 2.0 * lags / self.T_f
        return self.sigma_o**2 * np.exp(-lags / self.T_o) + self.sigma_f**2 * (1.0 + a) * np.exp(-a)

    def discrete(self, dt: float) -> tuple[Array, Array, Array]:
        """The transition (4, 4) of (d, o, f, f' T_f / 2) over dt [s], the covariance (4, 4) of its increments, and the
        stationary variances (4,)."""
        a, factor = 2.0 * dt / self.T_f, np.zeros((4, 4))
        factor[0, 0], factor[1, 1] = math.exp(-dt / self.T), math.exp(-dt / self.T_o)
        factor[2:, 2:] = math.exp(-a) * np.array([[1.0 + a, a], [-a, 1.0 - a]])
        variance = np.square(self.sizes)[[0, 1, 2, 2]]
        return factor, np.diag(variance) - factor * variance @ factor.T, variance


NO_DISTURBANCE = Disturbances(0.0)
