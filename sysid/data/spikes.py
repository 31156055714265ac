"""Spikes: single readings that jump away and back, as no joint moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sysid.data.digitisation import quantisation_step
from sysid.physics.ops import Array

REACH = 3
"""Readings on either side from which the one between them is predicted."""
BEYOND = 12.0
"""Size of a spike, at least, in units of the typical error of such a prediction and of the step of rounding."""
SMALLEST = 0.01
"""Size of a spike, at least, as a share of the readings' spread: smaller ones bend no answer."""
ALONE = 5.0
"""Size of a spike, at least, in units of the largest such error nearby of which it is no part."""
AGREEMENT = 0.25
"""Share of a spike within which the predictions from its two sides agree."""


def spikes(y: Array) -> NDArray[np.bool_]:
    """Which readings (N+1,) jump away and back.

        before_k = y_k - 3 y_(k-1) + 3 y_(k-2) - y_(k-3),    after_k = y_k - 3 y_(k+1) + 3 y_(k+2) - y_(k+3)

    A reading is a spike where what it is off the parabolas through its three predecessors and its three successors is
    the same, and far more than nearby. A joint that is hit, or whose torque steps, leaves one of the two where it was.
    """
    found = np.zeros(len(y), dtype=bool)
    if len(y) < 4 * REACH:
        return found
    third = np.diff(y, REACH)
    known, read = third[np.isfinite(third)], y[np.isfinite(y)]
    if not len(known):
        return found
    typical = max(float(np.median(np.abs(known))) / 0.6745, quantisation_step([read]))
    least = max(BEYOND * typical, SMALLEST * float(np.std(read)))
    before, after = third[:-REACH], -third[REACH:]
    size = np.minimum(np.abs(before), np.abs(after))
    for k in np.flatnonzero((size > least) & (np.abs(before - after) < AGREEMENT * size)):
        clear = np.concatenate([third[max(k - 2 * REACH, 0) : k], third[k + REACH + 1 : k + 3 * REACH + 1]])
        found[k + REACH] = size[k] > ALONE * np.nanmax(np.abs(clear), initial=0.0)
    return found
