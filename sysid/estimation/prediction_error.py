"""Prediction error: a fitted model with its filter, and the covariance and tests that follow from the innovations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.estimation.disturbances import CORRELATION_TIMES, NO_DISTURBANCE, Disturbances
from sysid.estimation.energy_balance import EnergyBalance
from sysid.estimation.estimate import Estimate
from sysid.estimation.kalman import Filter
from sysid.estimation.likelihood import maximum_likelihood
from sysid.estimation.linearisation import LinearisedModel, Motion, Samples
from sysid.estimation.prior import Prior
from sysid.physics.model import Model
from sysid.physics.ops import Array

STRETCH = 1.0
"""Length [s] of the stretches over which the effects of what a model lacks are correlated."""
CHECKED = 0.99
"""Share of a stretch that the jackknife leaves out: with all of it, a number that one stretch alone tells would have no
interval."""

SHORT = 0.03
"""Correlation time [s] of an error o beside a smooth one, of which it is not a part."""
SMOOTH = (0.1, 0.3, 1.0)
"""Correlation times [s] of a smooth error f that are tried."""
LARGEST_ERROR = 0.1
"""Share of the motion's standard deviation that an error of its readings does not reach."""
NUMBERS_GAIN = 6.0
"""Decrease of the deviance that two superfluous numbers bring in one of 20 logs."""
LARGEST_NOISE = 6.0
"""Errors of so many times the noise cannot mean that the noise was given too small: something is missing."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: where the solver ended.

        min_p  sum_k log det S_k + |e_k|^2,    e_k innovations whitened by their predicted covariance S_k

    model, names     the fitted model and the names of its P free parameters
    linearised       the model linearised along the smoothed motion
    filter           the Kalman filter of that linear system
    Z (2 M, P)       sensitivities of the whitened innovations to the parameters
    prior            what is known of the parameters before any reading
    converged        whether another step would change nothing
    balance          the energy balance of a free swing, if it is read beside the readings
    """

    samples: Samples
    model: Model
    names: tuple[str, ...]
    linearised: LinearisedModel
    filter: Filter
    Z: Array
    prior: Prior
    converged: bool
    balance: EnergyBalance | None = None

    @property
    def disturbances(self) -> Disturbances:
        """The likeliest disturbances."""
        return self.filter.disturbances

    @property
    def motion(self) -> Motion:
        """The motion that the model was linearised about."""
        return self.linearised.motion

    @property
    def e(self) -> Array:
        """Innovations (2 M,)."""
        return self.filter.innovations.ravel()

    @cached_property
    def deviance(self) -> float:
        """-2 log likelihood with the prior, up to a constant that depends on the sensor alone; a reading that the model
        cannot use counts 1, as if it were explained to the noise."""
        of_balance = self.balance.deviance(self.model) if self.balance else 0.0
        return self.filter.deviance + self.linearised.unused + self.prior.deviance(self.values) + of_balance

    @property
    def values(self) -> Array:
        """The fitted numbers (P,)."""
        return self.model.numbers(self.names)

    @cached_property
    def balance_rows(self) -> tuple[Array, Array]:
        """Sensitivities B (K, P) and errors (K,) of the energy balance; without one K is 0."""
        if self.balance is None or not self.names:
            return np.zeros((0, len(self.names))), np.zeros(0)
        return self.balance.rows(self.model, self.names)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns (2 M, P or fewer) that span how the free parameters can change the innovations, without
        those parameters that ended at a bound."""
        free = [n not in self.at_bounds for n in self.names]
        return np.linalg.qr(self.Z[:, free])[0] if any(free) else self.Z[:, free]

    @property
    def at_bounds(self) -> set[str]:
        """The free parameters that ended at a bound other than the value at which their effect changes nothing."""
        free = {n: self.model.parameters[n] for n in self.names}
        return {n for n, p in free.items() if float(p.value) in p.bounds and float(p.value) != p.neutral}

    @property
    def inertia(self) -> float:
        """The model's inertia [kg m^2]: d times it is the random torque."""
        return float(self.model.inertia())

    @cached_property
    def covariance(self) -> Array:
        """Covariance (P, P) of the parameters from the readings alone; infinite if they leave a direction undetermined.

        What a model lacks is no Gaussian process. Beside a random torque the sd of each parameter is therefore at least
        that of the jackknife, which leaves out one of K stretches b of a second after the other:

            p_b = p - (N - N_b)^-1 g_b,    N = Z'Z,  N_b = Z_b'Z_b,  g_b = Z_b'e_b
            sd_i^2 = (K - 1) / K sum_b (p_b - p)_i^2

        Efron, The Jackknife, the Bootstrap and Other Resampling Plans (1982); for regressions it is CV3 of MacKinnon,
        Nielsen, Webb, Journal of Econometrics 232 (2023) 272.
        """
        return self.likelihood_covariance * np.outer(self.wider, self.wider)

    @cached_property
    def likelihood_covariance(self) -> Array:
        """The covariance (P, P) from the likelihood's curvature."""
        B, _ = self.balance_rows
        return inverse(self.Z.T @ self.Z + B.T @ B)

    @cached_property
    def wider(self) -> Array:
        """The factor (P,), at least 1, by which the jackknife's sd exceeds that from the likelihood's curvature."""
        return np.sqrt(np.maximum((1.0 - 1.0 / len(self._stretches)) * self._scatter(CHECKED), 1.0))

    @cached_property
    def excess(self) -> Array:
        """The factor (P,), at least 1, by which even a superfluous number gains more likelihood than theory says.

        It is the variance by Huber's and White's sandwich, sum_b N^-1 g_b g_b' N^-1, over that from the curvature.
        """
        return np.maximum(self._scatter(0.0), 1.0)

    def _scatter(self, left_out: float) -> Array:
        """The variances (P,) sum_b p_b^2, p_b = (N - left_out N_b)^-1 g_b, over those from the likelihood's curvature;
        1 without disturbances, and if the readings leave a direction undetermined."""
        if self.undisturbed or not np.all(np.isfinite(self.likelihood_covariance)):
            return np.ones(len(self.names))
        B, _ = self.balance_rows
        moved = jackknife(self.Z, self.e, self._stretches, left_out, B)
        sd = np.sqrt(np.sum(np.square(moved), axis=0)) + np.linalg.norm(self.likelihood_covariance @ B.T, axis=1)
        return sd**2 / np.diag(self.likelihood_covariance)

    @cached_property
    def _stretches(self) -> list[slice]:
        """The innovations of each stretch of `STRETCH`."""
        stretch = np.floor(self.samples.t / STRETCH) + 1e7 * self.samples.number
        begins = [*np.flatnonzero(np.diff(stretch, prepend=-1.0)).tolist(), len(self.samples)]
        return [slice(2 * a, 2 * b) for a, b in pairwise(begins)]

    @cached_property
    def undisturbed(self) -> bool:
        """Whether the log needs no disturbance: without any, the errors are below LARGEST_NOISE, and the deviance is
        larger by less than NUMBERS_GAIN.

        For both deviances the sensor's noise is scaled up to the errors: a noise given too small asks for no
        disturbance.
        """
        none = replace(self.disturbances, s=0.0, sigma_o=0.0, sigma_f=0.0)
        without, read = self.linearised.system.filter(none), self.samples.weight > 0.0
        with np.errstate(over="ignore"):  # of a model that runs away
            if float(np.sqrt(np.mean(without.innovations[read] ** 2))) > LARGEST_NOISE:
                return False
        bare, here = (_whatever_the_noise(f, read) for f in (without, self.filter))
        return bare - here < NUMBERS_GAIN

    @property
    def errs_by_little(self) -> bool:
        """Whether the error that neighbouring readings share is much smaller than the motion. A larger one stands for a
        motion that the model lacks."""
        motion = float(np.std(self.samples.smoothed[:, self.samples.error_channel]))
        return float(self.disturbances.shared_variance(np.zeros(1))[0]) < (LARGEST_ERROR * motion) ** 2

    @cached_property
    def likeliest_torque(self) -> Disturbances:
        """The disturbances under which the log is likeliest, given these numbers; NO_DISTURBANCE if it needs none.

        They hold no random torque if an error of the angle alone does as well. The fit's own disturbances may have
        another correlation time, under which its numbers predict better.
        """
        if self.undisturbed:
            return NO_DISTURBANCE
        system = self.linearised.system
        likeliest = maximum_likelihood(system, (self.disturbances.with_memory(T) for T in CORRELATION_TIMES))
        still = maximum_likelihood(system, [replace(likeliest, s=0.0)])
        needed = system.filter(still).deviance - system.filter(likeliest).deviance >= NUMBERS_GAIN
        return likeliest if needed else still

    def estimate(self, method: str = "prediction error") -> Estimate:
        """The answer of an identifier."""
        samples, e = self.samples, self.linearised.system.r
        noise = {}
        for k, channel in enumerate(("theta", "theta_dot")):
            read = samples.weight[:, k] > 0.0
            if np.any(read):
                noise[channel] = float(np.sqrt(np.mean((e[read, k] / samples.weight[read, k]) ** 2)))
        variances, torque = np.diag(self.covariance), self.likeliest_torque
        lost = [n for n, v in zip(self.names, variances, strict=True) if not math.isfinite(v)]
        status = "converged" if self.converged else "stopped before it converged: begin nearer, or free fewer numbers"
        if torque.s:
            status = f"{status}; the model lacks something: a random torque acts beside it"
        elif torque.in_readings:
            channel = ("angle", "speed")[samples.error_channel]
            status = f"{status}; neighbouring readings of the {channel} share an error beside their noise"
        if lost:
            status = f"{status}; yet the records do not determine {', '.join(lost)}"
        return Estimate(
            model=self.model,
            names=self.names,
            covariance=self.covariance,
            noise=noise,
            success=self.converged and not lost,
            status=status,
            cost=float(np.sum(self.e**2)),
            n_readings=samples.readings,
            method=method,
            sensor=samples.sensor,
            random_torque=torque.s * self.inertia,
            correlation_time=torque.T if torque.s else 0.0,
        )


def with_likely_shared_error(fitted: Fit, times: Sequence[float] = (0.03, 0.3, 1.0)) -> Disturbances:
    """The fit's disturbances with the likeliest correlation time T_o [s] of the readings' shared error among `times`.

    Each begins as large as lets neighbouring readings differ as much as now. An error of speeds is much like a random
    torque, which has taken its place: a larger one is tried in its place, too.
    """
    now = fitted.disturbances
    begins = [replace(now, sigma_o=now.sigma_o * math.sqrt(T_o / now.T_o), T_o=T_o) for T_o in times]
    if fitted.samples.error_channel:
        begins += [replace(now, s=0.1 * now.s, sigma_o=now.s * min(now.T, T_o), T_o=T_o) for T_o in times]
    return maximum_likelihood(fitted.linearised.system, begins)


def with_smooth_error(fitted: Fit) -> Disturbances:
    """The fit's disturbances with a smooth error of the readings, of the likeliest correlation time T_f of SMOOTH.

    It begins as large as lets neighbouring readings differ as much as now, in place of most of the random torque, and
    beside an error o of a short memory. Neighbouring speeds differ by the random torque, too.
    """
    now, neighbours = fitted.disturbances, np.array([0.0, fitted.samples.dt])
    short = replace(now, s=0.1 * now.s, sigma_o=now.sigma_o * math.sqrt(SHORT / now.T_o), T_o=SHORT)
    alone = [Disturbances(0.0, sigma_f=1.0, T_f=T_f) for T_f in SMOOTH]
    change, *changes = (-float(np.diff(of.shared_variance(neighbours))[0]) for of in (now, *alone))
    if fitted.samples.error_channel:
        change += 0.5 * (now.s * fitted.samples.dt) ** 2
    begins = [
        replace(short, sigma_f=math.sqrt(change / each), T_f=T_f) for each, T_f in zip(changes, SMOOTH, strict=True)
    ]
    return maximum_likelihood(fitted.linearised.system, begins)


def jackknife(Z: Array, e: Array, stretches: Sequence[slice], left_out: float, B: Array) -> Array:
    """How far the numbers move (K, P) if a share of each stretch b of the rows of Z and e is left out; the rows B stay.

    (N - left_out Z_b' Z_b)^-1 Z_b' e_b,    N = Z'Z + B'B
    """
    size = np.linalg.norm(np.concatenate([Z, B]), axis=0)
    Z, B = Z / size, B / size
    N = Z.T @ Z + B.T @ B
    return np.array([np.linalg.solve(N - left_out * Z[b].T @ Z[b], Z[b].T @ e[b]) / size for b in stretches])


def inverse(information: Array) -> Array:
    """The covariance (P, P) from an information matrix, scaled before it is inverted; infinite if it is singular.

    A parameter without any information gets an infinite variance, and the others are inverted without it.
    """
    size = np.sqrt(np.diag(information))
    shown = np.flatnonzero(size > 0.0)
    covariance = np.diag(np.where(size > 0.0, 0.0, np.inf))
    if len(shown):
        both = np.ix_(shown, shown)
        scale = np.outer(size[shown], size[shown])
        scaled = information[both] / scale
        determined = np.linalg.eigvalsh(scaled)[0] > 1e-12
        inverted = np.linalg.inv(scaled) / scale if determined else np.full_like(scaled, np.inf)
        covariance[both] = 0.5 * (inverted + inverted.T)
    return covariance


def _whatever_the_noise(filter: Filter, read: NDArray[np.bool_]) -> float:
    """-2 log likelihood, with each channel's variances multiplied by the factor, at least 1, that minimises it."""
    deviance = float(np.sum(filter.log_variances[read]))
    for channel in range(2):
        e = filter.innovations[read[:, channel], channel]
        with np.errstate(over="ignore"):  # of a model that runs away
            size = float(np.mean(e**2)) if len(e) else 0.0
        deviance += len(e) * (1.0 + math.log(size) if size > 1.0 else size)
    return deviance
