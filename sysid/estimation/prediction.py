"""Prediction: how far off a model is over a horizon, by cross-validation on stretches that are left out in turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.estimation.held_out import HEAD, Refit, lead_of, refit_windows
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.windows import Window, cut
from sysid.physics.model import Model
from sysid.physics.ops import Array

HORIZON = 1.0
"""Horizon [s] of a prediction."""
BLOCKS = 8
"""Number of stretches of a log that are left out in turn."""
SHORTEST_PREDICTION = 0.3
"""Horizon [s] below which a prediction says little more than the sensor."""
PERIODS = 5
"""Fewest periods of a free swing over which it is predicted, if the record shows so many."""
MOST_PERIODS = 20
"""Most periods of a free swing over which it is predicted."""
SURE_GAIN = 2.0
"""Standard errors from zero at which the mean gain over the windows is sure."""
RUNS_AWAY = 1e3
"""A model runs away in a window if its squared error there is so many times that of the other model."""
GROWTH = 5.0
"""Logarithm of the factor by which an error may grow before a prediction says nothing of the model."""


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Summed squared errors of K windows: `squares` (K,), in units of the sensor's variance, and their expectation for
    noise alone, `free` (K,)."""

    squares: Array
    free: Array

    @property
    def ratio(self) -> float:
        """RMS error, in units of the sensor noise."""
        return math.sqrt(float(np.sum(self.squares)) / max(float(np.sum(self.free)), 1e-9))

    def gain(self, other: PredictionErrors) -> tuple[float, float]:
        """The mean of log(other's square / own) over the windows, and its standard error; positive if these are better.

        The logarithm keeps one window from outweighing all others; the noise's share is added to both squares. If the
        sum of squares is larger than the other's, the mean is made negative. The worst window is left out of the sums
        if the mean is surely positive and the model does not run away there.
        """
        noise = np.maximum(self.free, 1.0)
        apart = np.log((other.squares + noise) / (self.squares + noise))
        mean = float(np.mean(apart))
        sd = float(np.std(apart, ddof=1)) / math.sqrt(len(apart)) if len(apart) > 1 else math.inf
        worst = int(np.argmax(self.squares - other.squares))
        spared = mean > SURE_GAIN * sd and self.squares[worst] < RUNS_AWAY * (other.squares[worst] + noise[worst])
        these, others = (float(np.sum(np.delete(e.squares, worst) if spared else e.squares)) for e in (self, other))
        if these > others:
            mean = min(mean, -abs(math.log(these / max(others, 1e-300))))
        return mean, sd


def telling_horizon(records: Sequence[Record]) -> float:
    """How far ahead [s] predictions should look: a second, or for a free swing until its amplitude has halved, 5 to 20
    periods. A shorter prediction of a swing shows its period, but not its losses."""
    longest = max(records, key=len)
    read = longest.theta if longest.theta is not None and longest.has_angles else longest.theta_dot
    if read is None or any(r.driven for r in records):
        return HORIZON
    motion = read - np.mean(read)
    periods = int(np.argmax(np.abs(np.fft.rfft(motion))))
    seconds = len(longest) * longest.dt
    if periods < PERIODS:
        return HORIZON
    period, sizes = seconds / periods, [np.std(part) for part in np.array_split(motion, periods // 2)]
    rate = -np.polyfit(np.arange(len(sizes)), np.log(np.maximum(sizes, 1e-300)), 1)[0] * len(sizes) / seconds
    halved = math.log(2.0) / max(rate, 1e-9)
    return max(HORIZON, float(f"{np.clip(halved, PERIODS * period, MOST_PERIODS * period):.2g}"))


def foreseeable(model: Model, records: Sequence[Record]) -> float:
    """How far ahead [s] a model can predict a motion near an unstable rest, such as a pendulum balanced upright: errors
    grow by exp(GROWTH) in that time. It is inf unless most of the records are such a motion.

        GROWTH / sqrt(max(median d theta_ddot / d theta, 0))
    """
    theta = np.concatenate([np.zeros(0), *(r.theta for r in records if r.theta is not None and r.has_angles)])
    if len(theta) == 0:
        return math.inf
    held = theta if model.at_angle else np.zeros_like(theta)
    before, after = (np.asarray(model.acceleration(theta + h, 0.0, 0.0, held)) for h in (-1e-4, 1e-4))
    growth = math.sqrt(max(float(np.median(after - before)) / 2e-4, 0.0))
    return float(f"{GROWTH / growth:.2g}") if growth > 0.0 else math.inf


def windows_of(fit: Fit, seconds: float, lead: float = 0.0) -> tuple[Window, ...]:
    """The windows over which predictions are judged, each after the lead that memories need, or at least `lead` [s]."""
    return cut(fit.samples.records, seconds, max(lead, lead_of(fit.model)))


def left_out_errors(
    fit: Fit, seconds: float, blocks: int, lead: float = 0.0, least_share: float = 0.0
) -> PredictionErrors:
    """Cross-validated errors: each block of windows is predicted with parameters from the other blocks alone.

    p_(-b) = p - (N - N_b)^-1 g_b,    N = Z'Z,  g = Z'e;  N_b and g_b are the parts of block b

    This is one Gauss-Newton step away from block b, in which no number that may not be 0 falls below a `least_share` of
    itself: an inertia that hardly shows would be none. The windows of a short log are shorter than `seconds`, since a
    few would prove nothing. Two models are compared over the same windows, with the longer `lead` [s] of both
    (`lead_of`).
    """
    total = sum(len(r) for r in fit.samples.records) * fit.samples.dt
    windows = windows_of(fit, float(np.clip(total / blocks, SHORTEST_PREDICTION, seconds)), lead)
    groups = np.array_split(np.arange(len(windows)), min(blocks, len(windows)))
    # where memories have to fill first, windows need the states of the whole log
    heads = cut(fit.samples.records, HEAD) if any(w.lead for w in windows) else None
    near = refit_windows(fit.model, fit.samples, heads) if heads else None
    models = [_without(fit, [windows[i] for i in group], least_share) for group in groups]
    of_windows = [model for model, group in zip(models, groups, strict=True) for _ in group]
    return PredictionErrors(*_squares(refit_windows(of_windows, fit.samples, windows, near)))


def fitted_error(fit: Fit, seconds: float, sensor: Sensor) -> float:
    """The RMS error of predictions of the samples that were fitted, in units of the sensor noise."""
    samples = Samples(fit.model, fit.samples.records, sensor)
    refitted = refit_windows(fit.model, samples, windows_of(fit, seconds))
    return PredictionErrors(*_squares(refitted)).ratio


def widened_sensor(fit: Fit, seconds: float) -> Sensor:
    """The sensor, with the angle's noise widened by the error that its neighbouring readings share, if a free swing
    needs that error, a small one, and no random torque: what is left is the sensor's then, of a film, say. (An error of
    the speed may well be a torque, and in a driven motion what the drive lacks.)

        sd^2 = noise^2 + tr((1 - P) C) / tr(1 - P),   C the covariance of the error

    P projects on what the refitted states of windows of that many seconds absorb: nearly all of a slow error. The
    expected error of predictions is 1 in units of the widened noise.
    """
    samples, likely = fit.samples, fit.likeliest_torque
    noise = samples.sensor.theta
    of_angles = likely.in_readings and not samples.error_channel
    if samples.driven or noise is None or likely.s or not of_angles or not fit.errs_by_little:
        return samples.sensor
    from scipy.signal import fftconvolve

    refitted = refit_windows(fit.model, samples, windows_of(fit, seconds))
    weight = refitted.response.weight[:, 0]
    absorbed = refitted.basis.reshape(len(weight), 2, -1, 2)[:, 0] * weight[..., None]
    lags = samples.dt * np.arange(float(absorbed.shape[1]))
    variance = likely.shared_variance(lags)
    spread = fftconvolve(absorbed, variance[None, :, None], axes=1)[:, : len(lags)]
    whole, alone = float(np.sum(weight**2)), float(np.sum(absorbed**2))
    left = variance[0] * (whole + alone) - 2.0 * float(np.sum(absorbed * spread))
    return replace(samples.sensor, theta=math.sqrt(noise**2 + max(left / (whole - alone), 0.0)))


def moved(before: Model, after: Model, fit: Fit, seconds: float) -> tuple[float, float]:
    """The RMS difference of two models' predictions, and the RMS error of the second, in units of the sensor noise."""
    windows = cut(fit.samples.records, seconds, max(lead_of(before), lead_of(after)))
    a = refit_windows(before, fit.samples, windows)
    b = refit_windows(after, fit.samples, windows, a)
    scored = a.scored > 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        apart = np.where(scored, a.lin.e - b.lin.e, 0.0)
    size = math.sqrt(float(np.sum(apart**2)) / max(int(scored.sum()), 1))
    return size, PredictionErrors(*_squares(b)).ratio


def _squares(refitted: Refit) -> tuple[Array, Array]:
    K = len(refitted.starts)
    with np.errstate(over="ignore"):
        squares = np.sum(np.minimum(refitted.lin.e**2, 1e12), axis=1)
    return squares, np.sum(refitted.scored - refitted.leverage, axis=1).reshape(K)


def _without(fit: Fit, windows: list[Window], least_share: float = 0.0) -> Model:
    """The model with the parameters that fit all but these windows (see `left_out_errors`)."""
    samples, p = fit.samples, fit.values
    if not len(p):
        return fit.model
    left_out = np.zeros(len(samples), dtype=bool)
    for w in windows:
        begin = int(samples.first[w.record]) + w.begin
        left_out[begin + w.overlap : begin + w.count + 1] = True
    rows = np.repeat(left_out, 2)
    low, high = np.array([fit.model.parameters[n].bounds for n in fit.names]).T
    free = (p > low) & (p < high)
    Z, e = fit.Z[:, free], fit.e
    size = np.linalg.norm(Z, axis=0)
    free[free] = size > 0.0
    Z = Z[:, size > 0.0] / size[size > 0.0]
    B, balance = fit.balance_rows
    B = B[:, free] / size[size > 0.0]
    rest = np.concatenate([Z[~rows], B])
    step = np.zeros(len(p))
    N = rest.T @ rest + 1e-6 * np.eye(Z.shape[1])
    step[free] = np.linalg.solve(N, rest.T @ np.concatenate([e[~rows], balance])) / size[size > 0.0]
    least = np.where(fit.prior.positive, np.maximum(low, least_share * p), low)
    return fit.model.with_numbers(fit.names, np.clip(p + step, least, high).tolist())
