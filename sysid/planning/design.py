"""Design of experiments: what a log of some signal would tell before it is played, and a search for the best signal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.effects import Effect, OutputEffect
from sysid.identify.gauss_newton import Fit, Solution, without
from sysid.model import Model
from sysid.planning.directions import Directions
from sysid.planning.signals import Limits, Signal, draw, rest_angle, vary, within
from sysid.records import Array, Record
from sysid.response import Linearisation, Response
from sysid.sensor import Sensor
from sysid.windows import cut

LARGEST_GROWTH = 300.0
"""Of an initial error within a rollout; beyond it a fit would have to find its way through a chaotic motion."""

UNDETERMINED = 1e9
"""Relative width from which an interval says nothing."""

_SAMPLES = 60_000
"""Samples that a round of the search may linearise, all hypotheses together."""
_ROUNDS = 3
_PARENTS = 6
_FINALISTS = 3
_SHRINK = 0.75


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A model that may be true, with its free parameters `names`; `name` is the effect it stands for, if any."""

    name: str
    model: Model
    names: tuple[str, ...]

    @property
    def p(self) -> Array:
        """The free parameters' numbers (P,)."""
        known = self.model.parameters
        return np.array([float(known[n].value) for n in self.names])

    @property
    def effect(self) -> Effect | None:
        """The effect it stands for; None where it stands for no effect."""
        return next((e for e in self.model.effects if e.name == self.name), None)

    @property
    def bare(self) -> Hypothesis:
        """The same numbers without the effect."""
        if self.effect is None:
            return self
        names = tuple(n for n in self.names if not n.startswith(f"{self.name}."))
        return Hypothesis("", self.model.without_effect(self.name), names)

    @property
    def motion(self) -> Model:
        """A model that moves alike: what a sensor makes of the motion is of second order where it is small."""
        return self.bare.model if isinstance(self.effect, OutputEffect) else self.model


class Normal(NamedTuple):
    """Normal equations of K logs: c (K,) = r'r, g (K, P) = S'r, F (K, P, P) = S'S, every rollout's start eliminated.

    Those of several rollouts played together are their sums.
    """

    c: Array
    g: Array
    F: Array

    @classmethod
    def of(cls, S_x: Array, S: Array, r: Array) -> Normal:
        """Of readings r (K, R) about a model with derivatives S_x (K, R, 2), S (K, R, P), whitened; one log a row."""
        both = without(np.linalg.qr(S_x)[0], np.concatenate([r[..., None], S], axis=-1))
        r, S = both[..., 0], both[..., 1:]
        S_t = np.swapaxes(S, -1, -2)
        return cls(np.sum(r * r, axis=-1), (S_t @ r[..., None])[..., 0], S_t @ S)

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

        For a small effect of size a it is a^2 |z_perp|^2 (1 - rho^2). Source: T-optimality, Atkinson and Fedorov,
        Biometrika 1975.
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
        model = hypotheses[0].model
        n, rest = round(limits.duration / model.dt), rest_angle(model)
        t, blank = np.asarray(model.dt * np.arange(n + 1), dtype=float), np.zeros(n + 1)
        angle = None if sensor.theta is None and sensor.theta_0 is None else blank if sensor.theta else blank[:1]
        speed = None if sensor.theta_dot is None else blank
        self.sensor = sensor
        self.records = [Record(t, s.torque(n, model.dt), angle, speed) for s in signals]
        self.starts = np.array([[rest + s.release, 0.0] for s in signals])
        self.responses = [self._response(h.motion, h.bare.names) for h in hypotheses]
        self._lins: dict[int, Linearisation] = {}
        self._directions: dict[int, Directions] = {}

    def _response(self, model: Model, names: Sequence[str]) -> Response:
        return Response(model, names, self.records, self.sensor, cut(self.records))

    def lin(self, h: int) -> Linearisation:
        """Of a hypothesis at its own numbers, those of its effect held; the residuals mean nothing."""
        if h not in self._lins:
            self._lins[h] = self.responses[h].linearise(self.hypotheses[h].bare.p, self.starts)
        return self._lins[h]

    @cached_property
    def states(self) -> Array:
        """The motions (H, K, N+1, 2) that the hypotheses foresee."""
        motions = []
        for i, (response, h) in enumerate(zip(self.responses, self.hypotheses, strict=True)):
            p = h.bare.p
            known = self._lins.get(i)
            motions.append(response.states(p, self.starts, response.drives(p)) if known is None else known.states)
        return np.array(motions)

    def stays(self, limits: Limits) -> NDArray[np.bool_]:
        """Whether all motions keep to the limits (K,)."""
        far, fast = np.max(np.abs(self.states - [rest_angle(self.hypotheses[0].model), 0.0]), axis=(0, 2)).T
        slack = 1.0 + 1e-6
        stays: NDArray[np.bool_] = np.isfinite(far + fast)
        for motion, limit in ((far, limits.theta_max), (fast, limits.theta_dot_max)):
            stays &= motion <= (math.inf if limit is None else slack * limit)
        return stays

    def calm(self) -> NDArray[np.bool_]:
        """Whether no motion that was linearised is so sensitive that a fit would lose its way (K,)."""
        weight = self.responses[0].weight.reshape(len(self.signals), -1)
        sd = np.divide(1.0, weight, out=np.zeros_like(weight), where=weight > 0.0)
        growth = [np.max(np.abs(lin.S_x) * sd[..., None], axis=(1, 2)) for lin in self._lins.values()]
        calm: NDArray[np.bool_] = np.max(growth, axis=0) <= LARGEST_GROWTH
        return calm

    def unlike(self, truth: int, rival: int) -> Normal:
        """What effect `truth` does to the readings, for the rival's effect and numbers to imitate.

        Both are put as changes of one step along the motion of the truth, and carried on from there to first order.
        """
        own = self.hypotheses[truth]
        assert own.effect is not None
        directions = self._about(truth)
        S = directions.lin.S_p
        other = self.hypotheses[rival].effect
        if other is not None:
            moves = [directions.response_to(e) for e in (other, *_varied(other))]
            S = np.concatenate([S, np.stack([moves[0], *(m - moves[0] for m in moves[1:])], axis=-1)], axis=-1)
        return Normal.of(directions.lin.S_x, S, directions.response_to(own.effect))

    def _about(self, truth: int) -> Directions:
        """Directions along the motion of a hypothesis, of its model without the effect."""
        if truth not in self._directions:
            bare = self.hypotheses[truth].bare
            response = self._response(bare.model, bare.names)
            lin = replace(self.lin(truth), drives=response.drives(bare.p))
            solution = Solution(bare.p, self.starts, lin, True)
            self._directions[truth] = Directions(Fit(response, solution, math.inf, bare.model))
        return self._directions[truth]


def _varied(effect: Effect) -> Iterator[Effect]:
    """The effect with each of its parameters a little off."""
    for name, p in effect.parameters.items():
        value, step = float(p.value), 1e-3 * p.scale
        yield effect.with_parameters({name: value + step if value + step <= p.bounds[1] else value - step})


class Foreseen(NamedTuple):
    """u (K, N) [N m], theta, theta_dot (K, N+1) [rad], [rad/s], and records of what perfect sensors show."""

    u: Array
    theta: Array
    theta_dot: Array
    records: list[Record]


def foresee(model: Model, signals: Sequence[Signal], limits: Limits, sensor: Sensor) -> Foreseen:
    """What a model does under the signals, from rest or from where it is released."""
    pool = Pool([Hypothesis("", model, ())], signals, limits, sensor)
    states, blank = pool.states[0], pool.records
    seen = pool.responses[0].readings(np.zeros(0), states)
    records = []
    for i, (r, (theta, theta_dot)) in enumerate(zip(blank, seen, strict=True)):
        angle = None if r.theta is None else theta[: len(r.theta)]
        records.append(Record(r.t, r.u, angle, None if r.theta_dot is None else theta_dot, name=f"rollout {i}"))
    return Foreseen(np.array([r.u for r in blank]), states[..., 0], states[..., 1], records)


def tamed(hypotheses: Sequence[Hypothesis], signals: Sequence[Signal], limits: Limits, sensor: Sensor) -> list[Signal]:
    """The signals, each made smaller until torque and predicted motion keep to the limits."""
    dt = hypotheses[0].model.dt
    found = [within(s, limits, round(limits.duration / dt), dt) for s in signals]
    if limits.theta_max is None and limits.theta_dot_max is None:
        return found
    waiting = list(range(len(found)))
    for _ in range(16):
        stays = Pool(hypotheses, [found[i] for i in waiting], limits, sensor).stays(limits)
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
        return [pool.unlike(truth, rival) for truth, rival in pairs]

    def value(normals: Parts) -> Array:
        least: Array = np.min([n.unexplained() for n in normals], axis=0)
        return least

    return Goal(parts, value)


def precision(scale: Array) -> Goal:
    """The widest interval in units of scale (P,), as a negative number; every rollout is played in each hypothesis.

    A log that does not determine a parameter is worth -UNDETERMINED.
    """

    def parts(pool: Pool) -> Parts:
        """The normal equations of all hypotheses' rollouts together."""
        lins = [pool.lin(h) for h in range(len(pool.hypotheses))]
        normals = [Normal.of(lin.S_x, lin.S_p, lin.e) for lin in lins]
        total = normals[0]
        for other in normals[1:]:
            total = total.plus(other)
        return [total]

    def value(normals: Parts) -> Array:
        widest: Array = np.max(normals[0].sd() / scale, axis=-1)
        return -np.minimum(widest, UNDETERMINED)

    return Goal(parts, value)


def yardsticks(model: Model, names: Sequence[str]) -> Array:
    """What a parameter's interval is compared with: its own size; for an effect that may be nothing, 0.01 at least."""
    known = model.parameters
    return np.array([max(p.scale, 0.0 if p.neutral is None else 0.01) for p in (known[n] for n in names)])


class Choice(NamedTuple):
    """Signals to play, one a rollout, and what they are worth to the goal."""

    signals: tuple[Signal, ...]
    value: float


def search(
    goal: Goal, hypotheses: Sequence[Hypothesis], limits: Limits, sensor: Sensor, rng: np.random.Generator
) -> list[Choice]:
    """A few good choices, each begun with a signal of another kind, best first; empty where nothing is allowed.

    Random signals of all kinds, then variations of the best; further rollouts are added one by one, always the one
    that helps most.
    """
    model = hypotheses[0].model
    n = round(limits.duration / model.dt)
    width = int(np.clip(_SAMPLES // (n * len(hypotheses)), 12, 96))
    swings = rest_angle(model) != 0.0
    signals = draw(rng, limits, model.dt, width, swings)
    best: list[Signal] = []
    for _ in range(_ROUNDS):
        fresh = tamed(hypotheses, signals, limits, sensor)
        pool = Pool(hypotheses, [*best, *fresh], limits, sensor)
        parts = goal.parts(pool)
        value = np.where(pool.calm() & pool.stays(limits), goal.value(parts), -np.inf)
        order = [int(k) for k in np.argsort(-value, kind="stable") if value[k] > -np.inf]
        if not order:
            signals = [s.smaller(0.3) for s in draw(rng, limits, model.dt, width, swings)]
            continue
        leaders = _leaders(pool.signals, order)
        best = [pool.signals[k] for k in dict.fromkeys([*leaders, *order[:_PARENTS]])]
        signals = [vary(best[i % len(best)], rng, limits, model.dt) for i in range(width - len(best))]
    if not best:
        return []
    choices = [_completed(goal, pool, parts, order, k, limits.rollouts) for k in leaders[:_FINALISTS]]
    return sorted(choices, key=lambda c: -c.value)


def _leaders(signals: Sequence[Signal], order: Sequence[int]) -> list[int]:
    """The best of each kind, best first."""
    first: dict[str, int] = {}
    for k in order:
        first.setdefault(signals[k].kind, k)
    return list(first.values())


def _completed(goal: Goal, pool: Pool, parts: Parts, allowed: Sequence[int], first: int, rollouts: int) -> Choice:
    chosen, total = [first], [p.at(first) for p in parts]
    for _ in range(rollouts - 1):
        value = goal.value([p.plus(t) for p, t in zip(parts, total, strict=True)])
        k = max(allowed, key=lambda i: float(value[i]))
        chosen.append(k)
        total = [t.plus(p.at(k)) for p, t in zip(parts, total, strict=True)]
    return Choice(tuple(pool.signals[k] for k in chosen), float(goal.value(total)[0]))
