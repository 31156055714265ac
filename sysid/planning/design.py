"""Optimum experiment design: what the log of a signal would tell before it is played, and a search for the best."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.estimation.disturbances import NO_DISTURBANCE, Disturbances
from sysid.estimation.linearisation import Motion, Samples
from sysid.estimation.output_error import CHANNELS, Response
from sysid.estimation.prediction_error import Fit, with_likely_shared_error
from sysid.estimation.refits import continued
from sysid.estimation.solver import Settings, fit_parameters
from sysid.estimation.windows import cut
from sysid.physics.effects import Effect
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.plants import Plant
from sysid.planning.evidence import Normal, Sensitivities
from sysid.planning.excitation import Limits, Signal, random_signals, rest_angle, vary

KNOWN = Settings(sizes=False, vague=math.inf)
"""Settings of a fit beside disturbances that are known, without any prior knowledge of the parameters."""
ROUGHLY = Settings(iterations=12, settled=0.15, negligible=0.5)
"""Settings of the fits for planning: parameters to a share of their sd, disturbances to a few per cent."""
MISTOLD = 1.3
"""From this many times the noise that was told, fits are made anew with the noise that was found."""
FARTHEST = 1e4
"""A motion beyond this many [rad], [rad/s] has run away."""
LARGEST_GROWTH = 300.0
"""Growth of an initial error within a rollout, at most: beyond it motion is chaotic, and a fit loses its way."""
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
    def effect(self) -> Effect | None:
        """The effect it stands for; None where it stands for no effect."""
        return next((e for e in self.model.effects if e.name == self.name), None)


@dataclass(frozen=True)
class Conditions:
    """Conditions of an experiment: what the rig may do, the noise of its readings, and what else acts on it."""

    limits: Limits
    sensor: Sensor
    disturbances: Disturbances = NO_DISTURBANCE

    def louder(self, share: Mapping[str, float]) -> Conditions:
        """The same with the noise of each channel multiplied by its `share`."""
        sd = {name: getattr(self.sensor, name) for name in CHANNELS}
        louder = {n: None if v is None else share.get(n, 1.0) * v for n, v in sd.items()}
        return replace(self, sensor=Sensor(louder["theta"], louder["theta_dot"], self.sensor.jitter))

    def after(self, fits: Sequence[Fit]) -> Conditions:
        """The same with what the likeliest of some fits leaves unexplained, since that will be in the next log, too.

        It is a random torque and an angle error; or louder white noise, if that makes both needless for one of the
        fits.
        """
        ranked = sorted(fits, key=lambda fit: fit.deviance)
        if ranked[0].undisturbed:
            return self._with_noise_of(ranked[0])
        for fit in ranked:
            bare = continued(fit, NO_DISTURBANCE, KNOWN)
            louder = self._with_noise_of(bare)
            samples = Samples(fit.model, fit.samples.records, louder.sensor)
            if fit_parameters(samples, fit.model, fit.names, bare, fit.disturbances, ROUGHLY).undisturbed:
                return louder
        return replace(self, disturbances=with_likely_shared_error(ranked[0]))

    def _with_noise_of(self, fit: Fit) -> Conditions:
        """The same with at least the noise that a fit's innovations show without disturbances."""
        e, read = fit.linearised.system.filter(NO_DISTURBANCE).innovations, fit.samples.weight > 0.0
        at = {c: e[read[:, k], k] for k, c in enumerate(CHANNELS) if np.any(read[:, k])}
        return self.louder(
            {channel: max(1.0, float(np.sqrt(np.mean(innovations**2)))) for channel, innovations in at.items()}
        )

    def much_louder(self, other: Conditions) -> bool:
        """Whether a channel's noise is so much above that of other conditions that fits under those mislead."""
        pairs = ((getattr(self.sensor, c), getattr(other.sensor, c)) for c in CHANNELS)
        return any(sd is not None and sd > MISTOLD * other_sd for sd, other_sd in pairs)


class Pool:
    """Signals, each of one rollout, and what every hypothesis predicts for them."""

    def __init__(self, hypotheses: Sequence[Hypothesis], signals: Sequence[Signal], conditions: Conditions) -> None:
        self.hypotheses, self.signals, self.conditions = {h.name: h for h in hypotheses}, tuple(signals), conditions
        self.model, sensor = hypotheses[0].model, conditions.sensor
        n = round(conditions.limits.duration / self.model.dt)
        t, blank = np.asarray(self.model.dt * np.arange(n + 1), dtype=float), np.zeros(n + 1)
        angle, speed = (None if sd is None else blank for sd in (sensor.theta, sensor.theta_dot))
        self.rest = rest_angle(self.model)
        self.u = np.array([s.torque(n, self.model.dt) for s in signals])
        self.records = [Record(t, u, angle, speed, name=f"rollout {i}") for i, u in enumerate(self.u)]
        self._sensitivities: dict[str, Sensitivities] = {}
        self._followed: dict[str, Fit] = {}
        self._left: dict[tuple[str, str], float] = {}

    @cached_property
    def responses(self) -> dict[str, Response]:
        """The hypotheses as simulators of all rollouts at once."""
        windows = cut(self.records)
        return {name: Response(h.model, self.samples, windows) for name, h in self.hypotheses.items()}

    @cached_property
    def motions(self) -> dict[str, Array]:
        """The states (K, N+1, 2) that each hypothesis predicts, from rest or from where a rollout is released."""
        starts = np.array([[self.rest + s.release, 0.0] for s in self.signals])
        return {name: response.states(starts) for name, response in self.responses.items()}

    @property
    def states(self) -> Array:
        """The motions (H, K, N+1, 2) of all H hypotheses."""
        return np.array(list(self.motions.values()))

    def stays(self) -> NDArray[np.bool_]:
        """Whether the motions of all hypotheses keep to the limits (K,) or, where there are none, do not run away."""
        limits, slack = self.conditions.limits, 1.0 + 1e-6
        far, fast = np.max(np.abs(self.states - [self.rest, 0.0]), axis=(0, 2)).T
        return (far <= slack * (limits.theta_max or FARTHEST)) & (fast <= slack * (limits.theta_dot_max or FARTHEST))

    @cached_property
    def samples(self) -> Samples:
        """All rollouts, one record after the other."""
        return Samples(self.model, self.records, self.conditions.sensor)

    def sensitivities(self, name: str) -> Sensitivities:
        """The Sensitivities of a hypothesis, without its effect's parameters, along the motion that it predicts."""
        if name not in self._sensitivities:
            hypothesis, D, states = self.hypotheses[name], self.conditions.disturbances, self.motions[name]
            x = np.where(np.abs(states) <= FARTHEST, states, [self.rest, 0.0]).reshape(-1, 2)
            motion = Motion(x, np.zeros(len(x)), np.zeros((len(x), 3)))
            beside = tuple(
                n
                for n in hypothesis.names
                if hypothesis.effect is None or hypothesis.model.parameters[n].owner != hypothesis.name
            )
            self._sensitivities[name] = Sensitivities(
                self.samples, hypothesis.model, hypothesis.effect, motion, beside, D
            )
        return self._sensitivities[name]

    def calm(self) -> NDArray[np.bool_]:
        """Whether a signal's linearised motions let no initial error grow beyond what a fit can follow (K,)."""
        growth = [
            _growth(sensitivities.linearised.system.A, len(self.signals))
            for sensitivities in self._sensitivities.values()
        ]
        return np.max(growth, axis=0) <= LARGEST_GROWTH

    def unlike(self, truth: str, rival: str) -> Normal:
        """Normal equations for the rival's effect and numbers to imitate what effect `truth` does to the readings."""
        effect = self.hypotheses[truth].effect
        assert effect is not None
        return self.sensitivities(truth).unlike(effect, self.hypotheses[rival].effect, len(self.signals))

    def shown(self, name: str) -> list[Record]:
        """The records that perfect sensors would make if a hypothesis were true."""
        seen = self.responses[name].readings(self.motions[name])
        return [
            replace(r, theta=None if r.theta is None else theta, theta_dot=None if r.theta_dot is None else theta_dot)
            for r, (theta, theta_dot) in zip(self.records, seen, strict=True)
        ]

    def left(self, truth: str, rival: str) -> float:
        """The sum of squared innovations that a rival leaves when it is fitted in full to what the truth shows."""
        if (truth, rival) not in self._left:
            other, near, D = self.hypotheses[rival], self._follow(truth), self.conditions.disturbances
            fitted = fit_parameters(near.samples, other.model, other.names, near, D, KNOWN)
            self._left[truth, rival] = float(np.sum(fitted.e**2))
        return self._left[truth, rival]

    def _follow(self, truth: str) -> Fit:
        """The truth, fitted to the readings that it predicts itself: rivals are fitted to these from there."""
        if truth not in self._followed:
            model, conditions = self.hypotheses[truth].model, self.conditions
            samples = Samples(model, self.shown(truth), conditions.sensor)
            self._followed[truth] = fit_parameters(samples, model, (), None, conditions.disturbances, KNOWN)
        return self._followed[truth]

    def precision(self) -> Normal:
        """The normal equations of the free parameters for each rollout, summed over all hypotheses."""
        return reduce(Normal.plus, (self.sensitivities(n).precision(len(self.signals)) for n in self.hypotheses))


def _growth(A: Array, logs: int) -> Array:
    """The largest factor (K,) by which an error of the first state grows along each log; A (M, 2, 3)."""
    steps = np.swapaxes(A[:, :, :2].reshape(logs, -1, 2, 2), 0, 1)
    grown, largest = np.tile(np.eye(2), (logs, 1, 1)), np.ones(logs)
    for step in steps[:-1]:
        grown = step @ grown
        largest = np.maximum(largest, np.max(np.abs(grown), axis=(1, 2)))
    return largest


def within_limits(hypotheses: Sequence[Hypothesis], signals: Sequence[Signal], conditions: Conditions) -> list[Signal]:
    """The signals, each made smaller until torque and predicted motion keep to the limits."""
    limits = conditions.limits
    scaled = [replace(s, amplitude=min(s.amplitude, limits.u_max)) for s in signals]
    if limits.theta_max is None and limits.theta_dot_max is None:
        return scaled
    waiting = list(range(len(scaled)))
    for _ in range(16):
        stays = Pool(hypotheses, [scaled[i] for i in waiting], conditions).stays()
        waiting = [i for i, fine in zip(waiting, stays, strict=True) if not fine]
        if not waiting:
            break
        for i in waiting:
            scaled[i] = scaled[i].smaller(_SHRINK)
    return scaled


Parts = list[Normal]
"""The normal equations that a goal is made of; each is for all K signals of a pool."""


@dataclass(frozen=True, eq=False)
class Goal:
    """What signals are searched for: `parts` of a pool are summed over the rollouts, and `value` (K,) is maximised."""

    parts: Callable[[Pool], Parts]
    value: Callable[[Parts], Array]


def separation(pairs: Sequence[tuple[str, str]]) -> Goal:
    """The goal of telling hypotheses apart: the least evidence, over pairs (truth, rival), against the rival."""
    return Goal(
        lambda pool: [pool.unlike(truth, rival) for truth, rival in pairs],
        lambda parts: np.min([normal.unexplained() for normal in parts], axis=0),
    )


def precision(scale: Array) -> Goal:
    """The goal of narrow intervals: minus the widest, in units of scale (P,); each rollout is played in all hypotheses.

    A log that does not determine a parameter is worth -UNDETERMINED.
    """
    return Goal(
        lambda pool: [pool.precision()],
        lambda parts: -np.minimum(np.max(parts[0].sd() / scale, axis=-1), UNDETERMINED),
    )


def expected_cost(weight: Array, covariance: Array) -> Goal:
    """The goal of small errors e of the free parameters: minus their expected cost.

        E e'We = tr(W C'),   C' = (C^-1 + F)^-1

    with the weight W (P, P), the covariance C (P, P) before the log, and its Fisher information F. The design is
    linear-optimal (Atkinson and Fedorov, Optimum Experimental Designs).
    """
    value, vector = np.linalg.eigh(covariance)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    return Goal(
        lambda pool: [pool.precision()],
        lambda parts: (
            -np.trace(
                root.T @ weight @ root @ np.linalg.inv(np.eye(len(root)) + root.T @ parts[0].F @ root),
                axis1=-2,
                axis2=-1,
            )
        ),
    )


def yardsticks(model: Model, names: Sequence[str]) -> Array:
    """What the intervals (P,) of parameters are compared with (`Parameter.yardstick`)."""
    known = model.parameters
    return np.array([known[n].yardstick for n in names])


def search(
    goal: Goal, hypotheses: Sequence[Hypothesis], conditions: Conditions, rng: np.random.Generator
) -> list[Pool]:
    """A few good choices of signals, one for each rollout, best first; each choice begins with another kind of signal.

    Signals of all kinds are drawn at random, and the best are varied. Then rollouts are added one by one, always the
    one that helps most. Raises InvalidInput where no signal keeps to the limits.
    """
    model, limits = hypotheses[0].model, conditions.limits
    n = round(limits.duration / model.dt)
    width = int(np.clip(_SAMPLES // (n * len(hypotheses)), 12, 96))
    swings = rest_angle(model) != 0.0
    signals = random_signals(rng, limits, model.dt, width, swings)
    best: list[Signal] = []
    for _ in range(_ROUNDS):
        fresh = within_limits(hypotheses, signals, conditions)
        pool = Pool(hypotheses, [*best, *fresh], conditions)
        parts = goal.parts(pool)
        value = np.where(pool.calm() & pool.stays(), goal.value(parts), -np.inf)
        order = [int(k) for k in np.argsort(-value, kind="stable") if value[k] > -np.inf]
        if not order:
            signals = [s.smaller(0.3) for s in random_signals(rng, limits, model.dt, width, swings)]
            continue
        leaders = sorted({pool.signals[k].kind: k for k in reversed(order)}.values(), key=order.index)  # one a kind
        best = [pool.signals[k] for k in dict.fromkeys([*leaders, *order[:_PARENTS]])]
        signals = [vary(best[i % len(best)], rng, limits, model.dt) for i in range(width - len(best))]
    if not best:
        raise _impossible(limits, model.plant)
    choices = [_completed(goal, pool, parts, order, k, limits.rollouts) for k in leaders[:_FINALISTS]]
    choices.sort(key=lambda choice: -choice[0])
    return [Pool(hypotheses, signals, conditions) for _, signals in choices]


def _impossible(limits: Limits, plant: Plant) -> InvalidInput:
    bounds = {"N m": limits.u_max, "rad": limits.theta_max, "rad/s": limits.theta_dot_max}
    listed = ", ".join(f"{value:g} {plant.unit(unit)}" for unit, value in bounds.items() if value is not None)
    return InvalidInput(f"no signal keeps to the limits (at most {listed}): widen them")


def _completed(
    goal: Goal, pool: Pool, parts: Parts, allowed: Sequence[int], first: int, rollouts: int
) -> tuple[float, tuple[Signal, ...]]:
    """The value, and the signals, of the choice that begins with signal `first` and is completed greedily."""
    chosen, total = [first], [p.at(first) for p in parts]
    for _ in range(rollouts - 1):
        value = goal.value([p.plus(t) for p, t in zip(parts, total, strict=True)])
        k = max(allowed, key=lambda i: float(value[i]))
        chosen.append(k)
        total = [t.plus(p.at(k)) for p, t in zip(parts, total, strict=True)]
    return float(goal.value(total)[0]), tuple(pool.signals[k] for k in chosen)
