"""Touched stretches: where a torque acted that no state of the joint explains, a hand perhaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.records import Array

EXTREME = 8.0
"""Multiples of the median |d| of the log beyond which a torque is extreme."""
_NEIGHBOURS = 25
_APART = 0.5
"""Samples of the same motion lie within this time [s]; a state has come back when it is met again later or earlier."""
_PAUSE = 0.2
"""Shorter pauses [s] do not end a touch."""


@dataclass(frozen=True)
class Touched:
    """A stretch of a record, t_begin to t_end [s], in which an unexplained torque peaks at `peak` [N m]."""

    name: str
    t_begin: float
    t_end: float
    peak: float

    def __str__(self) -> str:
        return f"{self.name}, {self.t_begin:.1f}-{self.t_end:.1f} s ({self.peak:+.2g} N m)"


def touched(
    names: list[str], record: NDArray[np.intp], t: Array, states: Array, d: Array, sd: Array
) -> tuple[Touched, ...]:
    """Stretches where d is extreme, and is so too against what acted in the same state at other times.

    For intervals of a log: `record` (M,) numbers into names, t (M,) [s], states (M, 2) [rad], [rad/s], d and sd (M,)
    [N m]. Extreme is beyond 8 times the median |d| and beyond 4 sd; a magnet is extreme at one angle whenever the joint
    passes there, a hand only once. So the median d of the nearest states at other times is taken off first.
    """
    limit = np.maximum(EXTREME * np.median(np.abs(d)), 4.0 * sd)
    suspect = np.flatnonzero(np.abs(d) > limit)
    if len(suspect) == 0:
        return ()
    expected = _elsewhere(suspect, record, t, states, d)
    alone = suspect[(np.abs(d[suspect] - expected) > limit[suspect]) & (np.abs(expected) < 0.5 * np.abs(d[suspect]))]
    if len(alone) == 0:
        return ()
    wide = np.abs(d) > np.maximum(0.25 * limit, 2.0 * sd)
    dt = float(np.median(np.diff(t)))
    found = []
    for low, high in _stretches(alone, wide, record, t):
        own = d[low : high + 1]
        found.append(
            Touched(names[record[low]], float(t[low]), float(t[high]) + dt, float(own[np.argmax(np.abs(own))]))
        )
    return tuple(found)


def _elsewhere(at: NDArray[np.intp], record: NDArray[np.intp], t: Array, states: Array, d: Array) -> Array:
    """Median d of the nearest states met at other times, for the samples `at`."""
    from scipy.spatial import cKDTree

    speed = float(np.std(states[:, 1])) or 1.0
    points = np.column_stack([np.cos(states[:, 0]), np.sin(states[:, 0]), states[:, 1] / speed])
    clock = t + record * (np.max(t) - np.min(t) + 2.0 * _APART)
    own = int(np.ceil(2.0 * _APART / max(float(np.median(np.diff(t))), 1e-9))) + 1
    reach = min(len(d), _NEIGHBOURS + own)
    _, near = cKDTree(points).query(points[at], k=reach)
    near = near.reshape(len(at), reach)
    other = np.abs(clock[near] - clock[at][:, None]) > _APART
    other &= np.cumsum(other, axis=1) <= _NEIGHBOURS
    values = np.where(other, d[near], np.nan)
    values[~other.any(axis=1), 0] = 0.0
    return np.nanmedian(values, axis=1)


def _stretches(
    alone: NDArray[np.intp], wide: NDArray[np.bool_], record: NDArray[np.intp], t: Array
) -> list[tuple[int, int]]:
    """First and last interval of each touch: widened to where the torque has faded, pauses bridged."""
    spans: list[tuple[int, int]] = []
    for k in alone.tolist():
        if spans and k <= spans[-1][1]:
            continue
        low = high = k
        while low > 0 and wide[low - 1] and record[low - 1] == record[k]:
            low -= 1
        while high < len(t) - 1 and wide[high + 1] and record[high + 1] == record[k]:
            high += 1
        if spans and record[spans[-1][1]] == record[low] and t[low] - t[spans[-1][1]] < _PAUSE:
            spans[-1] = (spans[-1][0], high)
        else:
            spans.append((low, high))
    return spans
