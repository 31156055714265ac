"""The solver: parameters, motion and disturbances by maximum likelihood of the prediction errors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sysid.estimation.disturbances import MEMORIES, NONE, Disturbances
from sysid.estimation.estimate import Estimate
from sysid.estimation.kalman import Filter
from sysid.estimation.linearisation import LinearisedModel, Motion, Samples, begin, level
from sysid.physics.model import Model
from sysid.physics.ops import Array


@dataclass(frozen=True)
class Settings:
    """How the solver works.

    iterations   Gauss-Newton steps, at most; each linearises the model about the motion that the one before found
    settled      a step below this share of every parameter's sd, which leaves the deviance within `negligible`, ends it
    negligible   change of the deviance (-2 log likelihood) that no statistic would notice
    sizes        whether the sizes of the disturbances are found, or stay
    angle_error  whether the size of the angle's coloured error is found too, or stays
    vague        sd of a number of the plant about the one that a fit begins with, as a share of it: where a random
                 torque explains all, the readings say nothing of an inertia, and it would run away
    stride       largest relative change of a parameter in a step
    widest       how far about the motion the model's slopes are taken, at most: in rad, and as shares of the sizes of
                 speed and acceleration; wider slopes are those of another machine
    smallest     sizes of the disturbances below this share of the motion's acceleration, of the sensor's sd, are none
    """

    iterations: int = 40
    settled: float = 0.02
    negligible: float = 0.05
    stride: float = 0.7
    widest: tuple[float, float, float] = (0.05, 0.1, 0.5)
    smallest: float = 1e-5
    sizes: bool = True
    angle_error: bool = True
    vague: float = 1.0


DEFAULT = Settings()
STRETCH = 1.0
"""Seconds over which what a model lacks hangs together."""
NUMBERS_GAIN = 6.0
"""Decrease of the deviance that two idle numbers bring in one of 20 logs."""
QUICK = Settings(iterations=12, settled=0.15, negligible=0.5, angle_error=False)
"""For a candidate that is only compared with others."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is vaguely known of the parameters: normals about `mean` (P,), of `precision` (P,) = 1 / sd^2; of those that
    are `positive` (P,) of their logarithm about that of the mean, so that no inertia vanishes."""

    mean: Array
    precision: Array
    positive: NDArray[np.bool_]

    @classmethod
    def of(
        cls, model: Model, names: Sequence[str], vague: float, known: Prior | None, known_names: Sequence[str]
    ) -> Prior:
        """The numbers of the plant as they are, vaguely; those that are `known` already as they are known."""
        own = dict(zip(known_names, zip(known.mean, known.precision, strict=True), strict=True)) if known else {}
        mean, precision = _values(model, names), np.zeros(len(names))
        positive = np.array([model.parameters[n].bounds[0] > 0.0 for n in names], dtype=bool)
        for i, name in enumerate(names):
            if name in own:
                mean[i], precision[i] = own[name]
            elif name in model.plant.parameters and mean[i] != 0.0:
                precision[i] = (vague * (1.0 if positive[i] else mean[i])) ** -2.0
        return cls(mean, precision, positive)

    def at(self, rows: Sequence[int]) -> Prior:
        """That of some of the parameters."""
        own = list(rows)
        return Prior(self.mean[own], self.precision[own], self.positive[own])

    def of_nothing(self) -> Prior:
        """That of no parameters."""
        return self.at(())

    def deviance(self, values: Array) -> float:
        """-2 log density at values (P,), up to a constant."""
        return float(np.sum(self.rows(values)[1] ** 2))

    def rows(self, values: Array) -> tuple[Array, Array]:
        """Sensitivities (P, P) and residuals (P,) that stand below those of the readings."""
        weight = np.sqrt(self.precision)
        slope = np.where(self.positive, 1.0 / np.maximum(values, 1e-300), 1.0)
        off = np.where(self.positive, np.log(np.maximum(self.mean, 1e-300) * slope), self.mean - values)
        return np.diag(weight * slope), weight * off


@dataclass(frozen=True, eq=False)
class Fit:
    """Where the solver ended.

        min_p  sum_k log det S_k + |e_k|^2,    e_k innovations whitened by their predicted covariance S_k

    model, names     the fitted model and which of its parameters were free
    linearised       the model along the smoothed motion
    filter           the Kalman filter there
    Z (2 M, P)       whitened sensitivities of the innovations
    prior            what is known beside the readings
    converged        whether another step would change nothing
    """

    samples: Samples
    model: Model
    names: tuple[str, ...]
    linearised: LinearisedModel
    filter: Filter
    Z: Array
    prior: Prior
    converged: bool

    @property
    def disturbances(self) -> Disturbances:
        """The likeliest disturbances."""
        return self.filter.disturbances

    @property
    def motion(self) -> Motion:
        """What the model was linearised about."""
        return self.linearised.motion

    @property
    def e(self) -> Array:
        """Innovations (2 M,)."""
        return self.filter.innovations.ravel()

    @property
    def deviance(self) -> float:
        """-2 log likelihood, up to a constant that depends on the sensor alone; a reading that the model cannot use
        counts as one that it explains to the noise."""
        return self.filter.deviance + self.linearised.unused + self.prior.deviance(self.values)

    @property
    def values(self) -> Array:
        """The fitted numbers (P,)."""
        return _values(self.model, self.names)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns (2 M, P) of what the free parameters can do to the innovations."""
        return np.linalg.qr(self.Z)[0] if len(self.names) else self.Z

    @property
    def at_bounds(self) -> set[str]:
        """The free numbers that ended at a bound, where that is not the one at which an effect changes nothing."""
        own = {n: self.model.parameters[n] for n in self.names}
        return {n for n, p in own.items() if float(p.value) in p.bounds and float(p.value) != p.neutral}

    @property
    def inertia(self) -> float:
        """What d is multiplied with to be a torque [kg m^2]."""
        return float(self.model.inertia())

    @cached_property
    def covariance(self) -> Array:
        """(P, P) of the parameters, by the readings alone; infinite where these do not determine some direction.

        Beside a random torque the sd of each is at least what the scatter of the likelihood's slope g = Z'e over
        stretches of a second makes it: no Gaussian process is what a model lacks.

            sd_i^2 = (N^-1 sum_b g_b g_b' N^-1)_ii,    N = Z'Z
        """
        covariance = inverse(self.Z.T @ self.Z)
        widened: Array = covariance * np.outer(self.wider, self.wider)
        return widened

    @cached_property
    def wider(self) -> Array:
        """(P,) by how much that scatter makes the sd larger than the likelihood's curvature does, at least 1."""
        covariance = inverse(self.Z.T @ self.Z)
        if self.undisturbed or not np.all(np.isfinite(covariance)):
            return np.ones(len(self.names))
        return np.sqrt(np.maximum(np.diag(self._scattered(covariance)) / np.diag(covariance), 1.0))

    def _scattered(self, covariance: Array) -> Array:
        """Covariance (P, P) by the scatter of the likelihood's slope over stretches of `STRETCH` (Huber, White)."""
        samples = self.samples
        stretch = np.floor(samples.t / STRETCH).astype(np.intp) + 10_000_000 * samples.number
        _, number = np.unique(stretch, return_inverse=True)
        slope = (self.Z * self.e[:, None]).reshape(len(samples), 2, -1).sum(axis=1)
        total = np.zeros((int(number[-1]) + 1, slope.shape[1]))
        np.add.at(total, number, slope)
        scattered: Array = covariance @ (total.T @ total) @ covariance
        return scattered

    @cached_property
    def undisturbed(self) -> bool:
        """Whether the log needs no disturbance: without any its deviance is as good, but for what two numbers gain.

        Either way the readings may be as noisy as they turn out: white errors larger than was told are the noise.
        """
        none = replace(self.disturbances, s=0.0, sigma_o=0.0)
        read = self.samples.weight > 0.0
        bare, here = (_whatever_the_noise(f, read) for f in (self.linearised.system.filter(none), self.filter))
        return bare - here < NUMBERS_GAIN

    @cached_property
    def likeliest_torque(self) -> Disturbances:
        """The disturbances under which the log is likeliest, beside these numbers; NONE where it needs none.

        Those of the fit may have another correlation time, under which its numbers predict better.
        """
        if self.undisturbed:
            return NONE
        return maximum_likelihood(self.linearised, (self.disturbances.with_memory(T) for T in MEMORIES))

    def estimate(self, method: str = "prediction error") -> Estimate:
        """The answer of an identifier."""
        samples, e = self.samples, self.linearised.system.r
        noise = {}
        for k, channel in enumerate(("theta", "theta_dot")):
            read = samples.weight[:, k] > 0.0
            if np.any(read):
                noise[channel] = float(np.sqrt(np.mean((e[read, k] / samples.weight[read, k]) ** 2)))
        known, torque = bool(np.all(np.isfinite(self.covariance))), self.likeliest_torque
        status = "converged" if self.converged else "stopped before it converged: begin nearer, or free fewer numbers"
        if not self.undisturbed:
            status = f"{status}; the model lacks something: a random torque acts beside it"
        if not known:
            status = f"{status}; yet the records do not determine {', '.join(self.names)}"
        return Estimate(
            model=self.model,
            names=self.names,
            covariance=self.covariance,
            noise=noise,
            success=self.converged and known,
            status=status,
            cost=float(np.sum(self.e**2)),
            n_readings=samples.readings,
            method=method,
            sensor=samples.sensor,
            random_torque=torque.s * self.inertia,
            correlation_time=torque.T if torque.s else 0.0,
        )


def fit(
    samples: Samples,
    model: Model,
    names: Sequence[str],
    near: Fit | None = None,
    disturbances: Disturbances | None = None,
    settings: Settings = DEFAULT,
) -> Fit:
    """The likeliest parameters, begun at the model's numbers, along the motion of a fit that is `near`.

    disturbances   where their sizes begin; their correlation times stay. By default those of `near`, else large: nearly
                   a regression, which finds its way from far off
    """
    names = tuple(names)
    if disturbances is None:
        disturbances = near.disturbances if near else Disturbances(0.3 * level(samples), sigma_o=_angle_sd(samples))
    motion = (near.motion if near else begin(samples, disturbances.s)).of_model(samples, model)
    prior = Prior.of(model, names, settings.vague, near.prior if near else None, near.names if near else ())
    limits = _Limits.of(samples, model, names, prior, settings)
    before, converged, restless = math.inf, False, settings.sizes
    last: Fit | None = None
    for k in range(settings.iterations):
        linearised = LinearisedModel(samples, model, motion)
        if k > 0 and settings.sizes and (restless or k % 4 == 3):
            likely = likelihood_ascent(linearised, disturbances, limits.floor, settings.angle_error)
            restless = bool(np.max(np.abs(_logs(likely) - _logs(disturbances))) > 0.05)
            disturbances = likely
        here = linearised.system.filter(disturbances)
        if last is not None and not math.isfinite(here.deviance):
            return last
        G, R = linearised.changes(names)
        Z, now = here.whiten(G, R), _values(model, names)
        step = _step(here, Z, prior, now, limits)
        moved = float(np.linalg.norm(Z @ step)) if len(step) else 0.0
        step = limits.shortened(step, now, settings.stride)
        if k >= 2 and not restless and moved < settings.settled and abs(here.deviance - before) < settings.negligible:
            converged = True
            break
        before, last = here.deviance, Fit(samples, linearised.model, names, linearised, here, Z, prior, False)
        # slopes that go on changing with the filter's sd would never let friction's numbers settle
        spread = limits.spread(here) if k < settings.iterations // 4 else motion.spread
        motion = motion.moved(here.smooth(G @ step, R @ step), spread)
        model = model.with_parameters(dict(zip(names, limits.within(now + step).tolist(), strict=True)))
    return Fit(samples, linearised.model, names, linearised, here, Z, prior, converged)


@dataclass(frozen=True, eq=False)
class _Limits:
    """How far the solver may go.

    low, high (P,)   bounds of the numbers; positive (P,): which of them may not be 0
    reach (P,)       change of each over which its effect may be nowhere near linear
    widest (3,)      how far about the motion slopes are taken [rad], [rad/s], [rad/s^2]
    floor (2,)       logarithms of the disturbances' sizes below which there are none
    """

    low: Array
    high: Array
    positive: NDArray[np.bool_]
    reach: Array
    widest: Array
    floor: Array

    @classmethod
    def of(cls, samples: Samples, model: Model, names: Sequence[str], prior: Prior, settings: Settings) -> _Limits:
        """Those of a model on the samples of a log, beside what is known of its numbers."""
        size = level(samples)
        low, high = (np.array([model.parameters[n].bounds[side] for n in names]) for side in (0, 1))
        reach = np.array([_reach(model, n, typical) for n, typical in zip(names, prior.mean, strict=True)])
        typical_speed = float(np.std(samples.smoothed[:, 1]))
        widest = np.array([*np.array(settings.widest) * [1.0, typical_speed, size], *model.start_sd])
        floor = np.log([settings.smallest * size, settings.smallest * max(_angle_sd(samples), 1e-12)])
        return cls(low, high, prior.positive, reach, widest, floor)

    def within(self, values: Array) -> Array:
        """Numbers (P,) within their bounds."""
        return np.clip(values, self.low, self.high)

    def shortened(self, step: Array, now: Array, stride: float) -> Array:
        """The step (P,) from `now`, all of it shortened so that no number goes further than is near linear."""
        # a positive number on its way down would be at its bound in two steps of its typical size
        longest = stride * np.where(self.positive & (step < 0.0), now, np.maximum(self.reach, np.abs(now)))
        shorter: Array = step * min([1.0, *(longest / np.maximum(np.abs(step), 1e-300))])
        return shorter

    def spread(self, filter: Filter) -> Array:
        """How far off the motion (M, 3 + q) may be: a filter knows less than a smoother, and its sd is wide enough
        where a joint sticks."""
        return np.minimum(filter.sd[:, filter.system.driving], self.widest)


def _step(filter: Filter, Z: Array, prior: Prior, now: Array, limits: _Limits) -> Array:
    """The Gauss-Newton step (P,) of the numbers, by the innovations and by what is known beside them."""
    rows, rest = prior.rows(now)
    below = np.concatenate([Z, rows]), np.concatenate([filter.innovations.ravel(), rest])
    return bounded_step(*below, limits.low - now, limits.high - now)


def likelihood_ascent(
    linearised: LinearisedModel, disturbances: Disturbances, floor: Array, angle_error: bool = True
) -> Disturbances:
    """Disturbances of larger likelihood about the same motion: one Newton step of v = (log s, log sigma_o), or of the
    first alone.

    Slope and curvature are differences over a factor of 1.35, which is less than a log can tell; where the curvature is
    negative the step follows the slope, by a factor of e at most.
    """
    system, h, now = linearised.system, 0.3, _logs(disturbances)
    free = [i for i in range(1 + angle_error) if now[i] > floor[i]]
    if not free:
        return disturbances

    def deviance(move: Array) -> float:
        return system.filter(disturbances.moved(move)).deviance

    here, unit = deviance(np.zeros(2)), h * np.eye(2)[free]
    up, down = np.array([deviance(v) for v in unit]), np.array([deviance(-v) for v in unit])
    slope, curvature = (up - down) / (2.0 * h), np.diag(up - 2.0 * here + down) / h**2
    if len(free) == 2:
        both = (deviance(unit[0] + unit[1]) - up[0] - up[1] + here) / h**2
        curvature[0, 1] = curvature[1, 0] = both
    size, axes = np.linalg.eigh(curvature)
    along = -(axes.T @ slope) / np.maximum(np.abs(size), 1e-3)
    move = np.zeros(2)
    move[free] = axes @ np.clip(along, -1.0, 1.0)
    trials = [(here, np.zeros(2)), *zip(up, unit, strict=True), *zip(down, -unit, strict=True)]
    for share in (1.0, 0.3):
        own = np.maximum(share * move, np.minimum(floor - now, 0.0))
        trials.append((deviance(own), own))
        if trials[-1][0] < here:
            break
    return disturbances.moved(min(trials, key=lambda own: own[0])[1])


def _logs(disturbances: Disturbances) -> Array:
    """(log s, log sigma_o), far below any floor where they are 0."""
    return np.log(np.maximum([disturbances.s, disturbances.sigma_o], 1e-300))


def maximum_likelihood(
    linearised: LinearisedModel, begins: Iterable[Disturbances], angle_error: bool = True
) -> Disturbances:
    """The likeliest of disturbances about the same motion, each first moved to likelier sizes."""
    floor, deviances = np.array([-40.0, -40.0]), dict[Disturbances, float]()
    for begun in begins:
        trial = begun
        for _ in range(3):
            trial = likelihood_ascent(linearised, trial, floor, angle_error)
        deviances[trial] = linearised.system.filter(trial).deviance
    return min(deviances, key=lambda own: deviances[own])


def with_likely_angle_error(fitted: Fit, times: Sequence[float] = (0.03, 0.3, 1.0)) -> Disturbances:
    """The disturbances of that correlation time T_o [s] of the angle's error under which the log is likeliest."""
    return maximum_likelihood(fitted.linearised, (replace(fitted.disturbances, T_o=T_o) for T_o in times))


def bounded_step(Z: Array, e: Array, low: Array, high: Array) -> Array:
    """min |e - Z step|^2 within low <= step <= high (P,); what the readings do not determine does not move."""
    if Z.shape[1] == 0:
        return np.zeros(0)
    size = np.linalg.norm(Z, axis=0)
    moves = size > 0.0
    step = np.zeros(Z.shape[1])
    free = moves.copy()
    for _ in range(Z.shape[1] + 1):
        at = np.flatnonzero(free)
        if not len(at):
            break
        rest = e - Z @ np.where(free, 0.0, step)
        scaled = Z[:, at] / size[at]
        step[at] = np.linalg.lstsq(scaled, rest, rcond=1e-9)[0] / size[at]
        outside = free & ((step < low) | (step > high))
        if not np.any(outside):
            break
        step = np.where(outside, np.clip(step, low, high), step)
        free &= ~outside
    return np.clip(step, low, high)


def inverse(information: Array) -> Array:
    """The covariance (P, P), scaled before it is inverted; infinite where some direction is not determined."""
    size = np.sqrt(np.diag(information))
    if np.all(size > 0.0):
        scaled = information / np.outer(size, size)
        if len(size) == 0 or np.linalg.eigvalsh(scaled)[0] > 1e-12:
            found: Array = np.linalg.inv(scaled) / np.outer(size, size)
            return 0.5 * (found + found.T)
    return np.full_like(information, np.inf)


def _angle_sd(samples: Samples) -> float:
    """The sd of the angle's readings, 0 where hardly any instant has one: a start that is known is no reading."""
    weight = samples.weight[:, 0]
    return float(1.0 / np.max(weight)) if np.mean(weight > 0.0) > 0.5 else 0.0


def _values(model: Model, names: Sequence[str]) -> Array:
    parameters = model.parameters
    return np.array([float(parameters[n].value) for n in names])


def _reach(model: Model, name: str, typical: float) -> float:
    """Over which change of a number its effect may be nowhere near linear; inf for one without bounds above, such as a
    friction, in which the motion is linear enough."""
    p = model.parameters[name]
    if name not in model.plant.parameters and math.isinf(p.bounds[1]):
        return math.inf
    return max(abs(typical), 0.0 if name in model.plant.parameters else 0.1 * min(p.bounds[1] - p.bounds[0], 1.0))


def _whatever_the_noise(filter: Filter, read: NDArray[np.bool_]) -> float:
    """-2 log likelihood, all variances of a channel times the number from 1 on that makes it smallest."""
    deviance = float(np.sum(filter.log_variances[read]))
    for channel in range(2):
        e = filter.innovations[read[:, channel], channel]
        size = float(np.mean(e**2)) if len(e) else 0.0
        deviance += len(e) * (1.0 + math.log(size) if size > 1.0 else size)
    return deviance
