"""Rests: readings of a joint that stands still repeat each other, and are merged.

What a model lacks acts while a joint moves. If every reading at rest counted, it would count as evidence that nothing
acts, and the longer a log rests, the less its fitted dry friction would be that of the motion. Half a second at rest
under a steady command is therefore one reading, the mean. While the command changes, each reading says something new:
that the joint is held against that command, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.data.digitisation import quantisation_step
from sysid.data.record import Record
from sysid.data.sensor import UNITS, Readings, Sensor
from sysid.physics.ops import Array

AROUND = 0.5
"""Seconds before and after a reading within which a joint at rest does not move; so long a rest becomes one reading."""
FEWEST = 5
"""Samples that AROUND spans, at least."""
STILL = 1.5
"""Scatter of readings at rest, at most, in units of the noise's sd."""
CLEAR = 20.0
"""Scatter of all readings of a channel that tells rest from slow motion, at least, in units of the noise's sd."""
STEADY = 0.05
"""Scatter of a steady command, at most, as a share of that of the whole log."""


def readings_at_rest_merged(records: Sequence[Record], sensor: Sensor) -> list[list[Readings]]:
    """The readings of each record of a log, with those of half a second at rest merged into one in its middle.

    The merged reading is their mean; its sd is no smaller than quantisation allows.
    """
    read = [sensor.readings(r) for r in records]
    clear, rounded = set[str](), dict[str, float]()
    for channel in UNITS:
        own = [found for each in read for found in each if found.channel == channel]
        values = [found.value[np.isfinite(found.value)] for found in own]
        rounded[channel] = quantisation_step(values) if own else 0.0
        if own and np.std(np.concatenate(values)) > CLEAR * np.median(np.concatenate([found.sd for found in own])):
            clear.add(channel)
    least = STEADY * float(np.std(np.concatenate([r.u for r in records])))
    merged = []
    for record, found in zip(records, read, strict=True):
        of = _representatives([own for own in found if own.channel in clear], record, least)
        merged.append([_means(own, of, rounded[own.channel]) for own in found])
    return merged


def _representatives(found: Sequence[Readings], record: Record, least: float) -> NDArray[np.intp]:
    """The index (N+1,) of the sample that stands for each sample: itself or, at rest, the middle one of half a second.

    At rest no channel that shows the motion clearly, and is read at most samples, scatters by more than its noise, and
    the command scatters by `least` at most. If only the speed is read, it is also zero.
    """
    count = len(record) + 1
    half, at = max(FEWEST, round(AROUND / record.dt)), np.arange(count)
    channels = {own.channel: own for own in found if 2 * np.count_nonzero(np.isfinite(own.value)) > count}
    if not channels or count <= 2 * half:
        return at
    still = _moments(np.append(record.u, record.u[-1]), half)[1] <= least
    for own in channels.values():
        known = np.isfinite(own.value)
        sd = STILL * float(np.median(own.sd[known]))
        level, scatter = _moments(np.interp(at, own.index[known], own.value[known]), half)
        still &= (scatter < sd) & (("theta" in channels) | (np.abs(level) < sd))
    for rest in np.split(at, np.flatnonzero(np.diff(still)) + 1):
        if still[rest[0]]:
            at[rest] = np.minimum(rest[0] + (rest - rest[0]) // half * half + half // 2, rest[-1])
    return at


def _moments(y: Array, half: int) -> tuple[Array, Array]:
    """The running mean and sd (K,) of y (K,), over `half` samples on either side."""
    at, middle = np.arange(len(y)), float(np.mean(y))
    first, last = np.maximum(at - half, 0), np.minimum(at + half + 1, len(y))
    sums = (np.append(0.0, np.cumsum(own)) for own in (y - middle, (y - middle) ** 2))
    mean, square = ((total[last] - total[first]) / (last - first) for total in sums)
    return mean + middle, np.sqrt(np.maximum(square - mean**2, 0.0))


def _means(own: Readings, of: NDArray[np.intp], rounded: float) -> Readings:
    """The readings merged into the samples that stand for them, as means weighted by precision."""
    known = np.isfinite(own.value)
    to, precision = of[own.index[known]], own.sd[known] ** -2.0
    count, total, weighed = (np.bincount(to, w, len(of)) for w in (None, precision, precision * own.value[known]))
    index = np.flatnonzero(count)
    mean_sd, each_sd = total[index] ** -0.5, (count[index] / total[index]) ** 0.5
    sd = np.maximum(mean_sd, np.minimum(each_sd, rounded / math.sqrt(12.0)))
    return Readings(own.channel, index, weighed[index] / total[index], sd)
