"""Dependence: what a torque that no effect explains depends on, by torques of no particular physics."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.stats import chi2

from sysid.estimation.prediction_error import Fit
from sysid.records import Array

QUANTITIES = ("theta", "theta_dot", "theta+theta_dot", "torque", "time", "history")


@dataclass(frozen=True, eq=False)
class Dependence:
    """How much of the innovations smooth torques of one quantity explain.

    depends_on  some of "theta", "theta_dot", "torque", "time", "history"
    lm          decrease of the deviance that they promise; gain: the same, less the log of the sample size a function
    p_value     that nothing of it is there
    torque      (M,) the torque [N m] that explains most, over each interval; what is not significant is shrunk
    where       the stretch of the quantity over which most of it acts, in words
    """

    depends_on: tuple[str, ...]
    lm: float
    gain: float
    p_value: float
    torque: Array
    where: str


def dependences(fit: Fit) -> dict[str, Dependence]:
    """Every quantity, tested about a fit."""
    basis = np.linalg.qr(fit.Z)[0] if fit.Z.shape[1] else fit.Z
    return {name: _tested(fit, basis, name) for name in QUANTITIES}


def _tested(fit: Fit, basis: Array, name: str) -> Dependence:
    torque = _torques(fit, name)
    on = tuple(name.split("+"))
    M = len(fit.chain)
    if torque.shape[1] == 0:  # the quantity hardly varies
        return Dependence(on, 0.0, 0.0, 1.0, np.zeros(M), "")
    # a torque enters as the random acceleration does, which is a torque over the inertia
    G = fit.linearised.system.A[:, :, 2, None] * (torque / fit.inertia)[:, None, :]
    Z = fit.filter.whiten(G, np.zeros_like(G))
    Z = Z - basis @ (basis.T @ Z)
    U, size, V = np.linalg.svd(Z, full_matrices=False)
    keep = size > 1e-6 * max(float(size[0]), 1e-300)
    along = U[:, keep].T @ fit.e
    lm, rank = float(along @ along), int(np.sum(keep))
    sizes = V[keep].T @ (along / size[keep])
    sd = np.sqrt(np.sum((V[keep].T / size[keep]) ** 2, axis=1))
    worth = np.maximum(0.0, 1.0 - (2.0 * sd / np.maximum(np.abs(sizes), 1e-300)) ** 2)
    found = torque @ (sizes * worth)
    gain = lm - rank * math.log(fit.chain.readings)
    return Dependence(on, lm, gain, float(chi2.sf(lm, rank)), found, _where(fit, on[0], found))


def _middle(fit: Fit) -> tuple[Array, Array, Array]:
    """theta, theta_dot and the drive torque in the middle of the intervals (M,)."""
    x = fit.motion.x
    middle = np.where(fit.chain.follows[:, None], 0.5 * (x + np.roll(x, -1, axis=0)), x)
    return middle[:, 0], middle[:, 1], fit.linearised.drives.mean(axis=1)


def _torques(fit: Fit, name: str) -> Array:
    """Torques (M, Q) of unit size."""
    theta, theta_dot, drive = _middle(fit)
    if name == "theta_dot":
        return _splines(theta_dot, 8)
    if name == "torque":
        return _splines(drive, 6)
    if name == "time":
        return _times(fit)
    if name == "history":
        return _history(fit)
    angles = _angles(theta, fit.model.plant.turns)
    if name == "theta":
        return angles
    moving = np.tanh(theta_dot / max(1e-6, 0.2 * float(np.std(theta_dot))))
    return np.concatenate([angles, angles * moving[:, None], angles * theta_dot[:, None]], axis=1)


def _splines(x: Array, count: int) -> Array:
    """`count` cubic B-splines (M, count) over the range of x, knots at its quantiles; none where x hardly varies."""
    low, high = float(np.min(x)), float(np.max(x))
    if high - low < 1e-9:
        return np.zeros((len(x), 0))
    edge = 1e-9 * (high - low)
    inner = np.quantile(x, np.linspace(0.0, 1.0, count - 2)[1:-1])
    inner = np.unique(np.clip(inner, low + edge, high - edge))  # quantiles may coincide where x rests
    knots = np.concatenate([[low - edge] * 4, inner, [high + edge] * 4])
    values: Array = BSpline.design_matrix(np.clip(x, low, high), knots, 3).toarray()
    return values


def _angles(theta: Array, turns: bool) -> Array:
    """Splines over the angle: periodic where whole turns were made, else over the stretch that was seen."""
    span = float(np.ptp(theta))
    if span < 0.05:
        return np.zeros((len(theta), 0))
    count = int(np.clip(round(min(span, 2.0 * math.pi) / 0.3), 6, 20))
    if not turns or span < 2.0 * math.pi:
        return _splines(theta, count)
    width = 2.0 * math.pi / count
    apart = np.mod(theta[:, None] - width * np.arange(count) + math.pi, 2.0 * math.pi) - math.pi
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(apart) / width))


def _times(fit: Fit, seconds: float = 0.5, most: int = 96) -> Array:
    """Hats over the time of each record, `seconds` apart or wider."""
    chain, columns = fit.chain, []
    width = max(seconds, sum(len(r) * r.dt for r in chain.records) / most)
    for i, record in enumerate(chain.records):
        centres = np.linspace(record.t[0], record.t[-1], max(2, round(len(record) * record.dt / width) + 1))
        step = centres[1] - centres[0]
        apart = np.abs(chain.t[:, None] + 0.5 * chain.dt - centres)
        columns.append(np.maximum(0.0, 1.0 - apart / step) * (chain.number == i)[:, None])
    return np.concatenate(columns, axis=1)


def _history(fit: Fit, lags: tuple[int, ...] = (-1, 1, 2, 4, 8, 16)) -> Array:
    """Commands of earlier intervals, which a missing state would remember, and of the next: a log stamped late."""
    chain = fit.chain
    columns = np.zeros((len(chain), len(lags)))
    for i, record in enumerate(chain.records):
        at = len(record.past) + np.arange(len(record) + 1)[:, None] - np.array(lags)
        columns[chain.first[i] : chain.first[i + 1]] = record.commands[np.clip(at, 0, len(record.commands) - 1)]
    return columns if np.ptp(columns) > 1e-9 else columns[:, :0]


def _where(fit: Fit, on: str, torque: Array, bins: int = 24) -> str:
    """The stretch of a quantity over which most of a torque acts."""
    if on == "history":
        return "on what happened up to 16 samples before"
    if on == "time":
        k = int(np.argmax(np.abs(torque)))
        name = fit.chain.records[int(fit.chain.number[k])].name
        return f"strongest in {name} at {fit.chain.t[k]:.2f} s ({torque[k]:+.2g} N m)"
    theta, theta_dot, drive = _middle(fit)
    x, unit = {
        "theta": (fit.model.plant.place(theta), "rad"),
        "theta_dot": (theta_dot, "rad/s"),
        "torque": (drive, "N m"),
    }[on]
    edges = np.linspace(float(np.min(x)), float(np.max(x)), bins + 1)
    place = np.clip(np.digitize(x, edges) - 1, 0, bins - 1)
    count = np.bincount(place, minlength=bins)
    mean = np.bincount(place, torque, minlength=bins) / np.maximum(count, 1)
    met = count >= max(5, x.size // (4 * bins))  # where the joint hardly was, splines extrapolate
    if not np.any(met):
        return ""
    size = np.where(met, np.abs(mean - np.median(mean[met])), 0.0)
    peak = int(np.argmax(size))
    low, high = peak, peak
    while low > 0 and size[low - 1] > 0.5 * size[peak]:
        low -= 1
    while high < bins - 1 and size[high + 1] > 0.5 * size[peak]:
        high += 1
    return f"strongest for {on} from {edges[low]:.2f} to {edges[high + 1]:.2f} {unit} ({mean[peak]:+.2g} N m)"
