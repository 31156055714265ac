"""Splitting: which parts of a log are held out, or left out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record
from sysid.errors import InvalidInput
from sysid.physics.ops import Array

MOST_STRETCHES = 3
"""Stretches that are held out of a single rollout, at most."""
MARGIN = 0.2
"""What is left out beside a stretch that is to be left out [s]."""
SHORTEST = 1.0
"""Pieces that are shorter [s] are dropped with it."""
SHORTEST_PART, LEAST_SHARE = 0.5, 0.2
"""A part that is shorter [s] stays with what it is by, and of a quick stroke one that is a smaller share of it."""
SHORTEST_LOG = 0.5
"""Seconds of log that are the least of which something is held out."""


def split(
    records: Sequence[Record], hold_out: float | None = None, shortest: float = 2.0
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Split a log into what is fitted and what is held out: by default one of every four rollouts.

    They are spread over the log, whose end is often another kind of motion. Of fewer than four rollouts (a single long
    log, say), or where those chosen are too short, a quarter of the time is held out instead, in one to three stretches
    that are spread over it. The parts share no interval, and are few, because a fit loses information with every free
    initial state. A part behind a cut knows the commands before it (delay, lag); where sensors remember, whoever scores
    it leaves a lead-in unscored.

    Parameters
    ----------
    records : sequence of Record
        At least one rollout.
    hold_out : float, optional
        A share in (0, 1), or a number (1, 2, ...): the last so many rollouts.
    shortest : float
        What is held out lasts at least that long [s], and a stretch of it half as long: a window to score.

    Returns
    -------
    training, held_out : tuple of Record
        No interval is in both.

    Raises
    ------
    InvalidInput
        Where nothing would be left on one side.
    """
    share = 0.25 if hold_out is None else float(hold_out)
    whole = hold_out is not None and share >= 1.0
    if not 0.0 < share < math.inf or (whole and share != int(share)):
        raise InvalidInput(f"hold_out = {hold_out}: expected a share between 0 and 1, or a number of rollouts")
    if whole and share >= len(records):
        raise InvalidInput(
            f"hold_out = {int(share)} of {len(records)} rollouts leaves none to fit: expected fewer, or a share"
        )
    if whole:
        return tuple(records[: -int(share)]), tuple(records[-int(share) :])
    return _divided(records, share, shortest, "held-out part")


def sample_of(records: Sequence[Record], most: int) -> tuple[Record, ...]:
    """At least three rollouts, or else stretches, spread over a log so that they hold about that many samples; all of
    it where it has no more."""
    share = most / max(sum(map(len, records)), 1)
    return tuple(records) if share >= 1.0 else _divided(records, share, 2.0, "searched part", MOST_STRETCHES)[1]


def _divided(
    records: Sequence[Record], share: float, shortest: float, name: str, fewest: int = 1
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """The rest of a log, and a share of it that is spread over it: whole rollouts, `fewest` and more, or stretches
    called by that name."""
    seconds = [len(r) * r.dt for r in records]
    total = sum(seconds)
    chosen = _spread(len(records), max(int(share * len(records) + 1e-9), 1))
    long = sum(seconds[k] for k in chosen) >= max(shortest, 0.5 * share * total)
    if len(records) >= 4 and len(chosen) >= fewest and long:
        rest = sorted(set(range(len(records))) - set(chosen))
        return tuple(records[k] for k in rest), tuple(records[k] for k in chosen)
    held = min(max(share * total, shortest), max(share, 0.5) * total)
    count = int(np.clip(held / (0.5 * shortest), 1, MOST_STRETCHES))
    middles, least = total * (np.arange(count) + 0.5) / count, min(SHORTEST_PART, LEAST_SHARE * total)
    pieces = [
        p
        for r, begin in zip(records, np.cumsum([0.0, *seconds]), strict=False)
        for p in _pieces(r, float(begin), middles, 0.5 * held / count, least, name)
    ]
    training, out = (tuple(p for p, held_out in pieces if held_out is side) for side in (False, True))
    if not training or not out or total < SHORTEST_LOG:
        raise InvalidInput(
            f"{total:.2g} s of log are too short to hold a part out: expected some seconds, and half a one at least"
        )
    return training, out


def _spread(n: int, count: int) -> list[int]:
    """One place of each of `count` groups of neighbours among n, in each another one: rollouts may alternate."""
    groups = np.array_split(np.arange(n), count)
    return [int(group[(len(group) // 2 + k) % len(group)]) for k, group in enumerate(groups)]


def _pieces(
    record: Record, begin: float, middles: Array, half: float, least: float, name: str
) -> Iterator[tuple[Record, bool]]:
    """A record that begins at `begin` [s] of all time, cut where stretches of half-length `half` [s] about `middles`,
    of that name, begin and end, and whether each piece is inside one; what is shorter than `least` [s] stays with what
    it is by."""
    middle = begin + record.dt * (np.arange(len(record)) + 0.5)
    inside = np.any(np.abs(middle[:, None] - middles) < half, axis=1)
    for first, last in _alike(inside):
        if (last - first) * record.dt < least:
            inside[first:last] = inside[first - 1] if first else inside[min(last, len(record) - 1)]
    if np.all(inside == inside[0]):
        yield record, bool(inside[0])
        return
    for k, (first, last) in enumerate(_alike(inside), start=1):
        what = name if inside[first] else "part"
        yield record.part(first, last, f"{record.name}, {what} {k}"), bool(inside[first])


def _alike(marks: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Where each run of equal marks (K,) begins and ends."""
    return pairwise([0, *(np.flatnonzero(np.diff(marks)) + 1).tolist(), len(marks)])


def leave_out(records: Sequence[Record], stretches: Iterable[tuple[str, float, float]]) -> tuple[Record, ...]:
    """The records without stretches (record's name, begin [s], end [s]); what lies between becomes rollouts."""
    stretches, kept = tuple(stretches), list[Record]()
    for record in records:
        n, acts = len(record), np.ones(len(record), dtype=bool)
        for name, begin, end in stretches:
            if name == record.name:
                acts &= (record.t[1:] < begin - MARGIN) | (record.t[:-1] > end + MARGIN)
        for first, last in _alike(acts):
            if acts[first] and (last - first == n or (last - first) * record.dt >= SHORTEST):
                kept.append(record.part(first, last))
    return tuple(kept)
