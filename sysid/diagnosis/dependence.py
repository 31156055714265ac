"""Dependence: the quantity on which a torque depends that no effect explains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sysid.estimation.prediction_error import Fit
from sysid.physics.ops import Array

QUANTITIES = ("theta", "theta_dot", "torque", "history", "theta+theta_dot")
"""The quantities that a torque may depend on, the simpler ones first."""
LEAST_PREDICTED = 0.2
"""Least share of the torque's mean square that a quantity has to predict on left-out stretches."""
LEAST_ADVANTAGE = 0.1
"""A later quantity has to predict a share that is larger by this than that of a simpler one."""
SHORTEST_STRETCH = 1.0
"""Least length [s] of the stretches that are left out in turn; a log is cut into 12 at most."""
LAGS = (-1, 1, 2, 4, 8, 16)
"""The intervals before this one whose commands a history consists of; -1 is the next."""
BINS = 24
"""Parts of the range of a quantity, of which those are named in which most of a torque acts."""


@dataclass(frozen=True, eq=False)
class Dependence:
    """What a torque depends on.

    depends_on  some of "theta", "theta_dot", "torque", "time", "history"
    share       of its mean square that a smooth function of these predicts on left-out stretches of the log
    where       the range of the quantity over which most of it acts, in words
    shares      this share for each of QUANTITIES that the log shows; 0 where it predicts nothing
    """

    depends_on: tuple[str, ...]
    share: float
    where: str
    shares: Mapping[str, float] = field(default_factory=dict)


def dependence(fit: Fit, torque: Array) -> Dependence:
    """Find the quantity that predicts a torque (M,) [N m], nan where it is not known; "time" if none does.

    By cross-validation, a smooth function of the quantity is fitted to all stretches of the log but one and predicts
    that one. A torque that acts only once is predicted by no quantity.
    """
    known = np.isfinite(torque)
    chosen, best = "time", 0.0
    if np.count_nonzero(known) < 30:
        return Dependence(("time",), 0.0, "")
    names = [name for name in QUANTITIES if _is_placed(fit) or "theta" not in name.split("+")]
    shares = {name: max(0.0, _predicted(fit, torque, known, _torques(fit, name))) for name in names}
    for name, share in shares.items():
        if share > max(LEAST_PREDICTED, best + LEAST_ADVANTAGE):
            chosen, best = name, share
    on = tuple(chosen.split("+"))
    return Dependence(on, best, _where(fit, on[0], np.where(known, torque, 0.0)), shares)


def _is_placed(fit: Fit) -> bool:
    """Whether the angle of the joint is known, from a reading of it or from gravity."""
    gravity = float(fit.model.plant.largest_gravity_torque)
    return gravity != 0.0 or any(r.has_angles for r in fit.samples.records)


def _predicted(fit: Fit, torque: Array, known: Array, basis: Array) -> float:
    """1 - sum |d - prediction|^2 / sum d^2, where ridge regression on all other stretches predicts each stretch."""
    if basis.shape[1] == 0:
        return 0.0
    samples, at = fit.samples, np.flatnonzero(known)
    count = int(np.clip(len(at) * samples.dt / SHORTEST_STRETCH, 2, 12))
    stretch = np.minimum(np.arange(len(at)) * count // len(at), count - 1)
    d, columns = torque[at], basis[at] - np.mean(basis[at], axis=0)
    columns = np.column_stack([columns, np.ones(len(at))])
    ridge = 1e-3 * np.sum(columns**2) / columns.shape[1] * np.eye(columns.shape[1])
    missed = 0.0
    for k in range(count):
        inside, other = stretch == k, stretch != k
        N = columns[other].T @ columns[other] + ridge
        missed += float(np.sum((d[inside] - columns[inside] @ np.linalg.solve(N, columns[other].T @ d[other])) ** 2))
    return 1.0 - missed / max(float(np.sum(d**2)), 1e-300)


def _middle(fit: Fit) -> tuple[Array, Array, Array]:
    """theta, theta_dot and the drive torque (M,) in the middle of the intervals."""
    theta, theta_dot = fit.linearised.middle.T
    return theta, theta_dot, fit.linearised.drive_torques.mean(axis=1)


def coordinates(fit: Fit) -> dict[str, Array]:
    """The quantities (M,) over which a torque is drawn: theta (its place), theta_dot, drive torque and time."""
    theta, theta_dot, drive = _middle(fit)
    middle = fit.samples.t + 0.5 * fit.samples.dt
    return {"theta": fit.model.plant.place(theta), "theta_dot": theta_dot, "torque": drive, "time": middle}


def _torques(fit: Fit, name: str) -> Array:
    """Basis functions (M, Q) of a quantity, whose combinations are the torques that may depend on it."""
    theta, theta_dot, drive = _middle(fit)
    if name == "theta_dot":
        return _splines(theta_dot, 8)
    if name == "torque":
        return _splines(drive, 6)
    if name == "history":
        return _history(fit)
    angles = _angles(theta, fit.model.plant.turns)
    if name == "theta":
        return angles
    moving = np.tanh(theta_dot / max(1e-6, 0.2 * float(np.std(theta_dot))))
    return np.concatenate([angles, angles * moving[:, None], angles * theta_dot[:, None]], axis=1)


def _splines(x: Array, count: int) -> Array:
    """Cubic B-splines (M, count) over the range of x, with knots at its quantiles; none if x hardly varies."""
    from scipy.interpolate import BSpline  # it takes a sixth of a second to load, and few answers need it

    low, high = float(np.min(x)), float(np.max(x))
    if high - low < 1e-9:
        return np.zeros((len(x), 0))
    edge = 1e-9 * (high - low)
    inner = np.quantile(x, np.linspace(0.0, 1.0, count - 2)[1:-1])
    inner = np.unique(np.clip(inner, low + edge, high - edge))  # quantiles may coincide where x rests
    knots = np.concatenate([[low - edge] * 4, inner, [high + edge] * 4])
    return BSpline.design_matrix(np.clip(x, low, high), knots, 3).toarray()


def _angles(theta: Array, turns: bool) -> Array:
    """Splines over the angle: periodic ones if whole turns were made, otherwise over the range that was seen."""
    span = float(np.ptp(theta))
    if span < 0.05:
        return np.zeros((len(theta), 0))
    count = int(np.clip(round(min(span, 2.0 * math.pi) / 0.15), 6, 40))
    if not turns or span < 2.0 * math.pi:
        return _splines(theta, count)
    width = 2.0 * math.pi / count
    apart = np.mod(theta[:, None] - width * np.arange(count) + math.pi, 2.0 * math.pi) - math.pi
    return np.maximum(0.0, 1.0 - np.abs(apart) / width)


def _history(fit: Fit) -> Array:
    """Commands of earlier intervals, which a missing state would remember; and of the next, for a log stamped late."""
    samples = fit.samples
    columns = np.zeros((len(samples), len(LAGS)))
    for i, record in enumerate(samples.records):
        at = len(record.previous_commands) + np.arange(len(record) + 1)[:, None] - np.array(LAGS)
        columns[samples.first[i] : samples.first[i + 1]] = record.commands[np.clip(at, 0, len(record.commands) - 1)]
    return columns if np.ptp(columns) > 1e-9 else columns[:, :0]


def _where(fit: Fit, on: str, torque: Array) -> str:
    """The range of a quantity over which most of a torque acts, in words."""
    units = fit.model.plant.quantities
    newton = units["torque"]
    if on == "history":
        return f"on what happened up to {max(LAGS)} samples before"
    if on == "time":
        k = int(np.argmax(np.abs(torque)))
        name = fit.samples.records[int(fit.samples.number[k])].name
        return f"strongest in {name} at {fit.samples.t[k]:.2f} s ({torque[k]:+.2g} {newton})"
    x = coordinates(fit)[on]
    edges = np.linspace(float(np.min(x)), float(np.max(x)), BINS + 1)
    place = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
    count = np.bincount(place, minlength=BINS)
    mean = np.bincount(place, torque, minlength=BINS) / np.maximum(count, 1)
    met = count >= max(5, x.size // (4 * BINS))  # where the joint hardly was, splines extrapolate
    if not np.any(met):
        return ""
    size = np.where(met, np.abs(mean - np.median(mean[met])), 0.0)
    peak = int(np.argmax(size))
    low, high = peak, peak
    while low > 0 and size[low - 1] > 0.5 * size[peak]:
        low -= 1
    while high < BINS - 1 and size[high + 1] > 0.5 * size[peak]:
        high += 1
    digits = max(2, 1 - math.floor(math.log10(max(edges[1] - edges[0], 1e-9))))
    stretch = f"from {edges[low]:.{digits}f} to {edges[high + 1]:.{digits}f} {units[on]}"
    return f"strongest for {on} {stretch} ({mean[peak]:+.2g} {newton})"
