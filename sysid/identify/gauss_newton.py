"""Gauss-Newton on windows of a log: hundredths of a second an iteration, at the horizon that a model can follow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.estimate import Estimate
from sysid.identify.identifier import free_parameters
from sysid.identify.start import parameter_starts
from sysid.model import Model
from sysid.parameters import Parameter
from sysid.records import Array, Record
from sysid.response import CHANNELS, Linearisation, Response, stretches
from sysid.sensor import Sensor
from sysid.windows import cut

HORIZONS = (0.5, 1.0, 2.0, 4.0, math.inf)
"""Lengths of windows [s] that a fit goes through; inf is a whole rollout."""

ENOUGH = 8000
"""Samples from which the start of a fit can be told."""

LARGEST_GROWTH = 1e5
"""Of an initial error within a window; beyond it float64 cannot tell the parameters from the start."""

NEGLIGIBLE = 1e-2
"""A decrease of the cost (half the sum of squares, in units of the noise) that no statistic would notice."""

COLOURED = 1.8
"""Inflation of the scores' variance from which residuals count as coloured."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """A linearisation with every window's start eliminated: what of e and S_p lies beside the columns of S_x.

    e (K, R), S (K, R, P), directions (K, R, 2) an orthonormal basis of the columns of S_x, inverse (K, 2, 2)
    """

    e: Array
    S: Array
    directions: Array
    triangle: Array

    @property
    def information(self) -> Array:
        """S'S (P, P)."""
        S = self.S.reshape(self.e.size, self.S.shape[-1])
        information: Array = S.T @ S
        return information

    @property
    def gradient(self) -> Array:
        """S'e (P,)."""
        gradient: Array = self.S.reshape(self.e.size, self.S.shape[-1]).T @ self.e.ravel()
        return gradient


def without(directions: Array, columns: Array) -> Array:
    """Columns (K, R, Q) less their part along the orthonormal directions (K, R, 2)."""
    for _ in range(2):  # once more takes out what rounding left
        columns = columns - directions @ (np.swapaxes(directions, -1, -2) @ columns)
    return columns


def reduce(lin: Linearisation) -> Reduced:
    """Eliminate the windows' starts (Schur complement by QR, so that small informations survive)."""
    # a tiny prior keeps R regular where a window does not see its start (speeds alone)
    directions, triangle = np.linalg.qr(lin.S_x)
    both = without(directions, np.concatenate([lin.e[..., None], lin.S_p], axis=-1))
    return Reduced(both[..., 0], both[..., 1:], directions, triangle)


@dataclass(frozen=True, eq=False)
class Solution:
    """Where Gauss-Newton stopped: p (P,), window starts (K, 2), the linearisation there, whether it converged."""

    p: Array
    starts: Array
    lin: Linearisation
    converged: bool


def solve(
    response: Response, parameters: Sequence[Parameter], p: Array, starts: Array, iterations: int = 25
) -> Solution:
    """min 1/2 |e(p, starts)|^2 within the bounds of p: Levenberg-Marquardt with the starts eliminated."""
    low, high = (np.array([q.bounds[side] for q in parameters]) for side in (0, 1))
    scale = np.array([max(q.scale, 1e-3) for q in parameters])
    lin, damping, converged = response.linearise(p, starts), 1e-6, False
    for _ in range(iterations):
        reduced, taken = reduce(lin), None
        for attempt in range(8):
            share = 0.5**attempt
            dp = _step(reduced, p, low, high, scale, damping)
            dx = start_step(lin, reduced, dp)
            if attempt == 0:
                promised = lin.cost - 0.5 * float(np.sum((lin.e - _moved(lin, dx, dp)) ** 2))
            with np.errstate(over="ignore", invalid="ignore"):  # where the motion runs away, no step is taken
                motion = response.motion(np.clip(p + share * dp, low, high), starts + share * dx)
                cost = 0.5 * float(np.sum(motion.e**2))
            if math.isfinite(cost) and cost <= lin.cost:
                taken = cost
                break
            damping = max(damping, 1e-6) * 10.0
        if taken is None:
            converged = promised < NEGLIGIBLE * max(1.0, 2.0 * lin.cost / lin.e.size)
            break
        gain, enough = lin.cost - taken, NEGLIGIBLE * max(1.0, 2.0 * taken / lin.e.size)
        p, starts = np.clip(p + share * dp, low, high), starts + share * dx
        lin = response.linearise(p, starts, motion)
        damping = max(damping * 0.1, 1e-9)
        if gain < enough and attempt < 3:
            converged = True
            break
    return Solution(p, starts, lin, converged)


def _step(reduced: Reduced, p: Array, low: Array, high: Array, scale: Array, damping: float) -> Array:
    """The damped step of p, kept within its bounds: what would leave is put on the bound, the others solved again."""
    F, g = reduced.information, reduced.gradient
    weight = np.maximum(np.diag(F), 1e-12 * np.max(np.diag(F) * scale**2, initial=1e-300) / scale**2)
    F = F + np.diag(damping * weight + 1e-12 * weight)
    dp, free = np.zeros(len(p)), np.ones(len(p), dtype=bool)
    for _ in range(len(p) + 1):
        if not np.any(free):
            break
        dp[free] = np.linalg.lstsq(F[np.ix_(free, free)], g[free] - F[np.ix_(free, ~free)] @ dp[~free], rcond=1e-14)[0]
        out = free & ((p + dp < low - 1e-12) | (p + dp > high + 1e-12))
        if not np.any(out):
            break
        dp[out] = np.clip(p + dp, low, high)[out] - p[out]
        free &= ~out
    limit = 0.7 * np.maximum(np.abs(p), scale)
    return np.clip(dp, -limit, limit)


def start_step(lin: Linearisation, reduced: Reduced, dp: Array) -> Array:
    """The step of the starts (K, 2) that goes with dp; at most half a radian and three times that a second."""
    right = np.swapaxes(reduced.directions, -1, -2) @ (lin.e - lin.S_p @ dp)[..., None]
    R = reduced.triangle
    size = np.abs(np.stack([R[:, 0, 0], R[:, 1, 1]], axis=-1))
    known = size > 1e-9
    R = R + np.where(known, 0.0, 1.0)[..., None] * np.eye(2)
    dx = np.where(known, np.linalg.solve(R, right)[..., 0], 0.0)
    return np.clip(dx, [-0.5, -3.0], [0.5, 3.0])


def _moved(lin: Linearisation, dx: Array, dp: Array) -> Array:
    return np.asarray((lin.S_x @ dx[..., None])[..., 0] + lin.S_p @ dp)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model with all that a test about it needs: the response, its linearisation, the windows' length [s]."""

    response: Response
    solution: Solution
    horizon: float
    model: Model

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return self.response.names

    @property
    def degrees(self) -> int:
        """Readings less fitted numbers, of which every window's start has two."""
        fitted = len(self.names) + 2 * len(self.response.windows)
        return max(1, int(self.response.n_readings.sum()) - fitted)

    @property
    def variance(self) -> float:
        """Residual variance in units of the sensor's: about 1 for a model that lacks nothing."""
        return 2.0 * self.solution.lin.cost / self.degrees

    @property
    def growing(self) -> bool:
        """Whether an initial error outgrows what float64 can cancel."""
        return self.solution.lin.growth > LARGEST_GROWTH

    @property
    def follows(self) -> bool:
        """Whether the model stays so near to the readings that a linearisation about it means something.

        In every channel its error is at most 1.2 times the noise, or else 15 % of the readings' spread, and 0.3 rad.
        """
        if self.growing:
            return False
        response = self.response
        e = self.solution.lin.e.reshape(len(response.windows), 2, -1)
        for row in range(2):
            seen = response.weight[:, row] > 0.0
            if not np.any(seen):
                continue
            error = np.abs(e[:, row][seen] / response.weight[:, row][seen])
            noise = 1.0 / float(np.median(response.weight[:, row][seen]))
            excess = math.sqrt(max(0.0, float(np.mean(error**2)) - noise**2))
            small = float(np.mean(error**2)) < (1.2 * noise) ** 2
            if not small and excess > 0.15 * float(np.std(response.y[:, row][seen])):
                return False
            if row == 0 and float(np.quantile(error, 0.98)) > 0.3 + 3.0 * noise:
                return False
        return True

    @property
    def parameters(self) -> list[Parameter]:
        """The free parameters at their fitted numbers."""
        return free_parameters(self.model, self.names)

    @cached_property
    def reduced(self) -> Reduced:
        """The linearisation with the windows' starts eliminated."""
        return reduce(self.solution.lin)

    @cached_property
    def inflation(self) -> float:
        """How much more the scores vary than those of white residuals would: about 1 for a model that lacks nothing."""
        scores = (self.reduced.S * self.reduced.e[..., None]).reshape(self.reduced.e.size, len(self.names))
        scores = scores / np.maximum(np.sqrt(np.diag(self.reduced.information)), 1e-300)
        sums = stretches(scores, self.response.clusters())
        G = len(sums)
        return float(np.sum(sums**2)) * G / max(1, G - 1) / (len(self.names) * self.variance)

    @cached_property
    def covariance(self) -> Array:
        """Of the parameters (P, P): s^2 F^-1, or where residuals are coloured F^-1 (sum_g s_g s_g') F^-1 by stretches.

        Infinite for the parameters of a direction that is not determined.
        """
        F = self.reduced.information
        size = np.sqrt(np.maximum(np.diag(F), 1e-300))
        value, vector = np.linalg.eigh(F / np.outer(size, size))
        known = value > 1e-11
        inverse = (vector[:, known] / value[known]) @ vector[:, known].T
        if self.inflation > COLOURED:
            scores = (self.reduced.S * self.reduced.e[..., None]).reshape(self.reduced.e.size, len(self.names)) / size
            sums = stretches(scores, self.response.clusters())
            inverse = inverse @ (sums.T @ sums * (len(sums) / max(1, len(sums) - 1))) @ inverse
        else:
            inverse = inverse * self.variance
        covariance: Array = 0.5 * (inverse + inverse.T) / np.outer(size, size)
        lost = np.any(np.abs(vector[:, ~known]) > 0.01, axis=1)
        covariance[lost], covariance[:, lost] = 0.0, 0.0
        covariance[lost, lost] = np.inf
        return covariance

    def residual_sd(self) -> dict[str, float]:
        """Sd of the readings about the fit, by channel [rad], [rad/s]."""
        e = self.solution.lin.e.reshape(len(self.response.windows), 2, -1)
        share = self.degrees / max(1, int(self.response.n_readings.sum()))
        found = {}
        for row, channel in enumerate(CHANNELS):
            sd = getattr(self.response.sensor, channel)
            if sd is not None:
                found[channel] = sd * math.sqrt(float(np.sum(e[:, row] ** 2)) / self.response.n_readings[row] / share)
        return found

    def estimate(self) -> Estimate:
        """The answer, with what it is worth."""
        lost = [n for n, v in zip(self.names, np.diag(self.covariance), strict=True) if not math.isfinite(v)]
        ratio = math.sqrt(self.variance)
        whole = math.isinf(self.horizon)
        about = "whole rollouts" if whole else f"windows of {self.horizon:g} s"
        if not self.solution.converged:
            status = f"stopped before it converged, on {about}: try other starting numbers"
        elif ratio < 0.5 or (ratio < 1.2 and self.inflation < COLOURED):
            status = f"converged on {about}; the readings are explained to the sensor's noise"
        else:
            status = (
                f"converged on {about}, but leaves {ratio:.3g} times the sensor's noise: the model lacks something, "
                "and its numbers are those that imitate it best (pseudo-true)"
            )
        if lost:
            status += f"; the records do not determine {', '.join(lost)}"
        return Estimate(
            model=self.model,
            names=self.names,
            covariance=self.covariance,
            noise=self.residual_sd(),
            success=self.solution.converged and not lost,
            status=status,
            cost=2.0 * self.solution.lin.cost,
            n_readings=int(self.response.n_readings.sum()),
            method="Gauss-Newton",
            sensor=self.response.sensor,
            horizon=self.horizon,
        )

    def state(self, record: int, instant: int) -> Array | None:
        """The fitted state (2,) at an instant of a record, where some window covers it.

        Of two windows that do the later one: it begins there, where the earlier one has drifted to.
        """
        for w, states in reversed(list(zip(self.response.windows, self.solution.lin.states, strict=True))):
            if w.record == record and w.begin <= instant <= w.begin + w.count:
                found: Array = states[instant - w.begin]
                return found
        return None


def fit_windows(
    model: Model,
    names: Sequence[str],
    records: Sequence[Record],
    sensor: Sensor,
    horizon: float,
    p: Array | Sequence[Array] | None = None,
    near: Fit | None = None,
    lead: float = 0.0,
) -> Fit:
    """A fit at one horizon [s], begun at parameters p and at the states of a fit `near` (else at smoothed ones).

    Of several p it begins at the one with the smallest residuals.
    """
    parameters = free_parameters(model, names)
    early = lead if math.isfinite(horizon) else 0.0
    response = Response(model, names, records, sensor, cut(records, horizon, early, skip=int(lead > 0.0)))
    starts = response.starts if near is None else _near(response, near)
    if p is None:
        p = next(parameter_starts(parameters))
    tried = np.atleast_2d(np.asarray(p, dtype=float))
    if len(tried) > 1:
        costs = [float(np.sum(response.residual(one, starts) ** 2)) for one in tried]
        tried = tried[[int(np.nanargmin(costs))]]
    solution = solve(response, parameters, tried[0], starts)
    fitted = model.with_parameters(dict(zip(names, solution.p.tolist(), strict=True)))
    return Fit(response, solution, horizon, fitted)


def _near(response: Response, near: Fit) -> Array:
    found = [near.state(w.record, w.begin) for w in response.windows]
    if any(state is None for state in found):
        smooth = response.starts
        return np.array([s if f is None else f for f, s in zip(found, smooth, strict=True)])
    return np.array(found)


def _part(records: Sequence[Record]) -> tuple[Record, ...]:
    """The first records, about ENOUGH samples of them."""
    part, left = list[Record](), ENOUGH
    for record in records:
        part.append(record.head(left))
        left -= len(record)
        if left <= 0:
            break
    return tuple(part)


def fit_longest(
    model: Model,
    names: Sequence[str],
    records: Sequence[Record],
    sensor: Sensor,
    p: Array | Sequence[Array] | None = None,
    near: Fit | None = None,
    shortest: float = HORIZONS[0],
    lead: float = 0.0,
) -> Fit:
    """The fit at the longest horizon at which the model follows the log, through all shorter ones from `shortest`.

    A long log is begun with a part of it, which tells the numbers and the horizon well enough to start from.
    """
    if p is None and near is None and sum(map(len, records)) > 2.5 * ENOUGH:
        part = fit_longest(model, names, _part(records), sensor, None, None, shortest, lead)
        p, shortest = part.solution.p, part.horizon
    whole = max(len(r) * r.dt for r in records)
    fit = None
    for horizon in (*(h for h in HORIZONS if shortest <= h < 0.75 * whole), math.inf):
        longer = fit_windows(model, names, records, sensor, horizon, p, fit or near, lead)
        if fit is not None and not longer.follows:
            break
        # a fit among the kinks of dry friction may stop a little early: what it explains counts
        if fit is not None and not longer.solution.converged and longer.variance > 1.05 * fit.variance:
            break
        fit, p = longer, longer.solution.p
    assert fit is not None
    return fit
