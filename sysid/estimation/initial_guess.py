"""Initial guess: a plant's parameters near those of a log, by regression, so that a fit may begin far off."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.estimation.smoothed_start import smooth_states
from sysid.physics.model import Model
from sysid.physics.ops import Array

SPAN = 0.2
"""Seconds over which the equation of motion is integrated: the noise of an acceleration would drown it."""
MOST = 20_000
"""Samples that are looked at."""


def initial_guess(model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor) -> Model:
    """The model with those of the plant's parameters that are in `names` moved near the log.

        theta_dot(t + T) - theta_dot(t) = integral of  G/J sin(theta) + tau/J - b theta_dot - c sign(theta_dot) + d

    by least squares over smoothed states, T = 0.2 s; then the numbers nearest to the old ones with that 1/J and G/J.
    What the log does not show (no torque, no gravity) stays as it was. Good to a few ten per cent.
    """
    shown = _ratios(model, records, sensor)
    moved = [name for name in names if name in model.plant.parameters]
    own = {name: float(model.plant.parameters[name].value) for name in moved}
    if not shown or not moved or not all(value > 0.0 for value in own.values()):
        return model

    def distances(scale: Array) -> Array:
        plant = model.plant.with_parameters(dict(zip(moved, _inside(model, moved, scale), strict=True)))
        J, G = float(plant.inertia()), float(plant.gravity_torque(0.5 * math.pi))
        found = {"1/J": 1.0 / J, "G/J": G / J}
        off = [math.log(found[k] / shown[k]) if found[k] > 0.0 else 0.0 for k in shown]
        return np.array([*off, *(1e-3 * scale)])

    nearest = _least_squares(distances, np.zeros(len(moved)))
    return model.with_parameters(dict(zip(moved, _inside(model, moved, nearest), strict=True)))


def _least_squares(errors: Callable[[Array], Array], x: Array) -> Array:
    """The numbers (P,) with the smallest sum of squares of errors (R,), by Gauss-Newton steps from x, halved where they
    go too far: SciPy's would take a tenth of a second to load."""
    shifts = 1e-5 * np.eye(len(x))
    for _ in range(20):
        e = errors(x)
        slopes = np.array([errors(x + h) - errors(x - h) for h in shifts]).T / 2e-5
        step = np.linalg.lstsq(slopes, -e, rcond=None)[0]
        while np.sum(errors(x + step) ** 2) > np.sum(e**2):
            step *= 0.5
        x = x + step
        if np.max(np.abs(step)) < 1e-9:
            break
    return x


def _inside(model: Model, names: Sequence[str], scale: Array) -> list[float]:
    """The plant's own numbers times exp(scale), within their bounds."""
    parameters = (model.plant.parameters[name] for name in names)
    return [
        float(np.clip(float(p.value) * math.exp(min(s, 50.0)), *p.bounds))
        for p, s in zip(parameters, scale, strict=True)
    ]


def _ratios(model: Model, records: Sequence[Record], sensor: Sensor) -> dict[str, float]:
    """1/J [1/(kg m^2)] and G/J [1/s^2], where they are positive and three standard errors from 0."""
    rows, targets, seen = [], [], 0
    for record in records:
        if seen >= MOST:
            break
        part = record.head(MOST - seen)
        seen += len(part)
        span = max(round(SPAN / part.dt), 1)
        if len(part) < 4 * span:
            continue
        theta, theta_dot = smooth_states(part, sensor).T
        middle = 0.5 * (theta_dot[1:] + theta_dot[:-1])
        torque = model.torque(0.5 * (theta[1:] + theta[:-1]), middle, part.u)
        columns = (np.sin(0.5 * (theta[1:] + theta[:-1])), torque, -middle, -np.sign(middle), np.ones(len(part)))
        rows.append(np.column_stack([part.dt * _sums(c, span) for c in columns])[::span])
        targets.append((theta_dot[span:] - theta_dot[:-span])[::span])
    if not rows:
        return {}
    A, b = np.concatenate(rows), np.concatenate(targets)
    size = np.linalg.norm(A, axis=0)
    size[size == 0.0] = 1.0
    S = A / size
    fit, _, rank, _ = np.linalg.lstsq(S, b, rcond=1e-6)
    variance = float(np.sum((b - S @ fit) ** 2)) / max(len(b) - int(rank), 1)
    sd = np.sqrt(variance * np.maximum(np.diag(np.linalg.pinv(S.T @ S, rcond=1e-12)), 0.0))
    least = 1e-6 * float(np.linalg.norm(b))  # what moves the joint by less is rounding
    shown = {"1/J": 1, "G/J": 0}
    return {name: float(fit[k] / size[k]) for name, k in shown.items() if fit[k] > max(3.0 * sd[k], least)}


def _sums(column: Array, span: int) -> Array:
    """Running sums over `span` intervals."""
    total = np.concatenate(([0.0], np.cumsum(column)))
    return total[span:] - total[:-span]
