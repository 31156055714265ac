"""Touched stretches: where a torque acted that no state of the joint explains, a hand perhaps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.records import Array

EXTREME = 6.0
"""Multiples of the median of what is not expected beyond which it is extreme: four sd of a Gaussian."""
HAND = 0.2
"""What acts for a shorter time [s] is vibration, no hand."""
_NEIGHBOURS = 25
_APART = 0.5
"""Samples within this time [s] belong to one motion; a state has come back when it is met later or earlier."""


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
    names: Sequence[str], record: NDArray[np.intp], t: Array, states: Array, d: Array, sd: Array, dt: float
) -> tuple[Touched, ...]:
    """Stretches where d is extreme against what acts in the same state at other times.

    For intervals of a log: `record` (M,) numbers into names, t (M,) [s], states (M, 2) [rad], [rad/s], d and sd (M,)
    [N m], without what is faster than a hand (`slow`). A magnet acts whenever the joint passes its angle, friction
    whenever it has a speed, a hand only once: so the median d at other times is expected, in the nearest states, at the
    nearest angles and at the nearest speeds; what differs from all three by more than 6 times the median of that, and
    by more than 4 sd, is a touch where it is rare too: beyond twice the 90 % quantile of |d|.
    """
    at = np.flatnonzero(np.isfinite(d))[:: max(1, round(0.25 * HAND / dt))]
    if len(at) < _NEIGHBOURS:
        return ()
    record, t, states, d, sd = record[at], t[at], states[at], d[at], sd[at]
    clock = t + record * (np.max(t) - np.min(t) + 2.0 * _APART)
    angle = np.column_stack([np.cos(states[:, 0]), np.sin(states[:, 0])])
    speed = states[:, 1:] / (np.std(states[:, 1]) or 1.0)
    expected = np.stack([_elsewhere(points, clock, d) for points in (np.hstack([angle, speed]), angle, speed)])
    size = np.min(np.abs(d - expected), axis=0)
    limit = np.maximum(EXTREME * np.median(size), 4.0 * sd)
    rare = np.abs(d) > 2.0 * np.quantile(np.abs(d), 0.9)
    alone = np.flatnonzero((size > limit) & rare)
    found = []
    for low, high in _stretches(alone, size > 0.25 * limit, record):
        own = d[low : high + 1]
        peak = float(own[np.argmax(np.abs(own))])
        found.append(Touched(names[record[low]], float(t[low]), float(t[high]) + 0.25 * HAND, peak))
    return tuple(found)


def slow(d: Array, record: NDArray[np.intp], dt: float) -> Array:
    """d (M,) without what is faster than a hand: averaged under a Hann window of 0.4 s, record by record.

    nan where the window would reach beyond the record.
    """
    from scipy.signal import fftconvolve

    half = max(1, round(HAND / dt))
    window = np.hanning(2 * half + 1)
    smooth = np.full_like(d, np.nan)
    for i in range(int(record[-1]) + 1):
        own = np.flatnonzero(record == i)
        if len(own) > 2 * half:
            smooth[own[half:-half]] = fftconvolve(d[own], window / window.sum(), "valid")
    return smooth


def _elsewhere(points: Array, clock: Array, d: Array) -> Array:
    """Median d of the nearest points (M, n) of other times, for each one; 0 where there is none."""
    from scipy.spatial import cKDTree

    own = int(2.0 * _APART / (0.25 * HAND)) + 2
    reach = min(len(d), _NEIGHBOURS + own)
    _, near = cKDTree(points).query(points, k=reach)
    other = np.abs(clock[near] - clock[:, None]) > _APART
    other &= np.cumsum(other, axis=1) <= _NEIGHBOURS
    values = np.where(other, d[near], np.nan)
    values[~other.any(axis=1), 0] = 0.0
    return np.asarray(np.nanmedian(values, axis=1))


def _stretches(alone: NDArray[np.intp], wide: NDArray[np.bool_], record: NDArray[np.intp]) -> list[tuple[int, int]]:
    """First and last sample of each touch, widened to where it has faded."""
    spans: list[tuple[int, int]] = []
    for k in alone.tolist():
        if spans and k <= spans[-1][1]:
            continue
        low = high = k
        while low > 0 and wide[low - 1] and record[low - 1] == record[k]:
            low -= 1
        while high < len(wide) - 1 and wide[high + 1] and record[high + 1] == record[k]:
            high += 1
        spans.append((low, high))
    return spans
