"""Flexible probes: torques of no particular physics, to see what something unknown depends on.

Each group is a set of smooth functions of one quantity (or two); with the catalogue they are one family of tests.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from sysid.diagnose.directions import Directions
from sysid.diagnose.screen import Test
from sysid.records import Array
from sysid.response import Index, Mask


@dataclass(frozen=True, eq=False)
class Dependence:
    """How much of the residual smooth torques of one quantity explain.

    depends_on  some of "theta", "theta_dot", "torque", "time", "history"
    share       of the residual sum of squares
    gain        decrease of the sum of squares, in units of s^2, less the logarithm of the sample size a function
    p_value     that nothing of it is there
    torque      (K, L) the torque [N m] that explains most, over each interval; what is not significant is shrunk
    """

    depends_on: tuple[str, ...]
    share: float
    gain: float
    p_value: float
    torque: Array


def dependences(directions: Directions, clusters: Index) -> dict[str, Dependence]:
    """Every group of flexible probes, tested about a fit; named by what it depends on, joined by "+"."""
    return {name: _tested(directions, clusters, name, basis) for name, basis in bases(directions).items()}


def _tested(directions: Directions, clusters: Index, name: str, torque: Array) -> Dependence:
    if torque.shape[-1] == 0:  # the quantity hardly varies
        return Dependence(tuple(name.split("+")), 0.0, 0.0, 1.0, np.zeros(torque.shape[:-1]))
    parts = [directions.of_torque(block) for block in directions.blocks(torque)]
    z, size = (np.concatenate([p[i] for p in parts], axis=-1) for i in (0, 1))
    test = Test.of(directions, z, size, clusters)
    explained = test.lm * directions.fit.variance
    total = max(float(directions.e @ directions.e), 1e-300)
    sizes, sd = np.array(test.sizes), np.array(test.sd)
    worth = np.maximum(0.0, 1.0 - (2.0 * sd / np.maximum(np.abs(sizes), 1e-300)) ** 2)
    return Dependence(
        depends_on=tuple(name.split("+")),
        share=max(0.0, explained / total - test.rank / directions.fit.degrees),
        gain=test.lm - test.rank * math.log(directions.fit.degrees),
        p_value=test.p_value if test.rank else 1.0,
        torque=torque @ (sizes * worth),
    )


def bases(directions: Directions) -> dict[str, Array]:
    """Torques (K, L, Q) [N m] of unit size, by what they depend on."""
    L = directions.response.length
    theta = 0.5 * (directions.theta[:, :L] + directions.theta[:, 1:])
    theta_dot = 0.5 * (directions.theta_dot[:, :L] + directions.theta_dot[:, 1:])
    scored = directions.response.scored
    angles = _angles(theta, scored, directions.model.plant.turns)
    moving = np.tanh(theta_dot / max(1e-6, 0.2 * float(np.std(theta_dot[scored]))))
    return {
        "theta": angles,
        "theta_dot": _splines(theta_dot, scored, 8),
        "theta+theta_dot": np.concatenate([angles, angles * moving[..., None], angles * theta_dot[..., None]], axis=-1),
        "torque": _splines(directions.drive, scored, 6),
        "time": _times(directions, scored),
        "history": _history(directions),
    }


def _splines(x: Array, scored: Mask, count: int) -> Array:
    """`count` cubic B-splines (..., count) over the range of x, knots at its quantiles; none where x hardly varies."""
    inside = x[scored] if np.any(scored) else x.ravel()
    low, high = float(np.min(inside)), float(np.max(inside))
    if high - low < 1e-9:
        return np.zeros((*x.shape, 0))
    inner = np.quantile(inside, np.linspace(0.0, 1.0, count - 2)[1:-1])
    edge = 1e-9 * (high - low)
    # quantiles may coincide where x rests
    inner = np.unique(np.clip(inner, low + edge, high - edge))
    knots = np.concatenate([[low - edge] * 4, inner, [high + edge] * 4])
    design = BSpline.design_matrix(np.clip(x.ravel(), low, high), knots, 3)
    values: Array = design.toarray().reshape(*x.shape, -1)
    return values


def _angles(theta: Array, scored: Mask, turns: bool) -> Array:
    """Splines over the angle: periodic where whole turns were made, else over the stretch that was seen."""
    inside = theta[scored]
    span = float(np.max(inside) - np.min(inside)) if inside.size else 0.0
    if span < 0.05:
        return np.zeros((*theta.shape, 0))
    count = int(np.clip(round(min(span, 2.0 * math.pi) / 0.3), 6, 20))
    if not turns or span < 2.0 * math.pi:
        return _splines(theta, scored, count)
    turn = np.mod(theta, 2.0 * math.pi)
    centres = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    apart = np.mod(turn[..., None] - centres + math.pi, 2.0 * math.pi) - math.pi
    width = 2.0 * math.pi / count
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(apart) / width))


def _times(directions: Directions, scored: Mask, seconds: float = 0.5, most: int = 96) -> Array:
    """Hats over the time of each record, `seconds` apart or wider."""
    response = directions.response
    records = response.records
    total = sum(len(r) * r.dt for r in records)
    width = max(seconds, total / most)
    columns = []
    for i, record in enumerate(records):
        t = response.time[:, :-1] + 0.5 * record.dt
        own = np.array([w.record == i for w in response.windows])[:, None] & scored
        count = max(2, round(len(record) * record.dt / width) + 1)
        for centre in np.linspace(record.t[0], record.t[-1], count):
            step = (record.t[-1] - record.t[0]) / (count - 1)
            columns.append(np.maximum(0.0, 1.0 - np.abs(t - centre) / step) * own)
    return np.stack(columns, axis=-1)


def _history(directions: Directions, lags: tuple[int, ...] = (-1, 1, 2, 4, 8, 16)) -> Array:
    """Commands of earlier intervals, which a missing state would remember, and of the next: a log stamped late."""
    response, L = directions.response, directions.response.length
    columns = []
    for lag in lags:
        column = np.zeros((len(response.windows), L))
        for i, w in enumerate(response.windows):
            record = response.records[w.record]
            at = len(record.past) + w.begin + np.arange(L) - lag
            column[i] = record.commands[np.clip(at, 0, len(record.commands) - 1)]
        columns.append(column)
    return np.stack(columns, axis=-1)
