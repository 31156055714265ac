"""Where a model fails: the torque that the readings need beyond it, over each quantity that it may depend on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.comparison.held_out import finite
from sysid.comparison.residuals import Residuals
from sysid.records import Array

_KNOTS = {"theta": 12, "theta_dot": 5, "torque": 9}
_SPACING = 0.4
"""Seconds between the knots over time, at least; at most 60 knots in all."""
_MAP = (10, 8)
_FEWEST = 3.0
"""Intervals that a knot or a cell must rest on."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Torque (B,) [N m] that the readings need beyond the model at knots `at` (B,) of one quantity, straight between.

    sd (B,), count (B,) the intervals about each knot; `record` (B,) names, where the quantity is time. Either direction
    of motion is by itself: the torque may jump at speed 0. p_value: that there is no such torque; share: of the squared
    error beyond the noise that goes with it.
    """

    name: str
    unit: str
    at: Array
    torque: Array
    sd: Array
    count: Array
    p_value: float
    share: float
    record: tuple[str, ...] = ()

    @property
    def strongest(self) -> int:
        """The knot at which the torque stands out most from its own uncertainty."""
        return int(np.argmax(np.abs(self.torque) / self.sd))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        numbers = {k: [finite(v) for v in getattr(self, k).tolist()] for k in ("at", "torque", "sd", "count")}
        about = {"name": self.name, "unit": self.unit, "p_value": finite(self.p_value), "share": finite(self.share)}
        return {**about, **numbers, **({"record": list(self.record)} if self.record else {})}


@dataclass(frozen=True, eq=False)
class ResidualMap:
    """Torque (I, J) [N m] that the readings need beyond the model in cells of theta mod 2 pi and theta_dot.

    theta (I+1,) [rad] and theta_dot (J+1,) [rad/s] are the cells' edges; sd, count (I, J); nan where nothing was
    read. Cells are drawn towards zero by as much as their spread beyond the noise warrants (empirical Bayes): a
    perfect model's map is flat.
    """

    theta: Array
    theta_dot: Array
    torque: Array
    sd: Array
    count: Array

    @property
    def significant(self) -> NDArray[np.bool_]:
        """(I, J): cells in which the torque is beyond 2.6 of its sd."""
        return np.asarray(np.nan_to_num(np.abs(self.torque)) > 2.5758 * np.nan_to_num(self.sd, nan=np.inf))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON; an empty cell holds None."""
        cells = {k: [[finite(v) for v in row] for row in getattr(self, k).tolist()] for k in ("torque", "sd", "count")}
        return {"theta": self.theta.tolist(), "theta_dot": self.theta_dot.tolist(), **cells}


def hats(x: Array, knots: Array, period: float = 0.0) -> Array:
    """Piecewise linear functions (..., B), each 1 at its knot and 0 at the others; constant beyond the outer knots."""
    if period:
        apart = np.mod(x[..., None] - knots + 0.5 * period, period) - 0.5 * period
        return np.asarray(np.maximum(0.0, 1.0 - np.abs(apart) * len(knots) / period))
    place = np.interp(x, knots, np.arange(len(knots)))
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[..., None] - np.arange(len(knots)))))


@dataclass(frozen=True, eq=False)
class Shape:
    """Functions (K, L, B) of one quantity, 1 at its knots `at` (B,)."""

    unit: str
    at: Array
    values: Array
    record: tuple[str, ...] = ()

    def where(self, used: NDArray[np.bool_]) -> Shape:
        """Only some of the knots."""
        record = tuple(r for r, u in zip(self.record, used, strict=True) if u) if self.record else ()
        return Shape(self.unit, self.at[used], self.values[..., used], record)


def shapes(residuals: Residuals) -> dict[str, Shape]:
    """Functions of theta, theta_dot, torque and time; a quantity that does not vary has none."""
    found = {
        "theta": _angles(residuals),
        "theta_dot": _speeds(residuals),
        "torque": _commands(residuals),
        "time": _times(residuals),
    }
    chosen = {}
    for name, shape in found.items():
        count = np.sum(shape.values * residuals.scored[..., None], axis=(0, 1))
        used = count >= _FEWEST
        if used.sum() >= 2:
            chosen[name] = shape.where(used)
    return chosen


def _angles(residuals: Residuals) -> Shape:
    inside = residuals.theta[residuals.scored]
    low, high = np.quantile(inside, [0.005, 0.995])
    if residuals.response.model.plant.turns and high - low > 5.0:
        knots = np.linspace(0.0, 2.0 * math.pi, _KNOTS["theta"], endpoint=False)
        return Shape("rad", knots, hats(residuals.theta, knots, 2.0 * math.pi))
    knots = np.linspace(low, high, _KNOTS["theta"]) if high - low > 0.02 else np.array([low])
    return Shape("rad", knots, hats(residuals.theta, knots))


def _speeds(residuals: Residuals) -> Shape:
    """Either direction by itself: a friction may jump at speed 0."""
    v = residuals.theta_dot
    fastest = float(np.quantile(np.abs(v[residuals.scored]), 0.99))
    # speeds are more often small than large, and friction bends there
    knots = fastest * np.linspace(0.0, 1.0, _KNOTS["theta_dot"] + 1)[1:] ** 1.5
    forward = hats(v, knots) * (v > 0.0)[..., None]
    backward = hats(-v, knots)[..., ::-1] * (v < 0.0)[..., None]
    return Shape("rad/s", np.concatenate([-knots[::-1], knots]), np.concatenate([backward, forward], axis=-1))


def _commands(residuals: Residuals) -> Shape:
    u = residuals.command()
    inside = u[residuals.scored]
    knots = np.unique(np.linspace(np.min(inside), np.max(inside), _KNOTS["torque"]))
    return Shape("N m", knots, hats(u, knots) if len(knots) > 1 else np.ones((*u.shape, 1)))


def _times(residuals: Residuals) -> Shape:
    """Over each record by itself, in the order of the log; of very many records, nothing."""
    records = residuals.response.records if len(residuals.response.records) <= 60 else ()
    spacing = max(_SPACING, sum(len(r) * r.dt for r in records) / 60.0)
    at, values, names = [np.zeros(0)], [np.zeros((*residuals.time.shape, 0))], list[str]()
    for i, record in enumerate(records):
        count = round(len(record) * record.dt / spacing) + 1
        knots = np.linspace(record.t[0], record.t[-1], count) if count > 1 else np.mean(record.t, keepdims=True)
        own = np.array([w.record == i for w in residuals.response.windows])
        at.append(knots)
        values.append(hats(residuals.time, knots) * own[:, None, None])
        names += [record.name] * count
    return Shape("s", np.concatenate(at), np.concatenate(values, axis=-1), tuple(names))


def curve_of(residuals: Residuals, name: str, shape: Shape, z: Array) -> Curve:
    """The torque over the quantity `name` that the responses z explain best."""
    found = residuals.explain(z)
    return Curve(
        name=name,
        unit=shape.unit,
        at=shape.at,
        torque=found.coefficient,
        sd=found.sd,
        count=np.sum(shape.values * residuals.scored[..., None], axis=(0, 1)),
        p_value=found.p_value,
        share=residuals.share(found.sum, found.rank),
        record=shape.record,
    )


def map_of(residuals: Residuals) -> ResidualMap:
    """Cells of equal width over what was visited."""
    edges = []
    for values, count in zip((residuals.theta, residuals.theta_dot), _MAP, strict=True):
        low, high = np.quantile(values[residuals.scored], [0.002, 0.998])
        edges.append(np.linspace(low, max(high, low + 1e-6), count + 1))
    i, j = (
        np.clip(np.searchsorted(e, v) - 1, 0, len(e) - 2)
        for e, v in zip(edges, (residuals.theta, residuals.theta_dot), strict=True)
    )
    cell = (i * _MAP[1] + j).astype(int)
    indicator = (cell[..., None] == np.arange(_MAP[0] * _MAP[1])) & residuals.scored[..., None]
    count = np.sum(indicator, axis=(0, 1))
    used = count >= max(_FEWEST, 0.002 * count.sum())
    torque, sd = np.full(len(count), np.nan), np.full(len(count), np.nan)
    if np.any(used):
        torque[used], sd[used] = _shrunk(residuals, residuals.seen(indicator[..., used].astype(float)))
    return ResidualMap(edges[0], edges[1], torque.reshape(_MAP), sd.reshape(_MAP), count.reshape(_MAP))


def _shrunk(residuals: Residuals, z: Array) -> tuple[Array, Array]:
    """Posterior mean and sd (Q,) of torques that are N(0, spread^2) before they are seen; of all spreads the likeliest.

    Along an eigenvector of z'z with eigenvalue l, U = (z'e along it) / sqrt(l) ~ N(0, s^2 + l spread^2).
    """
    gram, vectors = np.linalg.eigh(z.T @ z)
    keep = gram > max(1e-9 * gram[-1], 1e-300)
    if not np.any(keep):
        return np.zeros(z.shape[1]), np.zeros(z.shape[1])
    gram, vectors = gram[keep], vectors[:, keep]
    U = (vectors.T @ (z.T @ residuals.e)) / np.sqrt(gram)
    left = max(1, residuals.degrees - len(U))
    variance = max(float(residuals.e @ residuals.e) - float(U @ U), 1e-300) / left
    spreads = np.concatenate([[0.0], np.geomspace(1e-4, 1e2, 61) * math.sqrt(variance / float(np.median(gram)))])
    total = variance + gram * spreads[:, None] ** 2
    spread = spreads[int(np.argmin(np.sum(np.log(total) + U**2 / total, axis=1)))]
    share = gram * spread**2 / (variance + gram * spread**2)
    mean = vectors @ (share * U / np.sqrt(gram))
    return mean, np.sqrt(np.sum(vectors**2 * (share * variance / gram), axis=1))
