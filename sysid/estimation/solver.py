"""The solver finds parameters, motion and disturbances by maximum likelihood of the prediction errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.energy_balance import EnergyBalance
from sysid.estimation.kalman import Filter
from sysid.estimation.likelihood import likelihood_ascent
from sysid.estimation.linearisation import LinearisedModel, Samples, level, smoothed_motion
from sysid.estimation.prediction_error import Fit
from sysid.estimation.prior import Prior
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.parameters import Extent


@dataclass(frozen=True)
class Settings:
    """How the solver works. A step moves numbers and motion; its length is |Z step|, in standard deviations.

    iterations   most Gauss-Newton steps; each linearises the model about the motion that the step before found
    settled      a fit has converged after a step shorter than this that changes the deviance by less than `negligible`
    negligible   change of the deviance (-2 log likelihood) that no statistic would notice
    sizes        whether the sizes of the disturbances are fitted; otherwise they stay
    shared_error whether sigma_o and sigma_f, the sizes of the readings' shared errors, are fitted too
    vague        prior sd of a number of the plant, as a share of that number: where a random torque explains all, the
                 readings say nothing of an inertia, and it would run away
    least_share  smallest share of a step that is taken where steps go to and fro (`relaxation`)
    patience     number of steps after which at most half of each is taken, since a joint that sticks now and then may
                 go to and fro about an optimum for ever
    widest       largest half width of the finite differences that give the model's slopes: of the angle [rad], and of
                 speed and acceleration as shares of their sizes; wider ones would be the slopes of another machine
    wanders      length of a step below which a fit may go to and fro in the end: a joint that sticks now and then comes
                 to rest at one of the samples, and they are no denser. The fit is then the likeliest of these places
    """

    iterations: int = 40
    settled: float = 0.02
    negligible: float = 0.05
    least_share: float = 0.2
    patience: int = 12
    wanders: float = 0.5
    widest: tuple[float, float, float] = (0.05, 0.1, 0.5)
    sizes: bool = True
    shared_error: bool = True
    vague: float = 1.0


THOROUGH = Settings()

STRIDE = 0.7
"""Largest relative change of a number in a step: beyond it the model is far from linear."""
SMALLEST = 1e-5
"""A disturbance is 0 if smaller than this share of the motion's acceleration (s) or the sensor's sd."""
VAGUE_TORQUE = 10.0
"""Prior sd of an effect's torque, as a multiple of the largest torque that the log shows: no log of use feels it."""
ASTRAY = 0.1
"""A fit that has not converged and ends above its best by this deviance per reading has lost its way."""
CALM = 8
"""A fit that goes to and fro has ended after so many short steps in a row that gain nothing together."""
SETTLED_STEPS = 4
"""A fit has ended after so many settled steps in a row, although the deviance may still change where a joint sticks."""
QUICK = Settings(iterations=12, settled=0.15, negligible=0.5, shared_error=False)
"""Settings for a candidate that is only compared with others."""
HELD = replace(QUICK, sizes=False)
"""Settings for a motion, or a candidate, beside disturbances whose sizes stay."""


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # of models that run away, which have no likelihood
def fit_parameters(
    samples: Samples,
    model: Model,
    names: Sequence[str],
    near: Fit | None = None,
    disturbances: Disturbances | None = None,
    settings: Settings = THOROUGH,
    balance: EnergyBalance | None = None,
) -> Fit:
    """Find the likeliest parameters, beginning at the model's numbers.

    near           a fit whose motion, prior and disturbances this one begins with; by default the smoothed readings
    disturbances   where the sizes of the disturbances begin; their correlation times stay. By default those of `near`,
                   else large ones (`large_disturbances`)
    balance        the energy balance that is read beside the readings; by default that of `near`, if it has one
    """
    names = tuple(names)
    if disturbances is None:
        disturbances = near.disturbances if near else large_disturbances(samples)
    motion = (near.motion if near else smoothed_motion(samples, disturbances.s)).of_model(samples, model)
    known = (near.prior, near.names) if near else (None, ())
    if balance is None and near is not None:
        balance = near.balance
    extent = shown_extent(samples, model)
    prior = Prior.of(model, names, settings.vague, VAGUE_TORQUE * extent.u_max, *known)
    limits = _Limits.of(samples, model, names, prior, settings, extent)
    progress, converged, restless = _Progress(settings), False, settings.sizes
    best: Fit | None = None
    likeliest: Fit | None = None
    share, taken, last = 1.0, math.inf, np.zeros(len(names))
    for k in range(settings.iterations):
        linearised = LinearisedModel(samples, model, motion)
        here = linearised.system.filter(disturbances)
        if k > 0 and settings.sizes and (restless or k % 4 == 3):
            likelier = likelihood_ascent(here, limits.floor, settings.shared_error)
            restless = here.deviance - likelier.deviance > settings.negligible
            here, disturbances = likelier, likelier.disturbances
        if best is not None and not math.isfinite(here.deviance):
            return best
        G, R = linearised.changes(names)
        Z, now = here.whiten(G, R), model.numbers(names)
        fit = Fit(samples, linearised.model, names, linearised, here, Z, prior, False, balance)
        if not np.all(np.isfinite(Z)):  # the model runs away from the readings within a sample
            break
        beside = balance.rows(model, names) if balance and names else None
        step = _step(here, Z, prior, now, limits, beside)
        moved = float(np.linalg.norm(Z @ step)) if len(step) else 0.0
        step = limits.shortened(step, now)
        if progress.settles(k, moved, here.deviance, restless):
            return replace(fit, converged=True)
        if best is None or here.deviance < best.filter.deviance:
            best = fit
        if k >= settings.patience and (likeliest is None or here.deviance < likeliest.filter.deviance):
            likeliest = fit
        converged = progress.wanders(taken, here.deviance)
        if converged:
            break
        # slopes that go on changing with the filter's sd would never let friction's numbers settle
        spread = limits.spread(here) if k < settings.iterations // 4 else motion.spread
        to_and_fro = k > 1 and moved > settings.wanders
        share = max(settings.least_share, relaxation(share, Z @ last, Z @ step)) if to_and_fro else 1.0
        share, last = share if k < settings.patience else min(share, 0.5), step
        taken = share * moved
        motion = motion.moved(share * here.smooth(G @ step, R @ step), spread)
        numbers = limits.within(now + share * step)
        model = model.with_numbers(names, numbers.tolist())
    found = likeliest or fit
    if best is not None and not converged and found.filter.deviance > best.filter.deviance + ASTRAY * samples.readings:
        return best
    return replace(found, converged=converged)


@dataclass
class _Progress:
    """The progress of a fit: how many steps in a row were settled (`still`), and how many gained nothing (`calm`)."""

    settings: Settings
    before: float = math.inf
    lowest: float = math.inf
    still: int = 0
    calm: int = 0

    def settles(self, k: int, moved: float, deviance: float, restless: bool) -> bool:
        """Whether nothing changes any more at a place with this deviance, from which step k, of length `moved`, leads;
        `restless` says whether the sizes of the disturbances still change."""
        settings = self.settings
        self.still = self.still + 1 if moved < settings.settled and not restless else 0
        change, self.before = abs(deviance - self.before), deviance
        return self.still >= SETTLED_STEPS or (k >= 2 and self.still > 0 and change < settings.negligible)

    def wanders(self, taken: float, deviance: float) -> bool:
        """Whether a fit only goes to and fro, after a step of length `taken` to a place with this deviance."""
        if taken < self.settings.wanders and deviance > self.lowest - 1.0:
            self.calm += 1
        else:
            self.calm, self.lowest = 0, deviance
        return self.calm >= CALM


@dataclass(frozen=True, eq=False)
class _Limits:
    """How far the solver may go.

    low, high (P,)   bounds of the numbers; positive (P,): which of them may not be 0
    reach (P,)       change of each number beyond which its effect may be far from linear
    widest (3 + q,)  largest half widths of the slopes: [rad], [rad/s], [rad/s^2], and of the states of dynamic effects
    floor (3,)       logs of s, sigma_o and sigma_f below which the disturbances count as 0
    """

    low: Array
    high: Array
    positive: NDArray[np.bool_]
    reach: Array
    widest: Array
    floor: Array

    @classmethod
    def of(
        cls,
        samples: Samples,
        model: Model,
        names: Sequence[str],
        prior: Prior,
        settings: Settings,
        extent: Extent,
    ) -> _Limits:
        """The limits for a model on a log's samples, with the prior of its numbers."""
        size = level(samples)
        low, high = (np.array([model.parameters[n].bounds[side] for n in names]) for side in (0, 1))
        reach = np.array([_reach(model, n, typical, extent) for n, typical in zip(names, prior.mean, strict=True)])
        typical_speed = float(np.std(samples.smoothed[:, 1]))
        widest = np.array([*np.array(settings.widest) * [samples.reach, typical_speed, size], *model.inner_sd])
        floor = np.log(SMALLEST * np.array([size, *[max(_shared_sd(samples), 1e-12)] * 2]))
        return cls(low, high, prior.positive, reach, widest, floor)

    def within(self, values: Array) -> Array:
        """Numbers (P,) within their bounds."""
        return np.clip(values, self.low, self.high)

    def shortened(self, step: Array, now: Array) -> Array:
        """The step (P,) from `now`, shortened as a whole until no number moves further than is nearly linear."""
        # a positive number on its way down would be at its bound in two steps of its typical size
        longest = STRIDE * np.where(self.positive & (step < 0.0), now, np.maximum(self.reach, np.abs(now)))
        moves = step != 0.0
        return step * min([1.0, *(longest[moves] / np.abs(step[moves]))])

    def spread(self, filter: Filter) -> Array:
        """The half widths of the slopes (M, 3 + q): the filter's predicted sd, but at most `widest`. A filter knows
        less than a smoother; its sd is wide enough where a joint sticks."""
        return np.minimum(filter.sd[:, filter.system.driving], self.widest)


def _step(
    filter: Filter, Z: Array, prior: Prior, now: Array, limits: _Limits, beside: tuple[Array, Array] | None
) -> Array:
    """The Gauss-Newton step (P,) of the numbers, from the innovations, the prior and the rows of an energy balance."""
    parts = [(Z, filter.innovations.ravel()), prior.rows(now), *([beside] if beside else [])]
    rows, rest = (np.concatenate(pieces) for pieces in zip(*parts, strict=True))
    return bounded_step(rows, rest, limits.low - now, limits.high - now)


def bounded_step(Z: Array, e: Array, low: Array, high: Array) -> Array:
    """The step (P,) that minimises |e - Z step|^2 within low <= step <= high; what Z does not determine stays."""
    if Z.shape[1] == 0:
        return np.zeros(0)
    size = np.linalg.norm(Z, axis=0)
    moves = size > 0.0
    step = np.zeros(Z.shape[1])
    free = moves.copy()
    for _ in range(Z.shape[1] + 1):
        at = np.flatnonzero(free)
        if not len(at):
            break
        rest = e - Z @ np.where(free, 0.0, step)
        scaled = Z[:, at] / size[at]
        step[at] = np.linalg.lstsq(scaled, rest, rcond=1e-6)[0] / size[at]
        outside = free & ((step < low) | (step > high))
        if not np.any(outside):
            break
        step = np.where(outside, np.clip(step, low, high), step)
        free &= ~outside
    return np.clip(step, low, high)


def relaxation(share: float, before: Array, now: Array) -> float:
    """The share of the step `now` to take, after a `share` of the step `before`; both in standard deviations.

    Where a step turns back by at least half of the one before, whole steps would go to and fro about an optimum. Then
    Aitken's dynamic relaxation says which share leads there (Kuettler, Wall, Computational Mechanics 43 (2008) 61,
    eq. 44):  -share before' (now - before) / |now - before|^2,  but at most 1.
    """
    if before @ now > -0.5 * before @ before:
        return 1.0
    change = now - before
    return min(1.0, -share * float(before @ change) / float(change @ change))


def large_disturbances(samples: Samples) -> Disturbances:
    """Disturbances so large that a fit beside them is nearly a regression and finds its way from far off."""
    return Disturbances(0.3 * level(samples), sigma_o=_shared_sd(samples))


def shown_extent(samples: Samples, model: Model) -> Extent:
    """The extent of a log; u_max is the largest torque that it shows: the drive's, or inertia times acceleration."""
    extent = samples.extent(model)
    return extent._replace(u_max=max(extent.u_max, float(model.inertia()) * level(samples)))


def _shared_sd(samples: Samples) -> float:
    """The sd of the readings whose neighbours may share an error; 0 if at most half of the instants with a reading
    have one, such as a known start alone."""
    channel = samples.error_channel
    return float(1.0 / np.max(samples.weight[:, channel])) if samples.reads(channel) else 0.0


def _reach(model: Model, name: str, typical: float, extent: Extent) -> float:
    """The change of a number beyond which its effect may be far from linear. It is inf for an effect's number without
    an upper bound, such as a friction: the motion is linear enough in it."""
    p = model.parameters[name]
    if name not in model.plant.parameters and math.isinf(p.bounds[1]):
        return math.inf
    least = 0.0 if name in model.plant.parameters else 0.1 * min(p.bounds[1] - p.bounds[0], p.large(extent))
    return max(abs(typical), least) or p.scale
