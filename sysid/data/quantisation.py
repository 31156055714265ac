"""Quantisation: the step to which a sensor, or the file it was written to, rounds its readings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.physics.ops import Array

CANDIDATES = (0.5, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.0)
"""The quantiles of the changes between readings that are tried, the largest change first."""


def quantisation_step(series: Sequence[Array]) -> float:
    """The step q of which the changes between neighbouring readings are multiples; 0 where there is none.

    A candidate fits where nine in ten of the changes below 20 q are multiples of it to 5 %; the largest that fits is
    taken (changes of a reading that is not rounded would fit in one case in ten).
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
