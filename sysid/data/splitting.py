"""Splitting: which parts of a log are held out, or left out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record, tuple_of_records
from sysid.errors import InvalidInput, is_real
from sysid.physics.ops import Array

MOST_STRETCHES = 3
"""Stretches that are held out of a single rollout, at most."""
MARGIN = 0.2
"""Seconds that are left out before and behind a stretch that is left out."""
SHORTEST_PIECE = 1.0
"""Pieces between such stretches that are shorter [s] are left out too."""
SHORTEST_PART = 0.5
"""Parts that are shorter [s] are merged with a neighbour."""
SMALLEST_PART = 0.2
"""Share of the log that takes the place of SHORTEST_PART where it is less."""
SHORTEST_LOG = 0.5
"""Seconds of the shortest log of which a part is held out."""
SHORTEST_HELD_OUT = 2.0
"""Seconds that are held out, at least; a stretch of them is at least half as long, a window to score."""


def split(records: Sequence[Record], hold_out: float | None = None) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Split a log into what is fitted and what is held out: by default one of every four rollouts.

    The held-out rollouts are spread over the log, whose end is often another kind of motion. If there are fewer than
    four (a single long log, say), or the chosen ones are too short, a quarter of the time is held out instead, in one
    to three stretches spread over the log. There are few of them, because a fit loses information with every free
    initial state. Of rollouts that are too short to be cut, at most half are held out whole. A part behind a cut knows
    the commands before it (for delays and lags); if sensors have a memory, a lead-in is not scored.

    Parameters
    ----------
    records : sequence of Record
        At least one rollout.
    hold_out : float, optional
        A share in (0, 1), or a number n = 1, 2, ...: the last n rollouts.

    Returns
    -------
    training, held_out : tuple of Record
        No interval is in both.

    Raises
    ------
    InvalidInput
        Where nothing would be left on one side.
    """
    records, share = tuple_of_records(records), 0.25 if hold_out is None else hold_out
    if not (is_real(share) and 0.0 < share < math.inf) or (share >= 1.0 and share != int(share)):
        raise InvalidInput(f"hold_out = {hold_out!r}: expected a share between 0 and 1, or a number of rollouts")
    whole = share >= 1.0
    if whole and share >= len(records):
        raise InvalidInput(
            f"hold_out = {int(share)} of {len(records)} rollouts leaves none to fit: expected fewer, or a share"
        )
    if whole:
        return tuple(records[: -int(share)]), tuple(records[-int(share) :])
    return _divided(records, share, "held-out part")


def sample_of(records: Sequence[Record], most: int) -> tuple[Record, ...]:
    """About `most` samples of a log: at least three rollouts, or else stretches, spread over it; all of a log that has
    no more."""
    share = most / max(sum(map(len, records)), 1)
    return tuple(records) if share >= 1.0 else _divided(records, share, "searched part", MOST_STRETCHES)[1]


def _divided(
    records: Sequence[Record], share: float, name: str, fewest: int = 1
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """(rest, chosen) of a log: a `share` of it, spread over it, as at least `fewest` whole rollouts or as stretches
    with that name."""
    seconds = [len(r) * r.dt for r in records]
    total = sum(seconds)
    chosen = _spread(len(records), max(int(share * len(records) + 1e-9), 1))
    long = sum(seconds[k] for k in chosen) >= max(SHORTEST_HELD_OUT, 0.5 * share * total)
    if len(records) >= 4 and len(chosen) >= fewest and long:
        return _parted(records, chosen)
    held = min(max(share * total, SHORTEST_HELD_OUT), max(share, 0.5) * total)
    count = int(np.clip(held / (0.5 * SHORTEST_HELD_OUT), 1, MOST_STRETCHES))
    middles, least = total * (np.arange(count) + 0.5) / count, min(SHORTEST_PART, SMALLEST_PART * total)
    pieces = [
        p
        for r, begin in zip(records, np.cumsum([0.0, *seconds]), strict=False)
        for p in _pieces(r, float(begin), middles, 0.5 * held / count, least, name)
    ]
    training, out = (tuple(p for p, held_out in pieces if held_out is side) for side in (False, True))
    if not (training and out) and len(records) > 1:  # the rollouts are too short to be cut
        training, out = _parted(records, _spread(len(records), min(math.ceil(held / max(seconds)), len(records) // 2)))
    if not training or not out or total < SHORTEST_LOG:
        raise InvalidInput(
            f"{total:.2g} s of log are too short to hold a part out: expected some seconds, at least {SHORTEST_LOG:g}"
        )
    return training, out


def _parted(records: Sequence[Record], chosen: Sequence[int]) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """The other rollouts, and the chosen ones."""
    rest = (k for k in range(len(records)) if k not in chosen)
    return tuple(records[k] for k in rest), tuple(records[k] for k in chosen)


def _spread(n: int, count: int) -> list[int]:
    """One index of each of `count` groups of neighbours among n, at another place in each: rollouts may alternate."""
    groups = np.array_split(np.arange(n), count)
    return [int(group[(len(group) // 2 + k) % len(group)]) for k, group in enumerate(groups)]


def _pieces(
    record: Record, begin: float, middles: Array, half: float, least: float, name: str
) -> Iterator[tuple[Record, bool]]:
    """Cut a record, which begins at `begin` [s] of the whole log's time, at the ends of stretches that reach `half` [s]
    to either side of `middles`. Yields each piece and whether it is in a stretch, in which case `name` is in its name.
    Pieces shorter than `least` [s] are merged with a neighbour."""
    middle = begin + record.dt * (np.arange(len(record)) + 0.5)
    inside = np.any(np.abs(middle[:, None] - middles) < half, axis=1)
    for first, last in _runs(inside):
        if (last - first) * record.dt < least:
            inside[first:last] = inside[first - 1] if first else inside[min(last, len(record) - 1)]
    if np.all(inside == inside[0]):
        yield record, bool(inside[0])
        return
    for k, (first, last) in enumerate(_runs(inside), start=1):
        what = name if inside[first] else "part"
        yield record.part(first, last, f"{record.name}, {what} {k}"), bool(inside[first])


def _runs(marks: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of equal marks (K,)."""
    return pairwise([0, *(np.flatnonzero(np.diff(marks)) + 1).tolist(), len(marks)])


def leave_out(records: Sequence[Record], stretches: Iterable[tuple[str, float, float]]) -> tuple[Record, ...]:
    """The records without some stretches (record's name, begin [s], end [s]); the rest of a record becomes rollouts."""
    stretches, kept = tuple(stretches), list[Record]()
    for record in records:
        n, acts = len(record), np.ones(len(record), dtype=bool)
        for name, begin, end in stretches:
            if name == record.name:
                acts &= (record.t[1:] < begin - MARGIN) | (record.t[:-1] > end + MARGIN)
        for first, last in _runs(acts):
            if acts[first] and (last - first == n or (last - first) * record.dt >= SHORTEST_PIECE):
                kept.append(record.part(first, last))
    return tuple(kept)
