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
from sysid.data.sensor import Sensor
from sysid.physics.ops import Array

AROUND = 0.5
"""Seconds before and after a reading within which a joint at rest does not move; so long a rest becomes one reading."""
FEWEST_AROUND = 5
"""Samples that AROUND spans, at least."""
LARGEST_SCATTER = 1.5
"""Scatter of readings at rest, at most, in units of the noise's sd."""
CLEAR = 20.0
"""Scatter of all readings of a channel that tells rest from slow motion, at least, in units of the noise's sd."""
STEADY = 0.05
"""Scatter of a steady command, at most, as a share of that of the whole log."""


def readings_at_rest_merged(records: Sequence[Record], sensor: Sensor) -> list[tuple[Array, Array]]:
    """The readings of each record of a log, as `Sensor.readings` gives them, with those of half a second at rest merged
    into one at its beginning: before the first reading of a record its motion would be free.

    The merged reading is their mean; its sd is no smaller than quantisation allows.
    """
    read = [sensor.readings(r) for r in records]
    clear, rounded = np.zeros(2, dtype=bool), np.zeros(2)
    for channel in range(2):
        known = [np.isfinite(sds[:, channel]) for _, sds in read]
        values = [v[at, channel] for (v, _), at in zip(read, known, strict=True)]
        known_sds = [sds[at, channel] for (_, sds), at in zip(read, known, strict=True)]
        rounded[channel] = quantisation_step(values)
        if any(map(len, values)):
            clear[channel] = np.std(np.concatenate(values)) > CLEAR * np.median(np.concatenate(known_sds))
    least = STEADY * float(np.std(np.concatenate([r.u for r in records])))
    return [
        _means(values, sds, _representatives(values, sds, clear, record, least), rounded)
        for record, (values, sds) in zip(records, read, strict=True)
    ]


def _representatives(
    values: Array, sds: Array, clear: NDArray[np.bool_], record: Record, least: float
) -> NDArray[np.intp]:
    """The index (N+1,) of the sample that stands for each sample: itself or, at rest, the first one of half a second.

    At rest no channel that shows the motion clearly, and is read at all samples, scatters by more than its noise, and
    the command scatters by `least` at most. If only the speed is read, it is also zero.
    """
    half, at = max(FEWEST_AROUND, round(AROUND / record.dt)), np.arange(len(record) + 1)
    shows = clear & np.all(np.isfinite(sds), axis=0)
    if not np.any(shows) or len(at) <= 2 * half:
        return at
    still = _moments(np.append(record.u, record.u[-1]), half)[1] <= least
    for channel in np.flatnonzero(shows):
        sd = LARGEST_SCATTER * float(np.median(sds[:, channel]))
        level, scatter = _moments(values[:, channel], half)
        still &= (scatter < sd) & (shows[0] | (np.abs(level) < sd))
    for rest in np.split(at, np.flatnonzero(np.diff(still)) + 1):
        if still[rest[0]]:
            at[rest] = rest[0] + (rest - rest[0]) // half * half
    return at


def _moments(y: Array, half: int) -> tuple[Array, Array]:
    """The running mean and sd (K,) of y (K,), over `half` samples on either side."""
    at, middle = np.arange(len(y)), float(np.mean(y))
    first, last = np.maximum(at - half, 0), np.minimum(at + half + 1, len(y))
    sums = (np.append(0.0, np.cumsum(terms)) for terms in (y - middle, (y - middle) ** 2))
    mean, square = ((total[last] - total[first]) / (last - first) for total in sums)
    return mean + middle, np.sqrt(np.maximum(square - mean**2, 0.0))


def _means(values: Array, sds: Array, of: NDArray[np.intp], rounded: Array) -> tuple[Array, Array]:
    """The readings merged into the samples that stand for them, as means weighted by precision."""
    means, their_sds = np.zeros_like(values), np.full_like(sds, math.inf)
    for k, (value, precision) in enumerate(zip(values.T, sds.T**-2.0, strict=True)):
        sums = (np.bincount(of, weights, len(of)) for weights in (precision > 0.0, precision, precision * value))
        count, total, weighed = sums
        at = count > 0
        mean_sd, each_sd = total[at] ** -0.5, (count[at] / total[at]) ** 0.5
        means[at, k] = weighed[at] / total[at]
        their_sds[at, k] = np.maximum(mean_sd, np.minimum(each_sd, rounded[k] / math.sqrt(12.0)))
    return means, their_sds
