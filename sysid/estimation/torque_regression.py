"""Torque regression: the equation of motion fitted along smoothed readings by least squares, without a first guess."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record, extent_of, first_samples
from sysid.data.sensor import Sensor
from sysid.estimation.smoothed_start import smooth_states
from sysid.physics.model import Model
from sysid.physics.ops import Array

INTEGRATION_SPAN = 0.2
"""Seconds over which the equation of motion is integrated: unintegrated, it would drown in an acceleration's noise."""
EXPLAINED = 0.5
"""If that explains less than this share of the speed's changes, SHORTER times are tried, too."""
SHORTER = (0.1, 0.05, 0.025)
"""Seconds over which a log of quicker steps is integrated."""
STANDING_SPEED = 0.05
"""Share of the RMS speed below which a joint counts as standing; friction then may be whatever holds it."""
MOST_REGRESSED = 20_000
"""Most samples of a log that are used."""
SURE_COEFFICIENT = 3.0
"""Standard errors from 0 at which a coefficient of the regression is sure."""
TELLING_INERTIA = 5.0
"""Standard errors from 0 of an inertia that is told: a smoothed acceleration bends it more than they know."""
ONE_SPEED = 0.2
"""Relative spread below which the speeds in one direction (between their 10 % and 90 % quantiles) are nearly one."""
WHOLLY = 0.99
"""Share of a span from which the joint counts as moving in one direction over all of it."""
ROUNDING = 1e-18
"""A torque varies by no more than rounding if that is this share of its squares."""
MADE_OF_FRICTION = 0.9
"""Share of a torque that friction and load have to explain to be named: if it is less, the rest could be anything."""


class IntegratedMotion(NamedTuple):
    """The equation of motion, integrated over N spans of length T of the smoothed motion:

        theta_dot(t + T) - theta_dot(t) = integral of  G/J sin(theta) + tau/J - b theta_dot - c sign(theta_dot) + d

    columns (N, 5)     the integrals of sin(theta) (on a linear axis theta, for a spring in place of the weight), tau,
                       -theta_dot, -sign(theta_dot) and 1
    driven (N,)        the integral of -theta_dot where the command is not 0
    speed_change (N,)  the left-hand side [rad/s]
    slow               the speed [rad/s] below which the joint stands, from the RMS speed of all records together
    """

    columns: Array
    driven: Array
    speed_change: Array
    slow: float


def telling_motion(model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor) -> IntegratedMotion:
    """The integrated equation of motion over T = 0.2 s, or if its terms explain little, over the shorter T that shows
    1/J best."""
    terms = integrated_motion(model, names, records, sensor)
    if regression(terms.columns, terms.speed_change).share > EXPLAINED:
        return terms
    return max([terms, *(integrated_motion(model, names, records, sensor, T) for T in SHORTER)], key=_sureness)


def _sureness(terms: IntegratedMotion) -> float:
    """1/J divided by its standard error."""
    result = regression(terms.columns, terms.speed_change)
    return result.value[1] / result.sd[1] if result.sd[1] > 0.0 else -math.inf


def integrated_motion(
    model: Model,
    names: Sequence[str],
    records: Sequence[Record],
    sensor: Sensor,
    seconds: float = INTEGRATION_SPAN,
    slow: float = 0.0,
) -> IntegratedMotion:
    """The equation of motion, integrated over so many `seconds`, or over a radian of a swing if that is shorter.

    That time is sd theta / sd theta_dot, 1 / (2 pi) of a sine's period. A quarter would cut all periods at the
    same places, and spans of few kinds tell no friction from another.

    A gravity that none of the free `names` determines is part of tau: along a sine a free one is as good as an inertia.

    Spans count in which the joint moves faster than
    `slow` [rad/s] and than STANDING_SPEED of its record's RMS speed. A record shorter than four spans gives none.
    """
    rows, targets, reach = [np.zeros((0, 6))], [np.zeros(0)], extent_of(records, model.plant.turns).reach
    parts = first_samples(records, MOST_REGRESSED)
    smoothed = [smooth_states(part, sensor, reach).T for part in parts]
    for part, (theta, theta_dot) in zip(parts, smoothed, strict=True):
        radian = float(np.std(theta)) / max(float(np.std(theta_dot)), 1e-300)
        span = max(round(min(seconds, radian) / part.dt), 1)
        if len(part) < 4 * span:
            continue
        place, middle = 0.5 * (theta[1:] + theta[:-1]), 0.5 * (theta_dot[1:] + theta_dot[:-1])
        columns = (
            weight_along(model, place) if model.plant.turns else place,  # a linear axis may hang on a spring
            model.torque(place, middle, part.u),
            -middle,
            -np.sign(middle),
            np.ones(len(part)),
            -middle * (part.u != 0.0),
        )
        moves = (_sums(np.abs(middle) < max(slow, slow_speed([middle])), span) <= 0.5 * span)[::span]
        rows.append(np.column_stack([part.dt * _sums(c, span) for c in columns])[::span][moves])
        targets.append((theta_dot[span:] - theta_dot[:-span])[::span][moves])
    slow = slow_speed([theta_dot for _, theta_dot in smoothed])
    terms = np.concatenate(rows)
    if model.plant.turns and not frees_gravity(model, names):
        terms[:, 1] += float(model.plant.largest_gravity_torque) * terms[:, 0]
        terms[:, 0] = 0.0
    return IntegratedMotion(terms[:, :5], terms[:, 5], np.concatenate(targets), slow)


class Regression(NamedTuple):
    """Coefficients (P,) by least squares, their standard errors, and the explained share of the target's variance."""

    value: list[float]
    sd: list[float]
    share: float


def regression(columns: Array, target: Array) -> Regression:
    """Least squares of a target (N,) on columns (N, P); a column of zeros gets 0 +- 0."""
    size = np.linalg.norm(columns, axis=0)
    shown = size > 0.0
    size[~shown] = 1.0
    S = columns / size
    fit, _, rank, _ = np.linalg.lstsq(S, target, rcond=1e-6)
    fit = np.where(shown, fit, 0.0)
    left = target - S @ fit
    variance = float(np.sum(left**2)) / max(len(target) - int(rank), 1)
    sd = np.sqrt(variance * np.maximum(np.diag(np.linalg.pinv(S.T @ S, rcond=1e-12)), 0.0))
    total = float(np.sum((target - np.mean(target)) ** 2)) if len(target) else 0.0
    share = 1.0 - float(np.sum(left**2)) / total if total > 0.0 else 0.0
    return Regression((fit / size).tolist(), np.where(shown, sd / size, 0.0).tolist(), share)


@dataclass(frozen=True)
class FrictionAlong:
    """The friction and the constant load in a drive's torque along a motion, with standard errors.

        tau = J theta_ddot - G sin(theta) + b theta_dot + tau_c sign(theta_dot) + d

    Where a controller follows a path closely, the torque follows from the motion and not the motion from the torque.
    Friction shows then, but an inertia that takes little of the torque does not. If gravity is not known, or on a
    linear axis, which may hang on a spring, d is the load in the middle of the motion. A motion in one direction cannot
    tell the load from dry friction: tau_c is their sum, without gravity.

    Attributes
    ----------
    viscous, coulomb, load, inertia : tuple of float
        b [N m s/rad], tau_c [N m], d [N m] and J [kg m^2], and their standard errors.
    share : float
        The share that all terms together explain of the torque's squares in data that the regression has not seen,
        about the constant torque that fits the seen data best.
    one_way, one_speed : bool
        Whether the joint moves in one direction only; and whether at nearly one speed in each direction, so that tau_c
        includes viscous friction.
    """

    viscous: tuple[float, float]
    coulomb: tuple[float, float]
    load: tuple[float, float]
    inertia: tuple[float, float]
    share: float
    one_way: bool = False
    one_speed: bool = False

    @property
    def has_dry_friction(self) -> bool:
        """Whether there is surely a dry friction, or what a motion in one direction or at one speed takes for one."""
        value, sd = self.coulomb
        return value > SURE_COEFFICIENT * sd

    @property
    def shows_dry_friction(self) -> bool:
        """Whether there is surely a dry friction, which is neither a load nor a viscous one."""
        return self.has_dry_friction and not (self.one_way or self.one_speed)

    @property
    def shows_inertia(self) -> bool:
        """Whether the torque surely changes with the acceleration."""
        value, sd = self.inertia
        return value > SURE_COEFFICIENT * sd

    @property
    def tells_inertia(self) -> bool:
        """Whether the inertia is sure enough to be told: by TELLING_INERTIA, and in no motion at nearly one speed."""
        value, sd = self.inertia
        return value > TELLING_INERTIA * sd and not self.one_speed

    def contradicts(self, inertia: float, factor: float) -> bool:
        """Whether the torque surely shows another inertia than this one [kg m^2], by a factor."""
        return self.shows_inertia and abs(math.log(inertia / self.inertia[0])) > math.log(factor)


def friction_along(
    model: Model, names: Sequence[str], records: Sequence[Record], unseen: Sequence[Record], sensor: Sensor
) -> FrictionAlong | None:
    """The friction along the motion of records; None if no drive acts, if they show none, or if it explains little of
    the torque of unseen records.

    Gravity is fitted beside it if one of the free `names` determines it; else it is the model's. The damping of the
    drive, if that is free, counts as viscous friction: the command has to vary, not what is made of it.
    """
    if not any(r.driven for r in records):
        return None
    if model.damping in names:
        model = model.with_parameters({model.damping: 0.0})
    slow = integrated_motion(model, names, records, sensor).slow
    motion = integrated_motion(model, names, records, sensor, slow=slow)
    unseen_motion = integrated_motion(model, names, unseen, sensor, slow=slow)
    one_way = _is_one_way(motion)
    columns, torque = _of_the_torque(model, motion, motion, one_way)
    if regression(motion.columns[:, 3:], torque).share > 1.0 - math.sqrt(ROUNDING):
        return None  # a command of one size in each direction moves the joint, and tells no friction
    result = regression(columns, torque)
    one_speed = _is_at_one_speed(motion) or not _shows_friction(result)
    drives = result.value[1] < 0.0 and not one_way  # no dry friction does; a sum with a load may
    if one_speed or drives:
        columns[:, 0 if one_speed else 1] = 0.0
        result = regression(columns, torque)
    level = regression(motion.columns[:, 4:], torque).value
    columns, torque = _of_the_torque(model, unseen_motion, motion, one_way)
    varies = float(np.sum((torque - unseen_motion.columns[:, 4:] @ level) ** 2))
    constant = varies <= ROUNDING * float(np.sum(torque**2))
    share = 0.0 if constant else 1.0 - float(np.sum((torque - columns @ result.value) ** 2)) / varies
    if not (_shows_friction(result) and share > MADE_OF_FRICTION):
        return None
    viscous, coulomb, load, inertia, *_ = zip(result.value, result.sd, strict=True)
    return FrictionAlong(viscous, coulomb, load, inertia, share, one_way, one_speed)


def _shows_friction(result: Regression) -> bool:
    """Whether viscous or dry friction is surely there."""
    return max(number - SURE_COEFFICIENT * sd for number, sd in zip(result.value[:2], result.sd[:2], strict=True)) > 0.0


def _is_one_way(motion: IntegratedMotion) -> bool:
    """Whether the joint moves in the same direction over most of every span."""
    direction = motion.columns[:, 3] / motion.columns[:, 4]
    return bool(np.all(direction > 0.5) or np.all(direction < -0.5))


def _is_at_one_speed(motion: IntegratedMotion) -> bool:
    """Whether the spans in one direction, without the fastest and the slowest tenth, have nearly the same speed. The
    other direction may have another speed: a load would explain that as well as viscous friction."""
    speed, direction = -motion.columns[:, 2:4].T / motion.columns[:, 4]
    ways = [np.abs(speed[way]) for way in (direction < -WHOLLY, direction > WHOLLY) if np.any(way)]
    ranges = [np.quantile(speeds, (0.1, 0.5, 0.9)) for speeds in ways]
    return bool(ranges) and all(high - low < ONE_SPEED * middle for low, middle, high in ranges)


def _of_the_torque(
    model: Model, motion: IntegratedMotion, middle_of: IntegratedMotion, one_way: bool
) -> tuple[Array, Array]:
    """Columns (N, 5) of speed, its sign, 1, acceleration and weight, and the torque (N,) that they add up to.
    In a motion in one direction the sign is the constant, so that the column of 1 is set to 0."""
    weight, torque, less_speed, less_sign, one = motion.columns.T
    if not (model.plant.turns and one_way):
        middle = float(np.sum(middle_of.columns[:, 0])) / max(float(np.sum(middle_of.columns[:, 4])), 1e-300)
        weight = weight - middle * one
    constant = 0.0 * one if one_way else one
    return np.column_stack([-less_speed, -less_sign, constant, motion.speed_change, weight]), torque


def slow_speed(theta_dot: Sequence[Array], share: float = STANDING_SPEED) -> float:
    """The speed [rad/s] below which a joint stands: a `share` of its RMS speed."""
    return share * math.sqrt(float(np.mean(np.concatenate(theta_dot) ** 2))) if theta_dot else 0.0


def weight_along(model: Model, theta: Array) -> Array:
    """The torque of gravity along theta per unit of its size; 0 for a plant that does not turn."""
    return np.sin(theta) if model.plant.turns else np.zeros_like(theta)


def frees_gravity(model: Model, names: Sequence[str]) -> bool:
    """Whether one of the free `names` determines the size of gravity."""
    plant = model.plant
    return plant.turns and not ({plant.gravity} if plant.gravity else set(plant.parameters)).isdisjoint(names)


def _sums(column: Array | NDArray[np.bool_], span: int) -> Array:
    """Running sums over `span` intervals."""
    total = np.concatenate(([0.0], np.cumsum(column)))
    return total[span:] - total[:-span]
