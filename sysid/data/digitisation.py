"""Digitisation: the quantisation step of a sensor, and for how many rows a slow one repeats (holds) each reading.

A held reading that is taken for a fresh one is late by up to its age, and its staircase looks like no sensor's noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.physics.ops import Array

CANDIDATES = (0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.0)
"""Quantiles of the changes between readings that are tried as quantisation step, the largest first."""
FEWEST_JUMPS = 20
"""Jumps from which a holding is inferred, at least."""
REPEATED = 0.75
"""Share of all jumps before which a reading must have stood for two rows or more: where two clocks meet, some do."""
REGULAR = 0.85
"""Share of all jumps that must come at the sensor's interval, if readings are not rounded to steps."""
SMALLEST_JUMP = 2.5
"""A jump is a change by more quantisation steps: at such a speed a fresh sensor changes in every row."""


def quantisation_step(series: Sequence[Array]) -> float:
    """The quantisation step q, of which all changes between neighbouring readings are multiples; 0 where there is none.

    A candidate fits if nine in ten of the changes below 20 q are multiples of it to 5 % of q (if readings are not
    rounded, one in ten is); the largest that fits is taken.
    """
    size = np.abs(np.concatenate([np.diff(y) for y in series]))
    moved = size[size > 1e-9 * np.max(size, initial=0.0)]
    if len(moved) == 0:
        return 0.0
    for candidate in np.quantile(moved, CANDIDATES):
        q = float(candidate)
        for _ in range(2):
            near = size[(size > 0.5 * q) & (size < 20.5 * q)]
            steps = np.round(near / q)
            q = float(near @ steps) / float(steps @ steps)
        small = size[size < 20.5 * q]
        off = np.abs(small / q - np.round(small / q)) > 0.05
        if np.mean(off) < 0.1 and len(small) > 0.1 * len(size) and np.mean(size > 0.5 * q) > 0.02:
            return q
    return 0.0


def holding(series: Iterable[Array]) -> float:
    """For how many rows each reading of a channel (K,), one array for each rollout, is held; 4.5 if 4 and 5 take turns,
    and the median if it is any number.

    A slowly moving encoder repeats its readings too, but then it changes by one step. A channel is therefore held if
    most jumps of more than 2.5 steps come after two rows or more; otherwise the answer is 1: all are fresh. If no step
    is found, they have to come after the same number of rows, too, as a slow encoder's do not.
    """
    series = [values for values in series if len(values) > 2]
    if not series:
        return 1.0
    rests, jumps, readings = [], [], []
    for values in series:
        change = np.flatnonzero(np.diff(values) != 0.0) + 1
        rests.append(np.diff(change))
        jumps.append(np.abs(values[change[1:]] - values[change[1:] - 1]))
        readings.append(values[np.append(0, change)])
    step = quantisation_step(readings)
    length = np.concatenate(rests)[np.concatenate(jumps) > SMALLEST_JUMP * step]
    if len(length) < FEWEST_JUMPS or float(np.mean(length > 1)) < REPEATED:
        return 1.0
    typical = float(np.median(length))
    regular = np.abs(length - typical) <= max(1.0, 0.1 * typical)
    if float(np.mean(regular)) < REGULAR:
        return typical if step > 0.0 else 1.0
    return float(np.mean(length[regular]))


def fresh(values: Array, rows: float) -> NDArray[np.intp]:
    """The rows (n,) of fresh readings in a channel (K,) each of whose readings is held for `rows` rows.

    These are the rows at which the channel changes and, in longer rests (the same value came again), every `rows`-th.
    """
    changed = np.diff(values) != 0.0
    edges = np.concatenate(([0], np.flatnonzero(changed) + 1, [len(changed) + 1]))
    fresh_rows: list[int] = []
    for k, (first, last) in enumerate(pairwise(edges.tolist())):
        again = max(round((last - first) / rows), 1)
        if k == 0:  # counted from its end: when it came is unknown
            fresh_rows += [row for row in (last - round(rows * i) for i in range(again, 0, -1)) if row >= first]
        else:
            fresh_rows += [first + round(rows * i) for i in range(again)]
    return np.unique(np.array(fresh_rows, dtype=np.intp))


def changes_together(held: Array, other: Array) -> bool:
    """Whether four in five changes of `other` (K,) come in rows in which `held` (K,) changes."""
    first, second = np.diff(held) != 0.0, np.diff(other) != 0.0
    return bool(np.sum(first & second) >= 0.8 * np.sum(second))
