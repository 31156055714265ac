"""Prediction: how far off a model is over a horizon, on stretches that did not choose its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data.record import Record
from sysid.estimation.held_out import HEAD, Refit, lead_of, refit_windows
from sysid.estimation.prediction_error import Fit
from sysid.estimation.windows import Window, cut
from sysid.physics.model import Model
from sysid.physics.ops import Array

WINDOW, BLOCKS = 1.0, 8
"""Horizon [s] of a prediction, and how many stretches of a log are left out in turn."""
SHORTEST = 0.3
"""Horizon [s] below which a prediction says little more than the sensor."""

PERIODS = 5
"""Periods of a free swing over which predictions are judged, and that a record shows at least."""

SURELY = 2.0
"""Standard errors from which windows in the mean are predicted better for sure."""

RUNS_AWAY = 1e3
"""Multiple of another model's squared error in a window from which a model has lost its way there."""

GROWTH = 5.0
"""Logarithm of the factor by which an error may grow until a prediction says nothing of the model."""


@dataclass(frozen=True, eq=False)
class PredictionErrors:
    """Squared errors (K,) of K windows, in units of the sensor's variance, and what they had to be for noise alone."""

    squares: Array
    free: Array

    @property
    def ratio(self) -> float:
        """RMS error, in units of the sensor noise."""
        return math.sqrt(float(np.sum(self.squares)) / max(float(np.sum(self.free)), 1e-9))

    def gain(self, other: PredictionErrors) -> tuple[float, float]:
        """Mean of log(other's square / own) over the windows, and its standard error: no window outweighs all others.

        What the noise alone would make of a window is added to both. Negative, too, where the sum of squares is larger:
        but for the worst window, where the mean is surely positive and the model does not run away there.
        """
        noise = np.maximum(self.free, 1.0)
        apart = np.log((other.squares + noise) / (self.squares + noise))
        mean = float(np.mean(apart))
        sd = float(np.std(apart, ddof=1)) / math.sqrt(len(apart)) if len(apart) > 1 else math.inf
        worst = int(np.argmax(self.squares - other.squares))
        spared = mean > SURELY * sd and self.squares[worst] < RUNS_AWAY * (other.squares[worst] + noise[worst])
        own, others = (float(np.sum(np.delete(e.squares, worst) if spared else e.squares)) for e in (self, other))
        if own > others:
            mean = min(mean, -abs(math.log(own / max(others, 1e-300))))
        return mean, sd


def telling_horizon(records: Sequence[Record]) -> float:
    """How far ahead [s] predictions tell of a machine: a second, and five periods of what swings freely, over which its
    losses add up; a shorter way tells of its period alone."""
    longest = max(records, key=len)
    read = longest.theta if longest.theta is not None and longest.has_angles else longest.theta_dot
    if read is None or any(np.any(r.u) for r in records):
        return WINDOW
    known = np.flatnonzero(np.isfinite(read))
    motion = np.interp(np.arange(len(read)), known, read[known]) if len(known) else np.zeros(len(read))
    periods = int(np.argmax(np.abs(np.fft.rfft(motion - np.mean(motion)))))
    seconds = len(longest) * longest.dt
    return max(WINDOW, float(f"{PERIODS * seconds / periods:.2g}")) if periods >= PERIODS else WINDOW


def foreseeable(model: Model, records: Sequence[Record]) -> float:
    """How far ahead [s] a model can predict where it spends most of the records beside an unstable rest, as a pendulum
    does that is balanced upright; inf where it does not.

        GROWTH / median sqrt(max(d theta_ddot / d theta, 0))
    """
    theta = np.concatenate([np.zeros(0), *(r.theta for r in records if r.theta is not None and r.has_angles)])
    if not np.any(np.isfinite(theta)):
        return math.inf
    held = theta if model.actuator is not None and model.actuator.at_angle else np.zeros_like(theta)
    before, after = (np.asarray(model.acceleration(theta + h, 0.0, 0.0, held)) for h in (-1e-4, 1e-4))
    growth = math.sqrt(max(float(np.nanmedian(after - before)) / 2e-4, 0.0))
    return float(f"{GROWTH / growth:.2g}") if growth > 0.0 else math.inf


def windows_of(fit: Fit, seconds: float, lead: float = 0.0) -> tuple[Window, ...]:
    """The windows over which predictions are judged, with what memories need before them, and at least a `lead` [s]."""
    return cut(fit.samples.records, seconds, max(lead, lead_of(fit.model)))


def left_out_errors(fit: Fit, seconds: float, blocks: int, lead: float = 0.0) -> PredictionErrors:
    """The errors of each window, by parameters that a Gauss-Newton step takes back from the block it lies in.

    p_(-b) = p - (N - N_b)^-1 g_b,    N = Z'Z,  g = Z'e,  of block b

    Of a short log the windows are shorter than `seconds`: a few of them would prove nothing. Errors of two models are
    compared over the same windows: with the longer `lead` [s] of both (`lead_of`).
    """
    total = sum(len(r) for r in fit.samples.records) * fit.samples.dt
    windows = windows_of(fit, float(np.clip(total / blocks, SHORTEST, seconds)), lead)
    groups = np.array_split(np.arange(len(windows)), min(blocks, len(windows)))
    records, sensor = fit.samples.records, fit.samples.sensor
    # where memories have to fill first, every block would ask for the states of the whole log
    near = refit_windows(fit.model, records, sensor, cut(records, HEAD)) if any(w.lead for w in windows) else None
    found = []
    for group in groups:
        own = [windows[i] for i in group]
        found.append(_squares(refit_windows(_without(fit, own), records, sensor, own, near)))
    return PredictionErrors(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def fitted_error(fit: Fit, seconds: float) -> float:
    """RMS error of predictions of what was fitted to, in units of the sensor noise."""
    samples = fit.samples
    refitted = refit_windows(fit.model, samples.records, samples.sensor, windows_of(fit, seconds))
    return PredictionErrors(*_squares(refitted)).ratio


def moved(before: Model, after: Model, fit: Fit, seconds: float) -> tuple[float, float]:
    """RMS difference of two models' predictions, and the RMS error of the second, in units of the sensor noise."""
    records, sensor = fit.samples.records, fit.samples.sensor
    windows = cut(records, seconds, max(lead_of(before), lead_of(after)))
    a = refit_windows(before, records, sensor, windows)
    b = refit_windows(after, records, sensor, windows, a)
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


def _without(fit: Fit, windows: list[Window]) -> Model:
    """The model with the parameters that the other blocks ask for."""
    samples, p = fit.samples, fit.values
    if not len(p):
        return fit.model
    own = np.zeros(len(samples), dtype=bool)
    for w in windows:
        begin = int(samples.first[w.record]) + w.begin
        own[begin + w.shared : begin + w.count + 1] = True
    rows = np.repeat(own, 2)
    low, high = np.array([fit.model.parameters[n].bounds for n in fit.names]).T
    free = (p > low) & (p < high)
    Z, e = fit.Z[:, free], fit.e
    size = np.linalg.norm(Z, axis=0)
    free[free] = size > 0.0
    Z = Z[:, size > 0.0] / size[size > 0.0]
    rest = Z[~rows]
    step = np.zeros(len(p))
    N = rest.T @ rest + 1e-6 * np.eye(Z.shape[1])
    step[free] = np.linalg.solve(N, rest.T @ e[~rows]) / size[size > 0.0]
    numbers = np.clip(p + step, low, high).tolist()
    return fit.model.with_parameters(dict(zip(fit.names, numbers, strict=True)))
