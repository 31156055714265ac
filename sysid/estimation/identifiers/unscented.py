"""Unscented Kalman filter with parameters as states, swept over the rollouts until the parameters settle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from sysid.data.record import Record, check_direct, check_records
from sysid.data.sensor import Sensor, check_sensor
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import free_parameters
from sysid.estimation.output_error import CHANNELS
from sysid.estimation.smoothed_start import parameter_starts
from sysid.physics import ops
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.parameters import Parameter

Index = NDArray[np.intp]

PRIOR_SD = 1.5
"""Prior sd of s about the model's own numbers; between two bounds 1.8 is close to uniform."""
START_SD = (1.0, 10.0)
"""Prior sd [rad], [rad/s] of a rollout's initial state."""
GENTLE = (10.0, 3.0)
"""Factors on the sensor's sd, one for each of the first sweeps."""
SWEEPS = 12
"""Sweeps from a start, at most."""
STARTS = 3
"""Starts, at most."""
ALPHA = 0.5
"""Spread of the sigma points."""
SETTLED = 0.1
"""Difference of the parameters, in units of their sd, below which two sweeps or two starts have come to one answer."""


@dataclass(frozen=True)
class UnscentedKalman:
    """A joint unscented Kalman filter of state and parameters.

        x = (theta, theta_dot, s),   p = g(s),   s_(k+1) = s_k,   y_k = (theta, theta_dot)_k + sd * noise

    g maps the real line into a parameter's bounds (`Coordinates`), so that every sigma point is a model within its
    bounds. In each rollout theta and theta_dot begin anew, with sds of 1 rad and 10 rad/s about the first readings
    (hanging at rest if there are none), while s goes on. Every reading that the sensor has a noise for counts.

    A single pass would judge the first rollouts with poor parameters. Several sweeps are therefore made, by expectation
    propagation (Minka, 2001; with the spread of posterior linearisation, Garcia-Fernandez et al., 2015). What a rollout
    says about s is a Gaussian factor: the filter's answer less its prior, in information form. The next sweep filters
    the rollout again, from a prior about all that is known by then, and replaces its factor. The answer is the product
    of the factors and the prior, so that no reading counts twice. The first sweeps take the readings to be ten and
    three times noisier, so that a poor start cannot lock the filter at wrong numbers. If it does, or if the filter does
    not settle, other starts are tried, until the readings are explained or two starts agree.

    Parameters
    ----------
    parameters : sequence of str, default ("m", "l")
        The names of the parameters to fit.
    sensor : Sensor, default Sensor(theta=0.01, theta_dot=1.0)
        Noise of the readings.

    Notes
    -----
    Drives of input effects are evaluated at the sigma points; their memories are carried over by regression on s.
    A filter judges each reading by the motion as it is known then, not by the smoothed one. Where only speeds are read,
    coarsely, its errors therefore stay above the bound that LeastSquares reaches, and its intervals are too narrow for
    what no reading shows (a rollout at rest).

    References
    ----------
    Wan & van der Merwe (2001), in filterpy's implementation.
    """

    parameters: Sequence[str] = ("m", "l")
    sensor: Sensor = Sensor(theta=0.01, theta_dot=1.0)

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """Fit the parameters to the records.

        Parameters
        ----------
        model : Model
            The model about whose own numbers the prior is; parameters that are not fitted keep their numbers.
        records : sequence of Record
            At least one rollout.

        Returns
        -------
        Estimate
            The answer of the best start; `success` is False where the filter did not settle.

        Raises
        ------
        InvalidInput
            For unusable records or names, and a model with an effect at the sensors or in the stamps of the torques.
        """
        free = free_parameters(model, self.parameters)
        check_direct(model, "UnscentedKalman")
        records = check_records(model, records)
        check_sensor(self.sensor)
        coordinates = Coordinates(free)
        passes = [_Pass(self, model, coordinates, r) for r in records]
        numbers = np.array([float(p.value) for p in free])
        prior = _Gaussian.of(coordinates.inverse(numbers), PRIOR_SD**2 * np.eye(len(free)))
        outcomes: list[_Outcome] = []
        for start in islice(parameter_starts(free), STARTS):
            here = self._sweep(passes, prior, coordinates.inverse(start))
            agreed = any(here.moved_from(other.known) < SETTLED for other in outcomes if other.settled)
            outcomes.append(here)
            if here.settled and (agreed or here.misfit < 1.0):
                break
        best = min(outcomes, key=lambda f: (not f.settled, f.misfit))
        return self._estimate(model, coordinates, best, len(outcomes))

    def _sweep(self, passes: Sequence[_Pass], prior: _Gaussian, start: Array) -> _Outcome:
        """Sweeps from s = start (P,) until the estimate has settled."""
        nothing = _Gaussian(0.0 * prior.precision, 0.0 * prior.shift)
        factors = [nothing] * len(passes)
        # the filter only begins at the start; the prior stays about the model's own numbers
        total, known = prior, _Gaussian(prior.precision, prior.precision @ start)
        for sweep in range(SWEEPS):
            noisier = GENTLE[sweep] if sweep < len(GENTLE) else 1.0
            before = known
            squares, count = np.zeros(2), np.zeros(2, dtype=int)
            for i, rollout in enumerate(passes):
                view = known if sweep == 0 else known.halved()
                after, own_squares, own_count = rollout(view, noisier)
                if not np.all(np.isfinite(after.precision)):
                    return _Outcome(known, squares, count, sweep, settled=False)
                replaced, factors[i] = factors[i], after - view
                total = total - replaced + factors[i]
                known = after if sweep == 0 else total
                squares, count = squares + own_squares, count + own_count
            known = total
            here = _Outcome(known, squares, count, sweep + 1, settled=False)
            if sweep > len(GENTLE) and here.moved_from(before) < SETTLED:
                return replace(here, settled=True)
        return here

    def _estimate(self, model: Model, coordinates: Coordinates, outcome: _Outcome, starts: int) -> Estimate:
        names = tuple(self.parameters)
        s, covariance = outcome.known.moments()
        slope = coordinates.slope(s)
        measured = [(c, getattr(self.sensor, c)) for c in CHANNELS]
        noise = {
            channel: sd * math.sqrt(outcome.squares[row] / outcome.count[row])
            for row, (channel, sd) in enumerate(measured)
            if sd is not None and outcome.count[row]
        }
        if not outcome.settled:
            status = f"did not settle in {outcome.sweeps} sweeps from any of {starts} starts: try LeastSquares"
        elif outcome.misfit < 1.0:
            status = f"settled in {outcome.sweeps} sweeps; the readings are explained to the sensor's noise"
        else:
            size = math.sqrt(np.sum(outcome.squares) / np.sum(outcome.count))
            status = f"settled, but the best of {starts} starts leaves {size:.2g} times the expected errors: "
            status += "the model lacks something, or the sensor's sd is too small"
        return Estimate(
            model=model.with_numbers(names, coordinates(s).tolist()),
            names=names,
            covariance=covariance * np.outer(slope, slope),
            noise=noise,
            success=outcome.settled,
            status=status,
            cost=math.nan,
            n_readings=int(np.sum(outcome.count)),
            method="unscented Kalman filter",
        )


@dataclass(frozen=True, eq=False)
class _Gaussian:
    """A Gaussian of s in information form: precision (P, P) and shift = precision @ mean (P,). Products become sums."""

    precision: Array
    shift: Array

    @classmethod
    def of(cls, mean: Array, covariance: Array) -> _Gaussian:
        precision = np.linalg.inv(covariance)
        precision = 0.5 * (precision + precision.T)
        return cls(precision, precision @ mean)

    def moments(self) -> tuple[Array, Array]:
        """Mean (P,) and covariance (P, P)."""
        covariance = np.linalg.inv(self.precision)
        covariance = 0.5 * (covariance + covariance.T)
        return covariance @ self.shift, covariance

    def halved(self) -> _Gaussian:
        """The same mean with twice the covariance."""
        return _Gaussian(0.5 * self.precision, 0.5 * self.shift)

    def __add__(self, other: _Gaussian) -> _Gaussian:
        return _Gaussian(self.precision + other.precision, self.shift + other.shift)

    def __sub__(self, other: _Gaussian) -> _Gaussian:
        return _Gaussian(self.precision - other.precision, self.shift - other.shift)


@dataclass(frozen=True, eq=False)
class _Outcome:
    """Where the sweeps from one start ended; squares and count (2,) are of the whitened innovations, by channel."""

    known: _Gaussian
    squares: Array
    count: Array
    sweeps: int
    settled: bool

    def moved_from(self, other: _Gaussian) -> float:
        """The largest difference of a parameter's mean to another answer's, in units of its sd here."""
        mean, covariance = self.known.moments()
        return float(np.max(np.abs(mean - other.moments()[0]) / np.sqrt(np.diag(covariance))))

    @property
    def misfit(self) -> float:
        """The sum of squares, divided by a bound that noise alone exceeds in one of 10,000 data sets."""
        n = max(1, int(np.sum(self.count)))
        return float(np.sum(self.squares)) / (n + 3.7 * math.sqrt(2.0 * n) + 9.0)


class _Pass:
    """One pass of the filter over a rollout."""

    def __init__(self, settings: UnscentedKalman, model: Model, coordinates: Coordinates, record: Record) -> None:
        from filterpy.kalman import MerweScaledSigmaPoints  # loads for half a second

        self.record, self.coordinates, self.begin = record, coordinates, float(record.time_since_start[0])
        names = tuple(settings.parameters)
        self.size = 2 + len(names)
        self.points = MerweScaledSigmaPoints(self.size, ALPHA, beta=2.0, kappa=0.0, sqrt_method=square_root)
        # the model reads its numbers from these rows: writing to them changes it without another check of bounds
        self.rows = np.repeat(coordinates(np.zeros(len(names)))[:, None], 2 * self.size + 1, axis=1)
        self.model = model.with_numbers(names, self.rows)
        self.values, self.sds = settings.sensor.readings(record)
        self.start = np.where(np.isfinite(self.sds[0]), self.values[0], [math.pi, 0.0])
        self.start_covariance = np.diag(np.square(START_SD))

    def __call__(self, prior: _Gaussian, noisier: float) -> tuple[_Gaussian, Array, Array]:
        """The posterior of s after this rollout; the sums (2,) of the squared whitened innovations, and their numbers.

        The precision is nan if a sigma point overflowed.
        """
        mean, covariance = prior.moments()
        kf = _filter()(self.size, 1, self.model.dt, lambda x, channel: x[channel], self._move, self.points)
        kf.Q = np.zeros((self.size, self.size))
        kf.x = np.concatenate([self.start, mean])
        kf.P = np.block([[self.start_covariance, np.zeros((2, len(mean)))], [np.zeros((len(mean), 2)), covariance]])
        kf.sigmas_f = self.points.sigma_points(kf.x, kf.P)
        self.memory, self.s = self.model.rest(np.zeros(2 * self.size + 1)), kf.sigmas_f[:, 2:]
        self.rows[:] = self.coordinates(self.s).T
        for u in self.record.previous_commands.tolist() if self.model.input_effects else ():
            _, self.memory = self.model.drive(u, self.memory)
        squares, count = np.zeros(2), np.zeros(2, dtype=int)
        with np.errstate(over="ignore", invalid="ignore"):
            for k, (value, sd) in enumerate(zip(self.values, self.sds, strict=True)):
                if k > 0:
                    kf.predict(UT=_transform, k=k - 1)
                channel = np.flatnonzero(np.isfinite(sd))
                if not np.all(np.isfinite(kf.sigmas_f)):
                    return _Gaussian(np.full_like(covariance, np.nan), mean), squares, count
                if len(channel):
                    kf.residual_z = partial(residual, channel)
                    kf.update(value[channel], np.diag(noisier**2 * sd[channel] ** 2), UT=_transform, channel=channel)
                    kf.P = 0.5 * (kf.P + kf.P.T)
                    np.add.at(squares, channel, kf.y**2 / np.diag(kf.S))
                    np.add.at(count, channel, 1)
        return _Gaussian.of(kf.x[2:], kf.P[2:, 2:]), squares, count

    def _move(self, sigmas: Array, dt: float, k: int) -> Array:
        """All sigma points (2 dim + 1, dim), moved by one control interval."""
        s = sigmas[:, 2:]
        self.rows[:] = self.coordinates(s).T
        memory = tuple(tuple(_carried(v, self.s, s) for v in values) for values in self.memory)
        drives, self.memory = self.model.drive(float(self.record.u[k]), memory)
        self.s = s
        after = sigmas.copy()
        after[:, 0], after[:, 1] = self.model.move(sigmas[:, 0], sigmas[:, 1], drives, self.begin + k * dt)
        return after


def _carried(memory: Array, before: Array, after: Array) -> Array:
    """A memory (K,), known at sigma points s = `before` (K, P), carried to the points `after` by regression on s."""
    if np.ptp(memory) == 0.0:
        return memory
    middle, spread = np.mean(before, axis=0), np.std(before, axis=0)
    slope = np.linalg.pinv((before - middle) / spread) @ (memory - np.mean(memory))
    return np.mean(memory) + ((after - middle) / spread) @ slope


@cache
def _filter() -> type:
    """filterpy's filter, changed to move all sigma points in one call of the model; a reading is a component of x."""
    from filterpy.kalman import UnscentedKalmanFilter

    class Filter(UnscentedKalmanFilter):  # type: ignore[misc]
        def compute_process_sigmas(self, dt: float, fx: Any = None, **arguments: Any) -> None:
            self.sigmas_f = self.fx(self.points_fn.sigma_points(self.x, self.P), dt, **arguments)

        def cross_variance(self, x: Array, z: Array, sigmas_f: Array, sigmas_h: Array) -> Array:
            return (sigmas_f - x).T @ (self.Wc[:, None] * (sigmas_h - z))

    return Filter


def _transform(sigmas: Array, Wm: Array, Wc: Array, noise: Array, mean: Any, residual: Any) -> tuple[Array, Array]:
    """filterpy's unscented transform, with one call of `residual` for all sigma points (2 dim + 1, dim)."""
    x = Wm @ sigmas
    away = residual(sigmas, x)
    return x, (away.T * Wc) @ away + noise


def residual(channel: Index, reading: Array, predicted: Array) -> Array:
    """Reading less prediction; for angles the shorter way round."""
    return np.where(channel == 0, ops.wrap(reading - predicted), reading - predicted)


def square_root(P: Array) -> NDArray[np.floating[Any]]:
    """U with U'U = P; eigenvalues that rounding has made negative are raised to a floor."""
    try:
        return np.linalg.cholesky(P).T
    except np.linalg.LinAlgError:
        if not np.all(np.isfinite(P)):
            return np.full_like(P, np.nan)
        scale = np.sqrt(np.maximum(np.diag(P), 1e-300))
        size, direction = np.linalg.eigh(P / np.outer(scale, scale))
        return (scale[:, None] * direction * np.sqrt(np.maximum(size, 1e-12))).T


class Coordinates:
    """p = g(s), one s on the real line for each parameter:

        low + (high - low) / (1 + exp(-s))     between two bounds
        low + c exp(s),  high - c exp(s)       beside one bound
        c s                                    without bounds

    with c the parameter's scale. Any s (..., P) gives parameters (..., P) within their bounds.
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
        return self._origin + self._factor * unit

    def inverse(self, p: Array) -> Array:
        """s (P,) of parameters (P,); a number at its bound counts as 3 % of the width (or scale) inside."""
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
        return self._factor * unit
