"""Computed columns: whether a logged speed or torque was computed from the readings, and carries their errors.

A drive without a tachometer differences its encoder, perhaps filters the result, and logs that as the speed: taken for
an independent reading, it would count every error twice. A digital controller computes its torque from readings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record
from sysid.physics.ops import Array

BEFORE = 24
"""How many readings of the angle before an instant its speed may be computed from."""
AFTER = 4
"""How many readings of the angle after it."""
OWN_SPEEDS = 2
"""How many speeds before it."""
FEWEST_SPEEDS = 80
"""Instants that the comparison of angle and speed needs."""
COMPUTED = 0.5
"""A speed was computed if the angle's errors leave less than this share of the variance of its error unexplained."""
OWN_TORQUES = 3
"""How many torques before an instant predict its torque."""
LATE = 3
"""How many readings before it a controller may use."""
FEWEST_TORQUES = 50
"""Instants that the comparison of torque and readings needs."""
MOST_TORQUES = 20_000
"""Instants that it uses at most."""
FOLLOWS = 0.25
"""A torque was computed if the readings leave less than this share of the variance of its innovations unexplained."""
LARGEST_INNOVATION = 3.3
"""Innovations beyond that many sd are steps of a controller's reference, which no reading explains."""


def unexplained(angle: Array, speed: Array, edges: NDArray[np.intp]) -> float:
    """The share of the speed's errors that the angle's errors do not explain: 1 for a tachometer, 0 for a difference.

        e_v[k] = sum_{i=1}^{2} a_i e_v[k-i]  +  sum_{j=-4}^{24} c_j e_theta[k-j]  +  rest

    It is the variance of the rest over that of the same regression without e_theta, and 1 where there is too little to
    compare. The regression covers differences, moving averages of up to 24 readings, and filters of first and second
    order behind them. angle and speed (n,) are the errors: what is left of both channels once one linear filter has
    taken out the motion. edges (R,) are where each record's part ends.
    """
    past_speeds, others, targets = [], [], []
    before = min(BEFORE, len(speed) // 12)  # fewer in a short log
    for first, last in pairwise((0, *edges)):
        x, y = angle[first:last], speed[first:last]
        k = np.arange(max(before, OWN_SPEEDS), len(x) - AFTER)
        if len(k) > 0:
            past_speeds.append(np.column_stack([y[k - i] for i in range(1, OWN_SPEEDS + 1)]))
            others.append(np.column_stack([x[k - j] for j in range(-AFTER, before + 1)]))
            targets.append(y[k])
    if sum(map(len, targets)) < FEWEST_SPEEDS:
        return 1.0
    past, b = np.concatenate(past_speeds), np.concatenate(targets)
    both = np.column_stack([past, np.concatenate(others)])
    alone, together = (float(np.sum(_rest(A, b) ** 2)) / (len(b) - A.shape[1]) for A in (past, both))
    return together / alone if alone > 0.0 else 1.0


def _rest(A: Array, b: Array, rows: Any = slice(None)) -> Array:
    """The residuals of b (n,) from a regression on the columns of A (n, c) that is fitted to some of the rows."""
    size = np.linalg.norm(A, axis=0)
    S = A / np.where(size > 0.0, size, 1.0)
    return b - S @ np.linalg.lstsq(S[rows], b[rows], rcond=1e-10)[0]


def is_difference(records: Sequence[Record]) -> bool:
    """Whether the speed is a difference of neighbouring angles, or the first-order filter of one, to the last digits.

        theta_dot[k] = c d[k] + (1 - c) d[k-1]   or   a theta_dot[k-1] + (1 - a) d[k-1],
        d[k] = (theta[k+1] - theta[k]) / dt,   0 <= a < 1

    A true speed differs from each of these by the angle's noise and by a difference's truncation error, which is at
    least dt^2 theta''' / 12. A tenth of the latter is allowed here. The test serves where there is no noise to compare.
    """
    gaps, parts, slopes, third = [], [], [], []
    for r in records:
        if r.theta is None or r.theta_dot is None or len(r.theta_dot) != len(r.theta) or len(r) < 4:
            return False
        d = np.diff(r.theta) / r.dt
        gaps.append((r.theta_dot - np.append(d, d[-1]))[1:-1] + (d[1:] - d[:-1]))  # theta_dot[k] - d[k-1]
        parts.append(d[1:] - d[:-1])
        slopes.append(r.theta_dot[:-2] - d[:-1])
        third.append(np.diff(r.theta, 3) / r.dt)
    gap, allowed = np.concatenate(gaps), 0.1 * _rms(np.concatenate(third)) / 12.0
    for column, low, high in ((np.concatenate(parts), -0.1, 1.1), (np.concatenate(slopes), -0.01, 0.99)):
        share = float(column @ gap) / max(float(column @ column), 1e-300)
        if low <= share <= high and _rms(gap - share * column) < allowed:
            return True
    return False


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def follows_readings(records: Sequence[Record]) -> bool:
    """Whether the torque carries the noise of the readings, as that of a digital controller does.

        u[k] = sum_{i=1}^{3} a_i u[k-i] + c  (+ sum_{j=0}^{3} b_j y[k-j])  + innovation

    A reading's noise moves only a torque that was computed from it. In an open loop the readings therefore explain
    nothing of a torque's innovations beyond its own past, in a closed one nearly all; three quarters are asked for.
    False where there is too little to compare.
    """
    past_torques, readings, targets, seen = [], [], [], 0
    for r in records:
        channels = [y for y in (r.theta, r.theta_dot) if y is not None and len(y) >= len(r)]
        k = np.arange(max(OWN_TORQUES, LATE), min(len(r), MOST_TORQUES - seen))
        if not channels or len(k) == 0:
            continue
        seen += len(k)
        past_torques.append(np.column_stack([np.ones(len(k)), *(r.u[k - i] for i in range(1, OWN_TORQUES + 1))]))
        readings.append(np.column_stack([y[k - j] - y.mean() for y in channels for j in range(LATE + 1)]))
        targets.append(r.u[k])
    if seen < FEWEST_TORQUES or len({a.shape[1] for a in readings}) > 1:
        return False
    A, Y, u = np.concatenate(past_torques), np.concatenate(readings), np.concatenate(targets)
    alone = _innovation(A, u)
    return alone > 1e-9 * float(np.std(u)) and _innovation(np.column_stack([A, Y]), u) ** 2 < FOLLOWS * alone**2


def _innovation(A: Array, u: Array) -> float:
    """The typical residual of u (n,) from a regression on the columns of A (n, c), without steps of a reference."""
    keep = np.ones(len(u), dtype=bool)
    for _ in range(4):
        rest = _rest(A, u, keep)
        typical = float(np.median(np.abs(rest))) / 0.6745
        keep = np.abs(rest) <= LARGEST_INNOVATION * typical
        if keep.sum() < FEWEST_TORQUES:
            break
    return typical
