"""Causes: which quantities, taken together, explain what a model leaves of the readings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from sysid.comparison.residual_map import Shape
from sysid.comparison.residuals import Residuals
from sysid.records import Array

LEVEL = 0.01
"""Of significance, over all quantities that are looked at."""
LEAST = 0.05
"""Of the squared error beyond the noise that a second cause must add."""
RIDGE = 1e-3
"""On torques that go into words: on one short motion quantities are alike, and huge torques would cancel."""
CLEARLY = 0.04
"""Of it that time must explain beyond what quantities of the joint do."""
MOST = 3
"""Causes at a time."""


@dataclass(frozen=True)
class Cause:
    """A quantity that the error depends on.

    on     "theta", "theta_dot", "torque", "time", "constant" (none of these), "history" (past or coming torque),
           "plant" (inertia and gravity are off) or "readings" (speeds that do not belong to their angles)
    share  of the squared error beyond the noise that goes with it, beside the causes before it
    words  what it looks like
    """

    on: str
    share: float
    words: str

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {"on": self.on, "share": self.share, "words": self.words}


@dataclass(frozen=True, eq=False)
class _Solution:
    """Least squares on some columns (Q,): coefficients with their sd, what they explain, and their rank."""

    columns: NDArray[np.intp]
    coefficient: Array
    sd: Array
    sum: float
    rank: int
    lag: int | None = None


class Columns:
    """Directions of several groups side by side, their products with one another and with the residuals.

    "history" is one column: of c (u(k - i) - u(k)), at the lag i that explains most beside the other groups.
    """

    def __init__(self, residuals: Residuals, groups: Mapping[str, Array], late: Array, lags: NDArray[np.intp]) -> None:
        past = lags != 0
        moved = late[:, past] - late[:, ~past]
        z = np.concatenate([*groups.values(), moved], axis=-1)
        length = np.linalg.norm(z, axis=0)
        self.size = np.where(length > 0.0, length, 1.0)
        self.gram, self.b = (z.T @ z) / np.outer(self.size, self.size), (z.T @ residuals.e) / self.size
        self.degrees, self.total = residuals.degrees, float(residuals.e @ residuals.e)
        edges = np.cumsum([0, *(g.shape[1] for g in groups.values())])
        self.of = {name: np.arange(a, b) for name, a, b in zip(groups, edges[:-1], edges[1:], strict=True)}
        self.late, self.lags = np.arange(edges[-1], len(self.size)), lags[past]

    def solve(self, names: tuple[str, ...], ridge: float = 0.0) -> _Solution:
        """Of the groups of these names together; a ridge (in units of a column's square) holds what is hardly seen."""
        columns = np.concatenate([np.zeros(0, dtype=int), *(self.of[n] for n in names if n in self.of)])
        lag = None
        if "history" in names:
            lag = self._best_lag(columns)
            columns = np.append(columns, self.late[lag])
        mixed, U = self._along(columns)
        size, explained = self.size[columns], float(U @ U)
        if ridge:
            mixed = mixed / (1.0 + ridge * np.sum(mixed**2, axis=0))
        variance = max(self.total - explained, 1e-300) / max(1, self.degrees - len(U))
        sd = np.sqrt(variance * np.sum(mixed**2, axis=1)) / size
        shown = None if lag is None else int(self.lags[lag])
        return _Solution(columns, (mixed @ U) / size, np.maximum(sd, 1e-300), explained, len(U), shown)

    def cost(self, found: _Solution) -> float:
        """BIC: n log(sum of squares) + log(n) rank."""
        n = self.degrees
        return n * math.log(max(self.total - found.sum, 1e-300)) + math.log(n) * found.rank

    def p_value(self, large: _Solution, small: _Solution) -> float:
        """Of the F test of a larger set of columns against a smaller one."""
        more, left = large.rank - small.rank, max(1, self.degrees - large.rank)
        if more <= 0:
            return 1.0
        variance = max(self.total - large.sum, 1e-300) / left
        return float(fdtrc(more, left, max(0.0, large.sum - small.sum) / more / variance))

    def _along(self, columns: NDArray[np.intp]) -> tuple[Array, Array]:
        """Orthonormal combinations (Q, rank) of columns, and the residuals along them."""
        gram, vectors = np.linalg.eigh(self.gram[np.ix_(columns, columns)])
        keep = gram > 1e-7
        mixed = vectors[:, keep] / np.sqrt(gram[keep])
        return mixed, mixed.T @ self.b[columns]

    def _best_lag(self, columns: NDArray[np.intp]) -> int:
        mixed, U = self._along(columns)
        along = mixed.T @ self.gram[np.ix_(columns, self.late)]
        own = np.diag(self.gram)[self.late] - np.sum(along**2, axis=0)
        rest = self.b[self.late] - along.T @ U
        return int(np.argmax(np.where(own > 1e-6, rest**2 / np.maximum(own, 1e-6), 0.0)))


def causes(
    residuals: Residuals, shapes: Mapping[str, Shape], seen: Mapping[str, Array], late: Array, lags: NDArray[np.intp]
) -> tuple[Cause, ...]:
    """Of all sets of up to three quantities that each add something, the one of least BIC; the strongest first.

    Any torque can be drawn over time: a set with time is taken where it explains clearly more than all sets without.
    """
    more = {
        "constant": residuals.seen(np.ones((*residuals.theta.shape, 1))),
        "plant": residuals.seen(plant_torques(residuals)),
        "readings": of_readings(residuals),
    }
    columns = Columns(residuals, {**seen, **more}, late, lags)
    sets = list(_sets(columns))
    chosen = _best(residuals, columns, [names for names in sets if "time" not in names])
    over_time = _best(residuals, columns, [names for names in sets if "time" in names])
    if over_time:
        without, within = columns.solve(chosen), columns.solve(over_time)
        if not chosen or residuals.share(within.sum - without.sum, within.rank - without.rank) > CLEARLY:
            chosen = over_time
    return tuple(_told(residuals, columns, shapes, chosen))


def _best(residuals: Residuals, columns: Columns, sets: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
    """The set of least BIC of which each quantity adds something; () where that is none."""
    chosen: tuple[str, ...] = ()
    least = columns.cost(columns.solve(()))
    for names in sets:
        found = columns.solve(names)
        cost = columns.cost(found)
        if cost < least and all(_adds(residuals, columns, found, names, name) for name in names):
            least, chosen = cost, names
    return chosen


def plant_torques(residuals: Residuals) -> Array:
    """Torques (K, L, 2) [N m] that would be missing if inertia, or gravity, were twice the model's."""
    model, states = residuals.response.model, residuals.states
    acceleration = np.diff(states[..., 1], axis=1) / model.dt
    gravity = np.broadcast_to(model.plant.gravity_torque(residuals.theta), acceleration.shape)
    return np.stack([-float(model.inertia()) * acceleration, gravity], axis=-1)


def of_readings(residuals: Residuals) -> Array:
    """Directions (rows, 2) of speeds that do not belong to their angles: offset by 1 rad/s, and twice what they are."""
    theta_dot = residuals.states[..., 1]
    speed = np.stack([np.ones_like(theta_dot), theta_dot], axis=-1)
    z = np.stack([np.zeros_like(speed), speed], axis=1) * residuals.response.weight[..., None]
    return residuals.beside_starts(z.reshape(len(z), -1, 2))


def _sets(columns: Columns) -> Iterator[tuple[str, ...]]:
    """Of up to three quantities; a plant that is off looks like a torque that is, so only one of them."""
    for count in range(1, MOST + 1):
        for chosen in combinations((*columns.of, "history"), count):
            if not {"torque", "plant"} <= set(chosen):
                yield chosen


def _adds(residuals: Residuals, columns: Columns, found: _Solution, names: tuple[str, ...], name: str) -> bool:
    """Whether a quantity is significant beside the others, and adds enough."""
    less = columns.solve(tuple(n for n in names if n != name))
    tries = len(columns.of) + (len(columns.lags) if name == "history" else 0)
    if columns.p_value(found, less) * tries > LEVEL:
        return False
    return len(names) == 1 or residuals.share(found.sum - less.sum, found.rank - less.rank) > LEAST


def _told(
    residuals: Residuals, columns: Columns, shapes: Mapping[str, Shape], chosen: tuple[str, ...]
) -> Iterator[Cause]:
    joint, held = columns.solve(chosen), columns.solve(chosen, RIDGE)
    before: tuple[str, ...] = ()
    known = columns.solve(())
    while len(before) < len(chosen):
        offers = {n: columns.solve((*before, n)) for n in chosen if n not in before}
        name = max(offers, key=lambda n: offers[n].sum)
        share = residuals.share(offers[name].sum - known.sum, offers[name].rank - known.rank)
        own = np.isin(joint.columns, columns.of.get(name, columns.late))
        used = held if name in shapes else joint
        words = _words(residuals, name, shapes.get(name), used.coefficient[own], used.sd[own], joint.lag)
        yield Cause(name, share, words)
        before, known = (*before, name), offers[name]


# words -----------------------------------------------------------------------------------------------------------


def _words(residuals: Residuals, name: str, shape: Shape | None, number: Array, sd: Array, lag: int | None) -> str:
    if name == "history":
        return _history(lag or 0, residuals.response.model.dt)
    if shape is None:
        return {"readings": _readings, "plant": _plant, "constant": _constant}[name](number, sd)
    return {"theta": _angle, "theta_dot": _speed, "torque": _command, "time": _time}[name](shape, number, sd)


def _history(lag: int, dt: float) -> str:
    rows, time = f"{abs(lag)} sample{'s' * (abs(lag) != 1)}", f"{1e3 * abs(lag) * dt:.3g} ms"
    if lag < 0:
        return f"the motion follows the torque of {rows} later ({time}): how the log stamps its rows"
    reason = "a delay, a lag or the stamp of the log" if lag == 1 else "a delay or a lag of torque or readings"
    return f"the motion follows the torque of {rows} ago ({time}): {reason}"


def _constant(number: Array, sd: Array) -> str:
    return f"a constant torque of {number[0]:+.2g} N m is missing"


def _readings(number: Array, sd: Array) -> str:
    size = np.abs(number) / sd
    said = [f"offset by {number[0]:+.2g} rad/s", f"{number[1]:+.1%} off"]
    found = [words for words, s in zip(said, size, strict=True) if s > 0.3 * np.max(size)]
    return f"the speed readings do not belong to the angle's: they are {' and '.join(found)}"


def _plant(number: Array, sd: Array) -> str:
    inertia, gravity = number
    if gravity != 0.0 and abs(inertia - gravity) < 3.0 * float(np.hypot(*sd)) + 0.05 * abs(inertia):
        torque = f"the torque {1.0 / (1.0 + inertia):.0%} of what was commanded"
        return f"the plant's numbers do not fit, as if inertia and gravity were {inertia:+.1%} off, or {torque}"
    said = [f"inertia is {inertia:+.1%} off", f"gravity torque is {gravity:+.1%} off"]
    found = [words for words, n, s in zip(said, number, sd, strict=True) if abs(n) > 3.0 * s]
    return f"the plant's numbers do not fit: {' and '.join(found or said)}"


def _speed(shape: Shape, torque: Array, sd: Array) -> str:
    """A friction in its form, where the curve is odd; else where it is strongest."""
    v = shape.at
    weight = 1.0 / sd**2
    fits = {}
    for words, form in {
        "grows with |theta_dot| (viscous-like)": v,
        "is alike at all speeds (like dry friction)": np.sign(v),
        "grows with theta_dot^2 (drag-like)": v * np.abs(v),
    }.items():
        a = _slope(form, torque, weight)
        fits[words] = (float(np.sum(weight * (torque - a * form) ** 2)), a)
    words = min(fits, key=lambda w: fits[w][0])
    left, a = fits[words]
    if left < 0.3 * float(np.sum(weight * torque**2)):
        return f"a torque {'against' if a < 0.0 else 'along'} the motion is missing, which {words}"
    return f"it depends on the speed, strongest near theta_dot = {_strongest(shape, torque, sd, 'rad/s')}"


def _command(shape: Shape, torque: Array, sd: Array) -> str:
    """A gain, where the curve is straight through zero; else where it is strongest."""
    weight = 1.0 / sd**2
    a = _slope(shape.at, torque, weight)
    if float(np.sum(weight * (torque - a * shape.at) ** 2)) < 0.15 * float(np.sum(weight * torque**2)):
        return f"the joint moves as if it felt {1.0 + a:.0%} of the commanded torque"
    return f"it depends on the commanded torque, strongest near u = {_strongest(shape, torque, sd, 'N m')}"


def _angle(shape: Shape, torque: Array, sd: Array) -> str:
    return f"it depends on the angle, strongest near theta = {_strongest(shape, torque, sd, 'rad')}"


def _time(shape: Shape, torque: Array, sd: Array) -> str:
    k = _peak(torque, sd)
    return f"it comes and goes with time, strongest in {shape.record[k]} at {shape.at[k]:.1f} s ({torque[k]:+.2g} N m)"


def _strongest(shape: Shape, torque: Array, sd: Array, unit: str) -> str:
    k = _peak(torque, sd)
    return f"{shape.at[k]:.2g} {unit} ({torque[k]:+.2g} N m)"


def _peak(torque: Array, sd: Array) -> int:
    """The knot at which the torque is surely the largest."""
    return int(np.argmax(np.abs(torque) - 2.0 * sd))


def _slope(form: Array, torque: Array, weight: Array) -> float:
    """a of torque = a form, by weighted least squares."""
    return float(np.sum(weight * form * torque)) / max(float(np.sum(weight * form**2)), 1e-300)
