"""Can this log decide which effect is hidden? Linear algebra on the truth, without any diagnosis.

Along the true motion every effect is a torque d(t) beside the pendulum, or a change of the readings. To first order a
torque mismatch moves the readings by the response of the linearised pendulum,

    J delta_theta_ddot = G cos(theta) delta_theta + d(t),

so a model without the effect misses the readings by z, of which the start states of the rollouts, J and G absorb a
part. In units of the noise, with what they absorb taken out,

    lambda   = |z|^2                   evidence against the model without the effect
    lambda_r = min over r of |z - r|^2 evidence against rival r, at the rival's best size and shape

and a case is decidable where both are at least 16, against every rival that does not contain the effect.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from tests.benchmarks.experiments import World
from tests.benchmarks.truth import NEUTRAL, Array, simulate

ENOUGH = 16.0
CELL = 0.005  # [s]
# Exactly the same thing to a log of this kind, and larger families that hold the effect: no rivals.
TWINS: Mapping[str, frozenset[str]] = {
    "viscous": frozenset({"back_emf"}),
    "back_emf": frozenset({"viscous"}),
    "tilt": frozenset({"angle_offset"}),
    "angle_offset": frozenset({"tilt"}),
    "delay": frozenset({"sensor_delay"}),
    "sensor_delay": frozenset({"delay"}),
}
CONTAINS: Mapping[str, frozenset[str]] = {
    "viscous": frozenset({"asymmetric_viscous"}),
    "back_emf": frozenset({"asymmetric_viscous"}),
    "coulomb": frozenset({"stribeck", "asymmetric_coulomb"}),
}
ALIAS = {"back_emf": "viscous", "angle_offset": "tilt", "sensor_delay": "delay"}
SHAPES = ("v_s", "order", "phase", "f")
DRY = frozenset({"coulomb", "stribeck", "asymmetric_coulomb", "load_friction"})


@dataclass(frozen=True)
class Decidability:
    """evidence: lambda against no effect; rivals: lambda against each rival (without twins and larger families)."""

    evidence: float
    rivals: Mapping[str, float]

    @property
    def worst(self) -> str:
        """The rival that is hardest to exclude."""
        return min(self.rivals, key=lambda n: self.rivals[n])

    @property
    def least(self) -> float:
        """The smallest lambda."""
        return min((self.evidence, *self.rivals.values()))

    @property
    def decidable(self) -> bool:
        """Whether the data decide."""
        return self.least >= ENOUGH


@dataclass(frozen=True, eq=False)
class Family:
    """What a rival can do: torques (q, L, C) [N m], and readings (q, L, N+1, 2). signed: sizes of either sign.

    A path is a nonlinear family, its members in the order of its one number: it may stand between two neighbours, and
    between none and the first unless it begins there (begins).
    """

    torques: Array | None = None
    readings: Array | None = None
    signed: bool = True
    path: bool = False
    begins: bool = False

    def members(self) -> list[Family]:
        """A linear family as it is; each member of a path alone."""
        if not self.path:
            return [self]
        each = (self.torques, self.readings)
        count = max(len(x) for x in each if x is not None)
        return [Family(*(None if x is None else x[k : k + 1] for x in each)) for k in range(count)]


class Motions:
    """The true motion of a world on a fine grid, and the readings that any torque along it would add."""

    def __init__(self, world: World) -> None:
        self.world, log, plan = world, world.log, world.plan
        self.fine = max(1, round(log.dt / CELL))
        self.h = log.dt / self.fine
        u = np.repeat(plan.u, self.fine, axis=1)
        rows = np.arange(plan.u.shape[1] * self.fine + 1) / self.fine
        wind = None
        if world.gust:
            wind = world.gust * np.array([np.interp(rows, np.arange(len(w)), w) for w in plan.wind])
        self.motion = simulate(world.numbers, u, plan.theta, 0.0, self.h, wind, step=5e-4)
        self.t, self.theta, self.theta_dot = self.motion.t, self.motion.theta, self.motion.theta_dot
        p = NEUTRAL | dict(world.numbers)
        self.J, self.G = p["m"] * p["l"] ** 2 / 3.0, 0.5 * p["m"] * p["g"] * p["l"]
        self.u = u
        self.stuck = (self.theta_dot[:, :-1] == 0.0) & (self.theta_dot[:, 1:] == 0.0)
        noise = world.log.noise
        self.scale = np.array([1.0 / noise[0], 0.0 if noise[1] is None else 1.0 / noise[1]])

    @cached_property
    def mismatch(self) -> Array:
        """Mean torque in each cell that the bare pendulum lacks (L, C) [N m], from the change of momentum."""
        slope = np.cos(self.theta) * self.theta_dot
        gravity = self.G * (self.cells(np.sin(self.theta)) - self.h / 12.0 * np.diff(slope, axis=1))
        return self.J * np.diff(self.theta_dot, axis=1) / self.h - gravity - self.u

    @staticmethod
    def cells(x: Array) -> Array:
        """Means over the cells of a function given at their ends."""
        return 0.5 * (x[..., :-1] + x[..., 1:])

    def response(self, torques: Array) -> Array:
        """Readings (q, L, N+1, 2) in units of their noise that torques (q, L, C) would add, start states kept."""
        stiff = self.G / self.J * self.cells(np.cos(self.theta))
        x, v = np.zeros(torques.shape[:2]), np.zeros(torques.shape[:2])
        return self._follow(x, v, stiff, torques / self.J)

    def _follow(self, x: Array, v: Array, stiff: Array, push: Array) -> Array:
        h, out = self.h, [np.stack([x, v], axis=-1)]
        for c in range(stiff.shape[-1]):
            a = stiff[:, c] * (x + 0.5 * h * v) + push[..., c]
            x, v = x + h * v + 0.5 * h * h * a, v + h * a
            v = v + 0.25 * h * h * h * stiff[:, c] * a  # the third order of the slope
            if (c + 1) % self.fine == 0:
                out.append(np.stack([x, v], axis=-1))
        return np.stack(out, axis=-2) * self.scale

    @cached_property
    def starts(self) -> Array:
        """Orthonormal readings (L, K, 2) that start angle and speed can absorb, K = 2 (N+1)."""
        stiff = self.G / self.J * self.cells(np.cos(self.theta))
        L = len(self.theta)
        one, zero = np.ones((1, L)), np.zeros((1, L))
        free = self._follow(np.vstack([one, zero]), np.vstack([zero, one]), stiff, np.zeros((1, *stiff.shape)))
        return np.linalg.qr(np.moveaxis(free.reshape(2, L, -1), 0, -1))[0]

    def project(self, readings: Array) -> Array:
        """Readings (q, L, N+1, 2) without what start states absorb, as rows (q, K L)."""
        flat = readings.reshape(len(readings), len(self.theta), -1)
        inside = np.einsum("lkj,qlk->qlj", self.starts, flat)
        return (flat - np.einsum("lkj,qlj->qlk", self.starts, inside)).reshape(len(flat), -1)

    def rows(self, families: Sequence[Family]) -> list[Array]:
        """The readings of each family's members, projected (q, K L); the torques of all of them in one sweep."""
        torques = [f.torques for f in families if f.torques is not None]
        moved = iter(np.split(self.response(np.concatenate(torques)), np.cumsum([len(x) for x in torques])[:-1]))
        out = []
        for f in families:
            total = next(moved) if f.torques is not None else 0.0
            out.append(self.project(total if f.readings is None else total + f.readings * self.scale))
        return out

    @cached_property
    def base(self) -> Array:
        """Orthonormal rows that J and G absorb."""
        sine = self.cells(np.sin(self.theta))
        inertia = np.diff(self.theta_dot, axis=1) / self.h
        return np.linalg.qr(self.rows([Family(np.stack([sine, inertia]))])[0].T)[0].T

    def seen(self) -> Array:
        """What the sensors add to the state (1, L, N+1, 2), without noise."""
        pairs = (
            (self.motion.reading_theta, self.theta),
            (self.motion.reading_theta_dot, self.theta_dot),
        )
        return np.stack([(a - b)[:, :: self.fine] for a, b in pairs], axis=-1)[None]


def decide(world: World, effect: str, beside: str | None = None) -> Decidability:
    """Evidence for a hidden effect of a world against no effect, and against every rival.

    beside: another hidden effect, which the model already has, in the shape and size that explain most. A single
    effect that could stand for both is a rival too.
    """
    from tests.benchmarks.rivals import rivals

    motions = Motions(world)
    families = rivals(motions)
    truth = Family(motions.mismatch[None], motions.seen())
    moving = Family(np.where(motions.stuck, 0.0, motions.mismatch)[None], motions.seen())
    if beside is None:
        return weigh(motions, effect, truth, moving, families)
    name = ALIAS.get(beside, beside)
    members = [m for f in families[name] for m in f.members()]
    rows = motions.rows([truth, *members])
    least = [_left(motions.base, r, rows[0][0]) for r in rows[1:]]
    others = {k: v for k, v in families.items() if k != name}
    apart = weigh(motions, effect, truth, moving, others, rows[1 + int(np.argmin(least))])
    alone = weigh(motions, "", truth, moving, families)
    return Decidability(apart.evidence, apart.rivals | {f"{alone.worst} alone": alone.rivals[alone.worst]})


def _left(base: Array, more: Array, z: Array) -> float:
    """|z|^2 beyond the base and more rows."""
    Q = _basis(base, more)
    rest = z - (z @ Q.T) @ Q
    return float(rest @ rest)


def _basis(base: Array, more: Array) -> Array:
    return np.linalg.qr(np.vstack([base, more]).T)[0].T


def weigh(
    motions: Motions,
    effect: str,
    truth: Family,
    moving: Family,
    families: Mapping[str, Sequence[Family]],
    known: Array | None = None,
) -> Decidability:
    """The same for a mismatch `truth`; `moving` leaves out the cells in which friction holds the joint, where any dry
    friction large enough does as well. What the rows `known` (q, K L) can do is in the model beside J and G."""
    base = motions.base if known is None else _basis(motions.base, known)

    def off(rows: Array) -> Array:
        return rows - (rows @ base.T) @ base

    left_out = {effect} | TWINS.get(effect, frozenset()) | CONTAINS.get(effect, frozenset())
    flat = [(name, f) for name, members in families.items() if name not in left_out for f in members]
    (z,), (z_moving,), *rows = (off(r) for r in motions.rows([truth, moving, *(f for _, f in flat)]))
    left: dict[str, float] = {}
    for (name, family), row in zip(flat, rows, strict=True):
        least = _least(z_moving if name in DRY else z, row, family)
        left[name] = min(least, left.get(name, np.inf))
    return Decidability(float(z @ z), left)


def _least(z: Array, rows: Array, family: Family) -> float:
    """min |z - r|^2 over what the family can do."""
    if not family.path:
        columns = np.vstack([rows, -rows]) if family.signed else rows
        norms = np.linalg.norm(columns, axis=1)
        columns = columns[norms > 1e-9] / norms[norms > 1e-9, None]
        if not len(columns):
            return float(z @ z)
        R = np.linalg.qr(np.vstack([columns, z]).T, mode="r")
        return float(nnls(R[:, :-1], R[:, -1])[1] ** 2)
    points = rows if family.begins else np.vstack([np.zeros_like(z), rows])
    along, miss = np.diff(points, axis=0), z - points[:-1]
    share = np.clip(np.sum(along * miss, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-30), 0.0, 1.0)
    return float(np.min(np.sum((miss - share[:, None] * along) ** 2, axis=1)))


def scaled(world: World, effect: str, aim: float, tries: int = 8) -> tuple[World, Decidability]:
    """The world with its effect shrunk or grown until the least lambda is near `aim`."""
    size, below, above = 1.0, 1e-4, 10.0
    best: tuple[World, Decidability] | None = None
    for _ in range(tries):
        now = dataclasses.replace(world, numbers=resized(world, size))
        decidability = decide(now, effect)
        if best is None or abs(decidability.least - aim) < abs(best[1].least - aim):
            best = (now, decidability)
        if 0.85 * aim < decidability.least < 1.2 * aim:
            break
        below, above = (size, above) if decidability.least < aim else (below, size)
        guess = size * np.sqrt(aim / max(decidability.least, 1e-9))
        size = float(guess if 1.1 * below < guess < 0.9 * above else np.sqrt(below * above))
    assert best is not None
    return best


def resized(world: World, factor: float) -> dict[str, float]:
    """The hidden numbers at another size: shapes stay, gains grow about 1, delays beyond one row."""
    peak, dt = float(np.max(np.abs(world.plan.u))), world.log.dt
    around = {"saturation.limit": peak, "delay.T": dt, "sensor_delay.T": dt}
    power = {"saturation.limit": 0.5}
    new = {}
    for key, value in world.numbers.items():
        if key.split(".")[-1] in SHAPES:
            new[key] = value
            continue
        zero = around.get(key, 1.0 if NEUTRAL[key] == 1.0 else 0.0)
        new[key] = zero + (value - zero) * factor ** power.get(key, 1.0)
    return new
