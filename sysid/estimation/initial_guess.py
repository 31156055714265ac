"""Initial guess: parameters of the plant near those of a log, by regression, so that the user's may be far off."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.estimation.torque_regression import (
    SURE_COEFFICIENT,
    IntegratedMotion,
    regression,
    telling_motion,
    weight_along,
)
from sysid.physics.effects.actuation import CoastingDrive, Saturation
from sysid.physics.model import Model
from sysid.physics.ops import Array

FEWEST_SERVO_SAMPLES = 40
"""Least number of samples of a record that show how a servo follows its command."""
SLOWEST = 3.0
"""Lowest natural frequency [rad/s] of a servo that is tried."""
FASTEST = 2.0
"""Highest natural frequency [rad per sample] of a servo that is tried."""
FREQUENCIES = 16
"""Number of natural frequencies that are tried."""
DAMPING_RATIOS = (0.3, 0.7, 1.5)
"""Damping ratios that are tried with each."""
WELL_EXPLAINED = 0.8
"""Explained share of the speed's changes from which an inertia of one standard error counts; and share of the torque
that goes into friction and weight from which the inertia is taken to be small."""
LITTLE = 0.1
"""Share of the torque that goes into accelerating an inertia which does not show beside friction."""
LIMITS = (0.7, 0.5, 0.35, 0.25, 0.18, 0.12, 0.08)
"""Limits of the drive that a regression tries, as shares of the largest command."""
LESS = 0.7
"""Share of the unexplained changes of the speed that may be left with such a limit, or with a drive that coasts, for it
to count."""
NEAREST_STEPS = 12
"""Gauss-Newton steps to the nearest parameters with the 1/J and G/J of a log."""
LARGEST_STEP = 5.0
"""Largest change of a parameter's logarithm in one of them."""


def initial_guess(model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor) -> Model:
    """The model with those of the plant's parameters that are in `names` moved near the log, to a few ten per cent.

    A regression (`torque_regression`) finds 1/J and G/J; then the parameters are moved to the nearest that have these.
    What the log does not show (no torque, no gravity) stays as it was. One exception is an inertia that does not show
    because friction and weight take nearly all of the torque: it is set to a small one.
    """
    terms = telling_motion(model, names, records, sensor)
    shown = shown_ratios(model, terms)
    if "1/J" not in shown:
        shown |= _least_inertia(terms)
    return _with_ratios(model, names, shown)


def _least_inertia(terms: IntegratedMotion) -> dict[str, float]:
    """The 1/J at which accelerating takes a tenth of the torque, if the torque varies and goes mostly into friction and
    weight; otherwise nothing."""
    if _is_constant(terms):
        return {}
    weight, torque, less_speed, less_sign, one = terms.columns.T
    if regression(np.column_stack([-less_speed, -less_sign, one, weight]), torque).share <= WELL_EXPLAINED:
        return {}
    return {"1/J": float(np.std(terms.speed_change) / (LITTLE * np.std(torque)))}


def _is_constant(terms: IntegratedMotion) -> bool:
    """Whether there is a torque, and it is constant but for rounding."""
    mean = terms.columns[:, 1] / terms.columns[:, 4]
    return len(mean) > 0 and bool(np.std(mean) < 1e-9 * abs(np.mean(mean)))


def initial_guesses(model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor) -> tuple[Model, ...]:
    """The models at which fits from far off begin: one by regression, and for a servo also one by its control loop. A
    servo may follow its command so closely that nothing is left to regress on."""
    regressed = initial_guess(model, names, records, sensor)
    if not model.at_angle:
        return (regressed,)
    return regressed, _matched_servo(model, names, records)


def limited_guess(model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor) -> Model | None:
    """The initial guess beside a limit of the drive far below the largest command; None if no limit explains the motion
    much better than none, or if the model has one."""
    if model.at_angle or not {Saturation.name, *Saturation.confused}.isdisjoint(model.effect_names):
        return None

    def limited(limit: float) -> list[Record]:
        return [replace(r, u=np.clip(r.u, -limit, limit)) for r in records]

    def unexplained(limit: float) -> float:
        terms = telling_motion(model, names, limited(limit), sensor)
        return 1.0 - regression(terms.columns, terms.speed_change).share

    largest = max(float(np.max(np.abs(r.u))) for r in records)
    if largest == 0.0:
        return None
    left = {limit: unexplained(limit) for limit in (largest, *(share * largest for share in LIMITS))}
    limit = min(left, key=left.__getitem__)
    if not left[limit] < LESS * left[largest]:
        return None
    return initial_guess(model, names, limited(limit), sensor).with_effect(Saturation(limit=limit))


def coasting_guess(model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor) -> Model | None:
    """The initial guess beside a back-EMF that acts only under a command; None if that does not explain the motion much
    better than friction at all times, or if the model has it."""
    if model.at_angle or any(isinstance(e, CoastingDrive) for e in model.effects):
        return None
    terms = telling_motion(model, names, records, sensor)
    result = regression(np.column_stack([terms.columns, terms.driven]), terms.speed_change)
    left, before = 1.0 - result.share, 1.0 - regression(terms.columns, terms.speed_change).share
    weight, torque, *_, driven = zip(result.value, result.sd, strict=True)
    sure = [value > SURE_COEFFICIENT * sd for value, sd in (weight, torque, driven)]
    if not (left < LESS * before and all(sure[1:])):
        return None
    shown = {"1/J": torque[0]} | ({"G/J": weight[0]} if model.plant.turns and sure[0] else {})
    guess = _with_ratios(model, names, shown)
    return guess.with_effect(CoastingDrive(k=driven[0] * float(guess.inertia())))


def _with_ratios(model: Model, names: Sequence[str], shown: Mapping[str, float]) -> Model:
    """The model with the plant's parameters that have this 1/J and G/J and are nearest to its own in logarithms."""
    moved = [name for name in names if name in model.plant.parameters]
    numbers = {name: float(model.plant.parameters[name].value) for name in moved}
    if not shown or not moved or not all(value > 0.0 for value in numbers.values()):
        return model

    def distances(scale: Array) -> Array:
        plant = model.plant.with_parameters(dict(zip(moved, _inside(model, moved, scale), strict=True)))
        J, G = float(plant.inertia()), float(plant.largest_gravity_torque)
        ratios = {"1/J": 1.0 / J, "G/J": G / J}
        off = [math.log(ratios[k] / shown[k]) if ratios[k] > 0.0 else 0.0 for k in shown]
        return np.array([*off, *(1e-3 * scale)])

    # 1/J and G/J are mostly products of powers, linear in logarithms: Gauss-Newton steps need no damping, and
    # scipy.optimize would take a third of a second to load
    scale = np.zeros(len(moved))
    for _ in range(NEAREST_STEPS):
        here = distances(scale)
        slopes = np.stack([(distances(scale + h) - here) / 1e-6 for h in 1e-6 * np.eye(len(moved))], axis=1)
        scale = scale - np.clip(np.linalg.lstsq(slopes, here, rcond=1e-12)[0], -LARGEST_STEP, LARGEST_STEP)
    return model.with_numbers(moved, _inside(model, moved, scale))


def _matched_servo(model: Model, names: Sequence[str], records: Sequence[Record]) -> Model:
    """The model of a servo with the natural frequency w and damping ratio z at which it follows its command best:

        theta_ddot = w^2 (u - theta) - 2 z w theta_dot,    w^2 = k_p / J,    2 z w = k_d / J,    G = k_p g

    A static load's deflection, g sin(theta) + offset, is taken out first. If the inertia is known, k_p follows from it.
    """
    servo = model.actuator
    read = [r for r in records if r.has_angles and len(r) >= FEWEST_SERVO_SAMPLES]
    if servo is None or not read:
        return model
    grid = itertools.product(np.geomspace(SLOWEST, FASTEST / model.dt, FREQUENCIES), DAMPING_RATIOS)
    # steps of dt have to be able to follow the faster mode of an overdamped loop, too
    slow = [(w, z) for w, z in grid if w * (z + math.sqrt(max(z * z - 1.0, 0.0))) <= FASTEST / model.dt]
    _, g, w, z = min((*_unexplained(model, read, w, z), w, z) for w, z in slow)
    stiffness = float(getattr(servo, servo.scale))
    moved = _with_ratios(model, names, {"1/J": w * w / stiffness} | ({"G/J": g * w * w} if g > 0.0 else {}))
    J = float(moved.inertia())
    numbers = {f"{servo.name}.{servo.scale}": J * w * w, f"{servo.name}.{servo.damping}": 2.0 * z * J * w}
    bounded = {n: float(np.clip(v, *moved.parameters[n].bounds)) for n, v in numbers.items() if n in names}
    return moved.with_parameters(bounded)


def _unexplained(model: Model, records: Sequence[Record], w: float, z: float) -> tuple[float, float]:
    """The RMS of the angles that a loop of natural frequency w and damping ratio z does not explain, and g."""
    from scipy.signal import cont2discrete, lfilter

    b, a, _ = cont2discrete(([w * w], [1.0, 2.0 * z * w, w * w]), records[0].dt)
    rest, loads = list[Array](), list[Array]()
    for r in records:
        theta = np.asarray(r.theta)[:-1]
        rest.append(theta - r.u[0] - lfilter(b.ravel(), a, r.u - r.u[0]))
        loads.append(np.column_stack([weight_along(model, theta), np.ones(len(r))]))
    A, e = np.concatenate(loads), np.concatenate(rest)
    coefficients = np.linalg.lstsq(A, e, rcond=1e-9)[0]
    return float(np.sqrt(np.mean((e - A @ coefficients) ** 2))), float(coefficients[0])


def _inside(model: Model, names: Sequence[str], scale: Array) -> list[float]:
    """The plant's own parameters times exp(scale), clipped to their bounds."""
    parameters = (model.plant.parameters[name] for name in names)
    return [
        float(np.clip(float(p.value) * math.exp(min(s, 50.0)), *p.bounds))
        for p, s in zip(parameters, scale, strict=True)
    ]


def shown_ratios(model: Model, terms: IntegratedMotion) -> dict[str, float]:
    """1/J [1/(kg m^2)] and G/J [1/s^2], each if it is positive and three standard errors from 0.

    One standard error is enough for 1/J where all terms together explain the changes of the speed well. A constant
    torque shows 1/J only if no offset acts beside it, so that the regression then has none.
    """
    result = regression(terms.columns[:, :4] if _is_constant(terms) else terms.columns, terms.speed_change)
    least = 1e-6 * float(np.linalg.norm(terms.speed_change))  # what moves the joint by less is rounding
    shown = {"1/J": 1} | ({"G/J": 0} if model.plant.turns else {})
    errors = {"1/J": 1.0 if result.share > WELL_EXPLAINED else 3.0, "G/J": 3.0}
    return {n: result.value[k] for n, k in shown.items() if result.value[k] > max(errors[n] * result.sd[k], least)}
