"""Rests: a joint that stands still is read again and again, and says each time what it said before.

What a model lacks acts while a joint moves. Each reading at rest would count as evidence that nothing acts, and for or
against whatever holds the joint: the longer a log rests, the less its dry friction would be that of the motion. So the
readings of half a second at rest are one reading, their mean.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from sysid.data.sensor import Readings
from sysid.physics.ops import Array

AROUND = 0.5
"""Seconds before and after a reading within which a joint at rest does not move; the readings of as long are one."""
FEWEST = 5
"""Samples that this is, at least."""
STILL = 1.5
"""Scatter of readings that noise alone explains, in units of its sd."""
CLEAR = 20.0
"""Scatter of all readings of a channel that tells a rest from slow motion, at least, in units of the noise's sd."""


def clear_channels(found: Iterable[Readings]) -> frozenset[str]:
    """The channels whose readings, of a whole log, scatter so much more than their noise that a rest is told from slow
    motion."""
    values: dict[str, list[Array]] = {}
    noise: dict[str, list[float]] = {}
    for own in found:
        known = np.isfinite(own.value)
        if np.any(known):
            values.setdefault(own.channel, []).append(own.value[known])
            noise.setdefault(own.channel, []).append(float(np.median(own.sd[known])))
    return frozenset(c for c, own in values.items() if np.std(np.concatenate(own)) > CLEAR * np.median(noise[c]))


def representatives(found: Iterable[Readings], clear: Collection[str], count: int, dt: float) -> NDArray[np.intp]:
    """The sample (count,) that stands for each: itself, or at rest the middle one of half a second.

    At rest no channel that shows the motion `clear`, at most samples, scatters by more than its noise; where that is
    the speed alone, it is zero, too.
    """
    half, at = max(FEWEST, round(AROUND / dt)), np.arange(count)
    most = (own for own in found if 2 * np.count_nonzero(np.isfinite(own.value)) > count)
    channels = {own.channel: own for own in most if own.channel in clear}
    if not channels or count <= 2 * half:
        return at
    still = np.ones(count, dtype=bool)
    for own in channels.values():
        known = np.isfinite(own.value)
        value, sd = np.interp(at, own.index[known], own.value[known]), float(np.median(own.sd[known]))
        level = uniform_filter1d(value, 2 * half + 1)
        scatter = uniform_filter1d((value - np.mean(value)) ** 2, 2 * half + 1) - (level - np.mean(value)) ** 2
        still &= scatter < (STILL * sd) ** 2
        if "theta" not in channels:
            still &= np.abs(level) < STILL * sd
    ends = np.append(np.flatnonzero(np.diff(still)) + 1, count)
    begin = 0
    of = at.copy()
    for end in ends.tolist():
        if still[begin]:
            for first in range(begin, end, half):
                last = min(first + half, end)
                of[first:last] = (first + last) // 2
        begin = end
    return of
