"""Energy balance: what a free swing loses between one turning point and the next, against what its frictions take.

Between two turning points of a free swing the torque without friction does a certain work W, which the frictions take:

    W = integral of tau(theta) dtheta = integral of (friction torque against the motion) |theta_dot| dt + e

What depends on the angle alone, such as a pattern of the scale or a stiffening of the spring, does no net work over
whole swings. A random torque, which stands for it in a fit, does: beside one as large as such errors, the slow fall of
the amplitude would be a matter of chance, and the log would tell no friction from another. So the balance of every half
swing is read beside the angles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded

from sysid.estimation.linearisation import Samples
from sysid.physics.effects import Effect, effect
from sysid.physics.effects.effect import Stretch
from sysid.physics.model import Model
from sysid.physics.ops import Array

FRICTIONS = ("coulomb", "viscous", "drag")
"""Frictions of degree 0, 1 and 2 in the speed, which a fall of the amplitude can tell from each other."""
FEWEST = 6
"""Half swings, at least, of which a balance is made."""
SMALLEST_WAY = 0.03
"""A half swing counts if it goes this share of the furthest one's way."""
LEAST_SPEED = 0.03
"""A half swing counts if it reaches this share of the RMS speed."""
SHARED = (0.0, 0.5, 0.9, 0.99)
"""Shares of a turning point's error that go into both half swings beside it, with opposite signs."""
OUTLYING = 5.0
"""A half swing whose balance errs by more than so many standard deviations is left out: time was lost in it, say."""
PRICE = 2.0
"""Decrease of the deviance that a friction has to bring beyond the logarithm of the number of half swings."""
PLACES = 41
"""Places from one turning point to the next at which a torque is integrated."""
LEAST_TORQUE = 1e-3
"""Share of the torque at the turning points below which another model has none that brings the joint back."""
LEAST_VARIANCE = 1e-24
"""The variance [rad^2] of errors that are rounding."""
LARGEST_LOSS = 1e6
"""Losses [rad] beyond which a model runs away, and has no balance."""
ROBUST_SD = 1.4826
"""The sd of normal errors in units of their median absolute deviation."""


class HalfSwing(NamedTuple):
    """A motion from one turning point to the next, both included.

    theta, theta_dot, t (K,)   the motion [rad], [rad/s], and the time since its record began [s]
    intervals                  the samples' intervals that it goes through
    record                     the index of its record
    """

    theta: Array
    theta_dot: Array
    t: Array
    intervals: slice
    record: int


def half_swings(samples: Samples) -> list[HalfSwing]:
    """The half swings of all records along the smoothed readings, without those in which the joint hardly moves."""
    swings = [swing for record in range(len(samples.records)) for swing in _of_record(samples, record)]
    ways = [abs(swing.theta[-1] - swing.theta[0]) for swing in swings]
    return [swing for swing, way in zip(swings, ways, strict=True) if way > SMALLEST_WAY * max(ways)]


def _of_record(samples: Samples, record: int) -> Iterator[HalfSwing]:
    first, after = samples.first[record : record + 2].tolist()
    theta, theta_dot = samples.smoothed[first:after].T
    t, dt = samples.time_since_start[first:after], samples.dt
    least = LEAST_SPEED * math.sqrt(float(np.mean(theta_dot**2)))
    turns: list[tuple[int, float, float]] = []
    for i in np.flatnonzero(theta_dot[1:] * theta_dot[:-1] < 0.0).tolist():
        if turns and np.max(np.abs(theta_dot[turns[-1][0] : i + 2])) < least:
            continue
        share = theta_dot[i] / (theta_dot[i] - theta_dot[i + 1])
        turns.append((i, theta[i] + 0.5 * dt * share * theta_dot[i], t[i] + share * dt))
    for (i, from_angle, begin), (j, to_angle, end) in pairwise(turns):
        yield HalfSwing(
            np.concatenate([[from_angle], theta[i + 1 : j + 1], [to_angle]]),
            np.concatenate([[0.0], theta_dot[i + 1 : j + 1], [0.0]]),
            np.concatenate([[begin], t[i + 1 : j + 1], [end]]),
            slice(first + i, first + j + 1),
            record,
        )


class Work(NamedTuple):
    """What N half swings lose by a model's torque without friction.

    loss (N,)    W over the torque at the turning points: the errors of a loss are those of angles [rad]
    scale (N, 2) how the loss changes with the zero of the angle, and with a bend of its scale (an error that grows with
                 the square of the deflection, as a film's perspective makes)
    torque (N,)  RMS torque at the two turning points [N m]
    """

    loss: Array
    scale: Array
    torque: Array


class Path:
    """N half swings one after the other: theta, theta_dot, t (K,) along them, and `places` (N, PLACES) between their
    turning points. `adjacent` (N-1,) says which of them share a turning point with the next."""

    def __init__(self, samples: Samples, swings: Sequence[HalfSwing]) -> None:
        self.samples, self.swings = samples, swings
        self.theta, self.theta_dot, self.t = (np.concatenate([swing[i] for swing in swings]) for i in range(3))
        ends = np.cumsum([len(swing.t) for swing in swings])
        self.begins = np.concatenate([[0], ends[:-1]])
        self.steps = np.diff(self.t, append=0.0)
        self.steps[ends - 1] = 0.0
        self.places = np.array([np.linspace(swing.theta[0], swing.theta[-1], PLACES) for swing in swings])
        self.adjacent = np.array([a.record == b.record and a.t[-1] == b.t[0] for a, b in pairwise(swings)], dtype=bool)

    def __len__(self) -> int:
        return len(self.swings)

    def integral(self, rate: Array) -> Array:
        """The integral (N,) of a rate (K,) over the time of each half swing."""
        return np.add.reduceat(0.5 * (rate + np.append(rate[1:], 0.0)) * self.steps, self.begins)

    def work(self, model: Model, zero: float) -> Work:
        """The work of a model's torque without friction, where its sensor reads too large by `zero` [rad]."""
        theta = self.places - zero
        still = np.zeros_like(theta)
        t = still + self.t[self.begins][:, None]
        torque = model.inertia() * (still + model.acceleration(theta, still, t, still))
        done = np.sum(0.5 * (torque[:, 1:] + torque[:, :-1]) * np.diff(theta, axis=1), axis=1)
        at_turns = np.sqrt(0.5 * (torque[:, 0] ** 2 + torque[:, -1] ** 2))
        ends = theta[:, [0, -1]] - np.mean(theta)
        scale = np.stack([np.diff(torque[:, [0, -1]] * shift)[:, 0] for shift in (np.ones_like(ends), ends**2)], axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):  # of a model that nothing brings back
            return Work(done / at_turns, scale / at_turns[:, None], at_turns)

    def taken(self, model: Model, zero: float) -> Array:
        """What the frictions of a model take [J] along each half swing (N,), where its sensor reads too large by `zero`
        [rad]."""
        theta, speed, still = self.theta - zero, self.theta_dot, np.zeros_like(self.theta)
        forward, backward = model.deceleration(theta, speed, self.t, still)
        dry = np.where(speed > 0.0, forward, backward) * np.abs(speed)
        at_rest, moving = (model.acceleration(theta, velocity, self.t, still) for velocity in (still, speed))
        loss = self.integral(model.inertia() * (dry + (at_rest - moving) * speed))
        return loss - self._done_inside(model) if model.dynamic_effects else loss

    def _done_inside(self, model: Model) -> Array:
        """The work [J] of the effects that have states of their own, on the joint."""
        samples = self.samples
        speed = samples.smoothed[:, 1]
        stretch = Stretch(samples.dt, speed, np.append(speed[1:], 0.0), np.diff(samples.smoothed[:, 0], append=0.0))
        done = np.zeros(len(samples) + 1)
        for dynamic_effect in model.dynamic_effects:
            torque, _, _ = dynamic_effect.follow(tuple(samples.follow_smoothed([dynamic_effect])[0].T), stretch)
            done[1:] += np.cumsum(torque * stretch.travel)
        return np.array([done[swing.intervals.stop] - done[swing.intervals.start] for swing in self.swings])

    def zero(self, model: Model) -> float:
        """By how much the model's sensor reads too large, on average [rad]."""
        if not model.output_effects:
            return 0.0
        readings = self.samples.smoothed
        return float(np.mean((self.samples.read(model, readings) - readings)[:, 0]))


class _Balanced(NamedTuple):
    """A balance fitted with frictions of given shapes: its deviance, their sizes, the errors (N,), and the Cholesky
    factor of the covariance of the K that count: the diagonals L (2, K), since only neighbours share an error."""

    deviance: float
    sizes: list[float]
    errors: Array
    L: Array


@dataclass(frozen=True, eq=False)
class EnergyBalance:
    """The balances of N half swings of a log, of which K count, as readings of what frictions take.

    path         the half swings
    counts (N,)  which of them count
    L (2, K)     Cholesky factor of the covariance of their errors, by its diagonals
    scale (K, 2) orthonormal directions in which errors of the zero and of the scale move the whitened errors
    work         of the model for which the covariance was found
    frictions    those of FRICTIONS that explain the losses best, with their sizes
    """

    path: Path
    counts: NDArray[np.bool_]
    L: Array
    scale: Array
    work: Work
    frictions: tuple[Effect, ...]

    @classmethod
    def of(cls, samples: Samples, model: Model) -> EnergyBalance | None:
        """The balance of free swings whose angles were read; None with few half swings, or if nothing brings the joint
        back.

        The covariance and the half swings that count are found beside the likeliest frictions, whatever the model has.
        """
        applies = not samples.driven and samples.reads(0)
        swings = half_swings(samples) if applies else []
        if len(swings) < FEWEST:
            return None
        path = Path(samples, swings)
        work = path.work(model, path.zero(model))
        if not np.all(work.torque > 0.0):
            return None
        speed = np.abs(path.theta_dot)
        columns = np.column_stack([path.integral(speed**n) for n in (1, 2, 3)]) / work.torque[:, None]
        counts = np.ones(len(path), dtype=bool)
        for _ in range(3):
            errors = _balanced(path, work, columns, counts).errors
            off = np.abs(errors - np.median(errors[counts]))
            counts = off <= OUTLYING * ROBUST_SD * float(np.median(off[counts]))
        sets = [subset for n in (1, 2, 3) for subset in combinations(range(3), n)]
        fitted = {subset: _balanced(path, work, columns[:, subset], counts) for subset in sets}
        each = math.log(len(path)) + PRICE
        best = min(sets, key=lambda subset: fitted[subset].deviance + each * len(subset))
        scale, _ = np.linalg.qr(_whitened(fitted[best].L, work.scale[counts]))
        sizes = zip(best, fitted[best].sizes, strict=True)
        frictions = tuple(_with_size(FRICTIONS[k], size) for k, size in sizes if size > 0.0)
        return cls(path, counts, fitted[best].L, scale, work, frictions)

    def errors(self, model: Model) -> Array:
        """What the frictions of a model do not take of the losses (K,), in standard deviations, whatever the zero
        and the bend of its scale.

        A model that nothing brings back takes nothing: its errors are the losses that the balance was made of.
        """
        zero = self.path.zero(model)
        work = self.path.work(model, zero)
        left = work.loss - self.path.taken(model, zero) / work.torque
        if not (np.all(work.torque > LEAST_TORQUE * self.work.torque) and np.all(np.abs(left) < LARGEST_LOSS)):
            left = self.work.loss
        white = _whitened(self.L, left[self.counts])
        return white - self.scale @ (self.scale.T @ white)

    def deviance(self, model: Model) -> float:
        """-2 log likelihood of the balance, up to a constant. If the errors are larger than their standard deviations,
        these are scaled up to them."""
        errors = self.errors(model)
        square = float(np.mean(errors**2))
        return len(errors) * (1.0 + math.log(square) if square > 1.0 else square)

    def rows(self, model: Model, names: Sequence[str]) -> tuple[Array, Array]:
        """Sensitivities (K, P) and errors (K,) to append to those of the readings in a least-squares problem."""
        errors = self.errors(model)
        Z = np.zeros((len(errors), len(names)))
        for i, name in enumerate(names):
            p = model.parameters[name]
            value, (low, high) = float(p.value), p.bounds
            h = 1e-5 * max(abs(value), 1e-2 * min(high - low, 1.0))
            h = h if value + h <= high else -h
            Z[:, i] = (errors - self.errors(model.with_parameters({name: value + h}))) / h
        scale = math.sqrt(max(float(np.mean(errors**2)), 1.0))
        return Z / scale, errors / scale


def _with_size(name: str, size: float) -> Effect:
    """One of FRICTIONS with its one number."""
    (field,) = effect(name).parameters
    return effect(name, **{field: size})


def _whitened(L: Array, rows: Array) -> Array:
    """Rows (K, ...) divided by a Cholesky factor, of which the diagonals L (2, K) are given."""
    return solve_banded((1, 0), L, rows)


def _balanced(path: Path, work: Work, columns: Array, counts: NDArray[np.bool_]) -> _Balanced:
    """The likeliest balance with frictions that take `columns` (N, F) per size, over the shares of SHARED."""
    fits = [_balanced_with(path, work, columns, counts, shared) for shared in SHARED]
    return min(fits, key=lambda fit: fit.deviance)


def _balanced_with(path: Path, work: Work, columns: Array, counts: NDArray[np.bool_], shared: float) -> _Balanced:
    from scipy.optimize import nnls  # loads for a fifth of a second

    kept = np.flatnonzero(counts)
    adjacent = path.adjacent[kept[:-1]] & (np.diff(kept) == 1)
    L = cholesky_banded([np.ones(len(kept)), np.append(-0.5 * shared * adjacent, 0.0)], lower=True)
    every = np.column_stack([columns, work.scale, -work.scale])
    white, target = (_whitened(L, values[counts]) for values in (every, work.loss))
    numbers, _ = nnls(white, target)
    variance = max(float(np.mean((target - white @ numbers) ** 2)), LEAST_VARIANCE)
    deviance = len(target) * math.log(variance) + 2.0 * float(np.sum(np.log(L[0])))
    sizes, errors = numbers[: columns.shape[1]].tolist(), work.loss - every @ numbers
    sd = math.sqrt(variance * len(target) / max(len(target) - len(sizes) - 2, 1))
    return _Balanced(deviance, sizes, errors, sd * L)
