"""Design of experiments: what a log of some signal would tell, before it is played, and a search for the signal that tells most."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sysid.diagnose.signals import Limits, Signal, draw, rest_angle, vary, within
from sysid.identify.gauss_newton import reduce
from sysid.model import Model
from sysid.records import Array, Record
from sysid.response import Linearisation, Response, cut
from sysid.sensor import Sensor
from sysid.simulate import Trajectory, simulate

LARGEST_GROWTH = 300.0
"""Of an initial error within a rollout; beyond it a fit would have to find its way through a chaotic motion."""

UNDETERMINED = 1e9
"""Relative width from which an interval says nothing."""

_SAMPLES = 80_000
"""Samples that a round of the search may linearise, all hypotheses together."""
_ROUNDS = 3
_PARENTS = 6
_FINALISTS = 3
_SHRINK = 0.75


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model that may be true, with its free parameters `names`; `name` is what it stands for."""

    name: str
    model: Model
    names: tuple[str, ...]

    @property
    def p(self) -> Array:
        """The free parameters' numbers (P,)."""
        known = self.model.parameters
        return np.array([float(known[n].value) for n in self.names])


class Normal(NamedTuple):
    """Normal equations of K logs: c (K,) = r'r, g (K, P) = S'r, F (K, P, P) = S'S, every rollout's start eliminated.

    Those of several rollouts played together are their sums.
    """

    c: Array
    g: Array
    F: Array

    @classmethod
    def of(cls, rival: Linearisation, truth: Linearisation | None = None) -> Normal:
        """Of the whitened readings of `truth` less those of `rival`, about the rival; one log a window."""
        lin = rival if truth is None else replace(rival, e=rival.e - truth.e)
        reduced = reduce(lin)
        S, e = reduced.S, reduced.e
        S_t = np.swapaxes(S, -1, -2)
        return cls(np.sum(e * e, axis=-1), (S_t @ e[..., None])[..., 0], S_t @ S)

    def together(self) -> Normal:
        """All logs as one (K = 1)."""
        return Normal(*(np.sum(a, axis=0, keepdims=True) for a in self))

    def plus(self, one: Normal) -> Normal:
        """Each log with another one beside it."""
        return Normal(*(a + b for a, b in zip(self, one, strict=True)))

    def at(self, k: int) -> Normal:
        """The k-th log alone."""
        return Normal(*(a[k : k + 1] for a in self))

    def unexplained(self) -> Array:
        """c - g' F^-1 g (K,): what is left of r'r once the rival has taken the best numbers, to first order.

        T-optimality (Atkinson and Fedorov, Biometrika 1975). For a small effect of size a it is a^2 |z_perp|^2 (1 - rho^2).
        """
        size = np.sqrt(np.maximum(np.diagonal(self.F, axis1=-2, axis2=-1), 1e-300))
        F = self.F / (size[..., :, None] * size[..., None, :])
        g = (self.g / size)[..., None]
        taken = np.swapaxes(g, -1, -2) @ np.linalg.pinv(F, rcond=1e-10, hermitian=True) @ g
        left: Array = np.maximum(self.c - taken[..., 0, 0], 0.0)
        return left

    def sd(self) -> Array:
        """Standard deviations (K, P) of the parameters; inf where the log does not determine one."""
        size = np.sqrt(np.maximum(np.diagonal(self.F, axis1=-2, axis2=-1), 1e-300))
        value, vector = np.linalg.eigh(self.F / (size[..., :, None] * size[..., None, :]))
        lost = value < 1e-9
        variance = np.sum(vector**2 / np.where(lost, np.inf, value)[..., None, :], axis=-1)
        unknown = np.any((np.abs(vector) > 0.01) & lost[..., None, :], axis=-1)
        sd: Array = np.where(unknown, np.inf, np.sqrt(variance)) / size
        return sd


class Pool:
    """Signals, each one rollout, as every hypothesis foresees them."""

    def __init__(
        self, hypotheses: Sequence[Hypothesis], signals: Sequence[Signal], limits: Limits, sensor: Sensor
    ) -> None:
        self.hypotheses, self.signals = tuple(hypotheses), tuple(signals)
        self.run = foresee(hypotheses[0].model, signals, limits)
        records = noise_free(self.run, sensor)
        starts = np.stack([self.run.theta[:, 0], self.run.theta_dot[:, 0]], axis=-1)
        rest = rest_angle(hypotheses[0].model)
        self.lins, self.allowed = [], np.ones(len(self.signals), dtype=bool)
        for h in hypotheses:
            response = Response(h.model, h.names, records, sensor, cut(records))
            lin = response.linearise(h.p, starts)
            seen = np.maximum(response.weight.reshape(len(records), -1), 1e-300)[..., None]
            growth = np.max(np.abs(lin.S_x / seen), axis=(1, 2))
            self.allowed &= (growth <= LARGEST_GROWTH) & _stays(lin.states, rest, limits)
            self.lins.append(lin)


def foresee(model: Model, signals: Sequence[Signal], limits: Limits) -> Trajectory:
    """The motions of a model under the signals, from rest or from where it is released."""
    n = round(limits.duration / model.dt)
    u = np.array([s.torque(n, model.dt) for s in signals])
    start = rest_angle(model) + np.array([s.release for s in signals])
    return simulate(model, u, start, np.zeros(len(signals)))


def noise_free(run: Trajectory, sensor: Sensor) -> list[Record]:
    """Records of perfect readings in the channels that the sensor has."""
    found = []
    for i, u in enumerate(run.u):
        angle = run.theta_read[i] if sensor.theta is not None else run.theta_read[i, :1] if sensor.theta_0 else None
        speed = run.theta_dot_read[i] if sensor.theta_dot is not None else None
        found.append(Record(run.t, u, angle, speed, name=f"rollout {i}"))
    return found


def _stays(states: Array, rest: float, limits: Limits) -> Array:
    """Whether motions (K, L+1, 2) keep to the limits (K,)."""
    far, fast = np.max(np.abs(states - [rest, 0.0]), axis=1).T
    slack = 1.0 + 1e-6
    stays: Array = (far <= slack * (limits.theta_max or math.inf)) & (fast <= slack * (limits.theta_dot_max or math.inf))
    return stays


def tamed(model: Model, signals: Sequence[Signal], limits: Limits) -> list[Signal]:
    """The signals, each made smaller until torque and predicted motion keep to the limits."""
    n = round(limits.duration / model.dt)
    found = [within(s, limits, n, model.dt) for s in signals]
    if limits.theta_max is None and limits.theta_dot_max is None:
        return found
    waiting = list(range(len(found)))
    for _ in range(16):
        run = foresee(model, [found[i] for i in waiting], limits)
        stays = _stays(np.stack([run.theta, run.theta_dot], axis=-1), rest_angle(model), limits)
        waiting = [i for i, fine in zip(waiting, stays, strict=True) if not fine]
        if not waiting:
            break
        for i in waiting:
            found[i] = found[i].smaller(_SHRINK)
    return found


Parts = list[Normal]
"""The normal equations that a goal is made of, each of the pool's K signals."""


@dataclass(frozen=True, eq=False)
class Goal:
    """What a log is for: `parts` of a pool are summed over the rollouts, and `value` (K,) is to be large."""

    parts: Callable[[Pool], Parts]
    value: Callable[[Parts], Array]


def separation(pairs: Sequence[tuple[int, int]]) -> Goal:
    """The smallest evidence, over pairs (truth, rival) of hypotheses, that the truth leaves against the rival."""

    def parts(pool: Pool) -> Parts:
        return [Normal.of(pool.lins[rival], pool.lins[truth]) for truth, rival in pairs]

    def value(normals: Parts) -> Array:
        least: Array = np.min([n.unexplained() for n in normals], axis=0)
        return least

    return Goal(parts, value)


def precision(scale: Array) -> Goal:
    """The widest interval in units of scale (P,), as a negative number; every rollout is played in each hypothesis.

    A log that does not determine a parameter is worth -UNDETERMINED.
    """

    def parts(pool: Pool) -> Parts:
        normals = [Normal.of(lin) for lin in pool.lins]
        total = normals[0]
        for other in normals[1:]:
            total = total.plus(other)
        return [total]

    def value(normals: Parts) -> Array:
        widest: Array = np.max(normals[0].sd() / scale, axis=-1)
        return -np.minimum(widest, UNDETERMINED)

    return Goal(parts, value)


class Choice(NamedTuple):
    """Signals to play, one a rollout, and what they are worth to the goal."""

    signals: tuple[Signal, ...]
    value: float


def search(
    goal: Goal, hypotheses: Sequence[Hypothesis], limits: Limits, sensor: Sensor, rng: np.random.Generator
) -> list[Choice]:
    """A few good choices, each begun with a signal of another kind, best first; empty where nothing is allowed.

    Random signals of all kinds, then variations of the best; further rollouts are added one by one, whichever helps most.
    """
    model = hypotheses[0].model
    n = round(limits.duration / model.dt)
    width = int(np.clip(_SAMPLES // (n * len(hypotheses)), 12, 96))
    swings = rest_angle(model) != 0.0
    signals = draw(rng, limits, model.dt, width, swings)
    best: list[Signal] = []
    for _ in range(_ROUNDS):
        fresh = tamed(model, signals, limits)
        pool = Pool(hypotheses, [*best, *fresh], limits, sensor)
        parts = goal.parts(pool)
        value = np.where(pool.allowed, goal.value(parts), -np.inf)
        order = [int(k) for k in np.argsort(-value, kind="stable") if value[k] > -np.inf]
        if not order:
            signals = [s.smaller(0.3) for s in draw(rng, limits, model.dt, width, swings)]
            continue
        leaders = _leaders(pool.signals, order)
        best = [pool.signals[k] for k in dict.fromkeys([*leaders, *order[:_PARENTS]])]
        signals = [vary(best[i % len(best)], rng, limits, model.dt) for i in range(width - len(best))]
    if not best:
        return []
    choices = [_completed(goal, pool, parts, k, limits.rollouts) for k in leaders[:_FINALISTS]]
    return sorted(choices, key=lambda c: -c.value)


def _leaders(signals: Sequence[Signal], order: Sequence[int]) -> list[int]:
    """The best of each kind, best first."""
    first: dict[str, int] = {}
    for k in order:
        first.setdefault(signals[k].kind, k)
    return list(first.values())


def _completed(goal: Goal, pool: Pool, parts: Parts, first: int, rollouts: int) -> Choice:
    chosen, total = [first], [p.at(first) for p in parts]
    for _ in range(rollouts - 1):
        value = goal.value([p.plus(t) for p, t in zip(parts, total, strict=True)])
        k = int(np.argmax(np.where(pool.allowed, value, -np.inf)))
        chosen.append(k)
        total = [t.plus(p.at(k)) for p, t in zip(parts, total, strict=True)]
    return Choice(tuple(pool.signals[k] for k in chosen), float(goal.value(total)[0]))
