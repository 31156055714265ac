"""Spikes: single readings, or two in a row, that jump away and back, as no joint moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sysid.data.digitisation import quantisation_step
from sysid.physics.ops import Array

REACH = 3
"""Readings on either side from which a reading is predicted."""
LONGEST = 2
"""Most readings in a row that jump away together."""
BEYOND = 12.0
"""Least size of a spike, in units of the typical error of such a prediction (of the quantisation step, if larger)."""
SMALLEST = 0.01
"""Least size of a spike, as a share of the readings' spread: smaller ones bend no answer."""
ALONE = 5.0
"""Least size of a spike, in units of the largest error of nearby predictions in which it takes no part."""
AGREEMENT = 0.25
"""Share of a spike within which the predictions from its two sides agree."""


def spikes(y: Array) -> NDArray[np.bool_]:
    """Which readings (N+1,) jump away and back.

        before_k = y_k - 3 y_(k-1) + 3 y_(k-2) - y_(k-3),    after_k = y_k - 3 y_(k+1) + 3 y_(k+2) - y_(k+3)

    A reading is a spike if it is as far off the parabola through its three predecessors as off that through its three
    successors, and far more than readings nearby. If a joint is hit, or its torque steps, one of the two still fits.
    Of two readings in a row, the first is compared with its predecessors and the last with its successors.
    At the ends of a log, where there is one side only, readings beyond the largest step by far are spikes: what a
    sensor shows before it is ready, for example.
    """
    is_spike = np.zeros(len(y), dtype=bool)
    if len(y) < 4 * REACH:
        return is_spike
    third = np.diff(y, REACH)
    known = third[np.isfinite(third)]
    if not len(known):
        return is_spike
    typical = max(float(np.median(np.abs(known))) / 0.6745, quantisation_step([y[np.isfinite(y)]]))
    least = max(BEYOND * typical, SMALLEST * float(np.nanstd(y)))
    for length in range(1, LONGEST + 1):
        end = REACH + length  # a run that difference k begins is k + REACH : k + end
        before, after = third[: 1 - end], -third[end - 1 :]
        size = np.minimum(np.abs(before), np.abs(after))
        for k in np.flatnonzero((size > least) & (np.abs(before - after) < AGREEMENT * size)):
            clear = np.concatenate([third[max(k - 2 * REACH, 0) : k], third[k + end : k + end + 2 * REACH]])
            if size[k] > ALONE * np.nanmax(np.abs(clear), initial=0.0):
                is_spike[k + REACH : k + end] = True
    read = np.flatnonzero(np.isfinite(y) & ~is_spike)
    if len(read) < 4 * REACH:
        return is_spike
    steps = np.abs(np.diff(y[read]))
    large = np.flatnonzero(steps > max(ALONE * np.max(steps[REACH:-REACH], initial=0.0), least))
    is_spike[read[: 1 + np.max(large[large < REACH], initial=-1)]] = True
    is_spike[read[1 + np.min(large[large >= REACH], initial=len(steps)) :]] = True
    return is_spike
