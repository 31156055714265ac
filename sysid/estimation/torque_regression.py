"""Torque regression: the equation of motion along smoothed readings, by least squares, which needs no first guess."""

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

SPAN = 0.2
"""Seconds over which the equation of motion is integrated: the noise of an acceleration would drown it."""
EXPLAINED, SHORTER = 0.5, (0.1, 0.05, 0.025)
"""Share of the changes of the speed that has to be explained so, or shorter times are tried: a quick step is over."""
QUARTER = 0.5 * math.pi
"""A quarter of a swing, as a multiple of sd theta / sd theta_dot: what swings faster is integrated over that."""
STANDS = 0.05
"""Share of the RMS speed below which a joint stands, and friction may be whatever holds it."""
MOST = 20_000
"""Samples that are looked at."""
SURELY = 3.0
"""Standard errors from which a number of the regression is no accident."""
ONE_SPEED = 0.2
"""Difference of the speeds of most of a motion in a direction, as a share, below which they are nearly one."""
WHOLLY = 0.99
"""Share of a span from which the joint moves in one direction over all of it."""
MADE_OF_FRICTION = 0.9
"""Share of a torque from which it is said to be friction and load: what else there is could be anything below."""


class IntegratedMotion(NamedTuple):
    """The equation of motion, integrated over N spans of the smoothed motion:

        theta_dot(t + T) - theta_dot(t) = integral of  G/J sin(theta) + tau/J - b theta_dot - c sign(theta_dot) + d

    columns (N, 5)   the integrals of sin(theta), of a linear axis theta, of tau, -theta_dot, -sign(theta_dot) and 1
    speed_change (N,)   the left-hand side [rad/s]
    slow                the speed [rad/s] below which the joint stands, beside that of all records
    """

    columns: Array
    speed_change: Array
    slow: float


def telling_motion(model: Model, records: Sequence[Record], sensor: Sensor) -> IntegratedMotion:
    """The terms of the equation of motion over T = 0.2 s, or where these explain little, over the shorter time that
    shows 1/J best."""
    terms = integrated_motion(model, records, sensor)
    if regression(terms.columns, terms.speed_change).share > EXPLAINED:
        return terms
    return max([terms, *(integrated_motion(model, records, sensor, T) for T in SHORTER)], key=_sureness)


def _sureness(terms: IntegratedMotion) -> float:
    """1/J over its standard error."""
    found = regression(terms.columns, terms.speed_change)
    return found.value[1] / found.sd[1] if found.sd[1] > 0.0 else -math.inf


def integrated_motion(
    model: Model, records: Sequence[Record], sensor: Sensor, seconds: float = SPAN, slow: float = 0.0
) -> IntegratedMotion:
    """The terms of the equation of motion over so many seconds, or over a quarter of a swing, where the joint moves:
    faster than `slow` [rad/s], and than a share of a record's own RMS speed; none of logs that are too short."""
    rows, targets, reach = [np.zeros((0, 5))], [np.zeros(0)], extent_of(records, model.plant.turns).reach
    parts = first_samples(records, MOST)
    smoothed = [smooth_states(part, sensor, reach).T for part in parts]
    for part, (theta, theta_dot) in zip(parts, smoothed, strict=True):
        swing = QUARTER * float(np.std(theta)) / max(float(np.std(theta_dot)), 1e-300)
        span = max(round(min(seconds, swing) / part.dt), 1)
        if len(part) < 4 * span:
            continue
        place, middle = 0.5 * (theta[1:] + theta[:-1]), 0.5 * (theta_dot[1:] + theta_dot[:-1])
        columns = (
            weight_along(model, place) if model.plant.turns else place,  # what does not turn may hang on a spring
            model.torque(place, middle, part.u),
            -middle,
            -np.sign(middle),
            np.ones(len(part)),
        )
        moves = (_sums(np.abs(middle) < max(slow, slow_speed([middle])), span) <= 0.5 * span)[::span]
        rows.append(np.column_stack([part.dt * _sums(c, span) for c in columns])[::span][moves])
        targets.append((theta_dot[span:] - theta_dot[:-span])[::span][moves])
    slow = slow_speed([theta_dot for _, theta_dot in smoothed])
    return IntegratedMotion(np.concatenate(rows), np.concatenate(targets), slow)


class Regression(NamedTuple):
    """Numbers (P,) by least squares, with their standard errors, and the share of the target's variance explained."""

    value: list[float]
    sd: list[float]
    share: float


def regression(columns: Array, target: Array) -> Regression:
    """Least squares of columns (N, P) on a target (N,); 0 +- 0 of what does not show."""
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
    """The friction, and the constant load, that a drive's torque is made of along a motion, with standard errors.

        tau = J theta_ddot - G sin(theta) + b theta_dot + tau_c sign(theta_dot) + d

    Where a controller follows a path closely, the torque follows from the motion and not the motion from the torque:
    friction shows, and an inertia that takes little of the torque does not. Beside a gravity that is not known, or on
    a linear axis, which may hang on a spring, the load is that in the middle of the motion. A motion in one direction
    cannot tell the load from dry friction: tau_c is both, beside gravity.

    Attributes
    ----------
    viscous, coulomb, load, inertia : tuple of float
        b [N m s/rad], tau_c [N m], d [N m] and J [kg m^2], and their standard errors.
    share : float
        The share of the torque that all terms together explain, of data that the regression has not seen: of its
        squares about the constant torque that explains most of what was seen.
    one_way, one_speed : bool
        Whether the joint moves in one direction only, and at nearly one speed in each direction: then tau_c is viscous
        friction, too.
    """

    viscous: tuple[float, float]
    coulomb: tuple[float, float]
    load: tuple[float, float]
    inertia: tuple[float, float]
    share: float
    one_way: bool = False
    one_speed: bool = False

    @property
    def shows_inertia(self) -> bool:
        """Whether the torque surely changes with the acceleration."""
        value, sd = self.inertia
        return value > SURELY * sd


def friction_along(
    model: Model, names: Sequence[str], records: Sequence[Record], unseen: Sequence[Record], sensor: Sensor
) -> FrictionAlong | None:
    """The friction along the motion of records; None where torque and motion do not show one, or where it explains
    little of the torque of unseen records. Gravity is found beside it where one of the `names` that are free tells
    it, else it is the model's."""
    slow = integrated_motion(model, records, sensor).slow
    motion = integrated_motion(model, records, sensor, slow=slow)
    unseen_motion = integrated_motion(model, unseen, sensor, slow=slow)
    one_way = _is_one_way(motion)
    columns, torque = _of_the_torque(model, names, motion, motion, one_way)
    found = regression(columns, torque)
    one_speed = _is_at_one_speed(motion) or not _shows_friction(found)
    if one_speed:
        columns[:, 0] = 0.0
        found = regression(columns, torque)
    level = regression(motion.columns[:, 4:], torque).value
    columns, torque = _of_the_torque(model, names, unseen_motion, motion, one_way)
    varies = float(np.sum((torque - unseen_motion.columns[:, 4:] @ level) ** 2))
    share = 1.0 - float(np.sum((torque - columns @ found.value) ** 2)) / varies if varies > 0.0 else 0.0
    if not (_shows_friction(found) and share > MADE_OF_FRICTION):
        return None
    viscous, coulomb, load, inertia, *_ = zip(found.value, found.sd, strict=True)
    return FrictionAlong(viscous, coulomb, load, inertia, share, one_way, one_speed)


def _shows_friction(found: Regression) -> bool:
    """Whether viscous or dry friction is surely there."""
    return max(number - SURELY * sd for number, sd in zip(found.value[:2], found.sd[:2], strict=True)) > 0.0


def _is_one_way(motion: IntegratedMotion) -> bool:
    """Whether the joint moves in the same direction over every span, or most of it."""
    direction = motion.columns[:, 3] / motion.columns[:, 4]
    return bool(np.all(direction > 0.5) or np.all(direction < -0.5))


def _is_at_one_speed(motion: IntegratedMotion) -> bool:
    """Whether the spans over which the joint moves in a direction, but for a tenth at either end, have nearly the same
    speed; that of the other direction may be another, which a load tells as well."""
    speed, direction = -motion.columns[:, 2:4].T / motion.columns[:, 4]
    ways = [np.abs(speed[way]) for way in (direction < -WHOLLY, direction > WHOLLY) if np.any(way)]
    ranges = [np.quantile(own, (0.1, 0.5, 0.9)) for own in ways]
    return bool(ranges) and all(high - low < ONE_SPEED * middle for low, middle, high in ranges)


def _of_the_torque(
    model: Model, names: Sequence[str], motion: IntegratedMotion, middle_of: IntegratedMotion, one_way: bool
) -> tuple[Array, Array]:
    """Columns (N, 4) or (N, 5) of speed, its sign, 1, acceleration and weight, and the torque (N,) that they make; of a
    motion in one direction its sign is the constant, and 1 says nothing more."""
    (weight, torque, less_speed, less_sign, one), plant = motion.columns.T, model.plant
    columns = [-less_speed, -less_sign, 0.0 * one if one_way else one, motion.speed_change]
    tells_gravity = {plant.gravity} if plant.gravity else set(plant.parameters)
    if plant.turns and tells_gravity.isdisjoint(names):
        torque = torque + float(plant.gravity_torque(0.5 * math.pi)) * weight
    elif plant.turns and one_way:
        columns.append(weight)
    else:
        middle = float(np.sum(middle_of.columns[:, 0])) / max(float(np.sum(middle_of.columns[:, 4])), 1e-300)
        columns.append(weight - middle * one)
    return np.column_stack(columns), torque


def slow_speed(theta_dot: Sequence[Array], share: float = STANDS) -> float:
    """The speed [rad/s] below which a joint stands: that share of the RMS of its speeds."""
    return share * math.sqrt(float(np.mean(np.concatenate(theta_dot) ** 2))) if theta_dot else 0.0


def weight_along(model: Model, theta: Array) -> Array:
    """The torque of gravity along theta, up to its size; none on what does not turn."""
    return np.sin(theta) if model.plant.turns else np.zeros_like(theta)


def _sums(column: Array | NDArray[np.bool_], span: int) -> Array:
    """Running sums over `span` intervals."""
    total = np.concatenate(([0.0], np.cumsum(column)))
    return total[span:] - total[:-span]
