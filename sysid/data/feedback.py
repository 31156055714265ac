"""Feedback: whether a log's torque was computed from its own readings, noise and all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.data.record import Record
from sysid.physics.ops import Array

OWN, LATE = 3, 3
"""Torques before it that a torque is predicted from, and readings before it that a controller may have used."""
FOLLOWS = 0.25
"""Share of a torque's innovations that its readings may leave unexplained, where it was computed from them."""
FAR = 3.3
"""Innovations beyond that many sd are steps of a reference: no reading explains them."""
FEWEST = 50
MOST = 20_000


def follows_readings(records: Sequence[Record]) -> bool:
    """Whether the torque carries the noise of the readings, as that of a digital controller does.

        u[k] = sum_{i=1}^{3} a_i u[k-i] + c  (+ sum_{j=0}^{3} b_j y[k-j])  + innovation

    The noise of an instant's reading moves no torque but one that was computed from it. So in an open loop the readings
    tell nothing of a torque's innovations beyond its own past, and in a closed one nearly all: three quarters are asked
    for. False where there is too little to compare.
    """
    own, readings, targets, seen = [], [], [], 0
    for r in records:
        channels = [y for y in (r.theta, r.theta_dot) if y is not None and len(y) >= len(r)]
        k = np.arange(max(OWN, LATE), min(len(r), MOST - seen))
        if not channels or len(k) == 0:
            continue
        seen += len(k)
        own.append(np.column_stack([np.ones(len(k)), *(r.u[k - i] for i in range(1, OWN + 1))]))
        readings.append(np.column_stack([y[k - j] - y.mean() for y in channels for j in range(LATE + 1)]))
        targets.append(r.u[k])
    if seen < FEWEST or len({a.shape[1] for a in readings}) > 1:
        return False
    A, Y, u = np.concatenate(own), np.concatenate(readings), np.concatenate(targets)
    alone = _innovation(A, u)
    return alone > 1e-9 * float(np.std(u)) and _innovation(np.column_stack([A, Y]), u) ** 2 < FOLLOWS * alone**2


def _innovation(A: Array, u: Array) -> float:
    """The typical size of what a regression on the columns of A (n, c) leaves of u (n,), steps of a reference apart."""
    size = np.linalg.norm(A, axis=0)
    S, keep = A / np.where(size > 0.0, size, 1.0), np.ones(len(u), dtype=bool)
    for _ in range(4):
        left = u - S @ np.linalg.lstsq(S[keep], u[keep], rcond=1e-10)[0]
        typical = float(np.median(np.abs(left))) / 0.6745
        keep = np.abs(left) <= FAR * typical
        if keep.sum() < FEWEST:
            break
    return typical
