"""Splitting: which parts of a log are held out, or left out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record, tuple_of_records
from sysid.errors import InvalidInput, is_real

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
WAY_TIME = 0.1
"""Seconds over which the joint's way is taken, to tell whether it moves."""
STANDING = 0.05
"""Share of the RMS way below which the joint stands."""
ABOVE_NOISE = 3.0
"""Least way of a moving joint, in units of what the noise of its readings adds to a way."""
LEAST_MOTION, MOST_MOTION = 0.1, 0.6
"""Least and largest share of the time in motion that all stretches together may hold out."""
SHIFTS = (0.0, -0.5, 0.5, -1.0, 1.0)
"""Places of a stretch in its part of the log, from one end (-1) to the other (1), in the order of the trials."""
SHORTEST_LOG = 0.5
"""Seconds of the shortest log of which a part is held out."""
SHORTEST_HELD_OUT = 2.0
"""Seconds that are held out, at least; a stretch of them is at least half as long, a window to score."""


def split(records: Sequence[Record], hold_out: float | None = None) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Split a log into what is fitted and what is held out: by default one of every four rollouts.

    The held-out rollouts are spread over the log, whose end is often another kind of motion. If there are fewer than
    four (a single long log, say), or the chosen ones are too short, a quarter of the time is held out instead, in one
    to three stretches spread over the log. There are few of them, because a fit loses information with every free
    initial state. They move within their parts of the log if together they would hold most of its motion, or hardly
    any. Of rollouts that are too short to be cut, at most half are held out whole. A part behind a cut knows the
    commands before it (for delays and lags); if sensors have a memory, a lead-in is not scored.

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
    no more. Stretches move as those of `split` do if together they would hold hardly any of the motion."""
    share = most / max(sum(map(len, records)), 1)
    if share >= 1.0:
        return tuple(records)
    return _divided(records, share, "searched part", fewest=MOST_STRETCHES, most_motion=1.0)[1]


def _divided(
    records: Sequence[Record], share: float, name: str, fewest: int = 1, most_motion: float = MOST_MOTION
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """(rest, chosen) of a log: a `share` of it, spread over it, as at least `fewest` whole rollouts or as stretches
    with that name, which hold at most a share `most_motion` of its motion, or half as much again as of its time."""
    seconds = [len(r) * r.dt for r in records]
    total = sum(seconds)
    chosen = _spread(len(records), max(int(share * len(records) + 1e-9), 1))
    long = sum(seconds[k] for k in chosen) >= max(SHORTEST_HELD_OUT, 0.5 * share * total)
    if len(records) >= 4 and len(chosen) >= fewest and long:
        return _parted(records, chosen)
    held = min(max(share * total, SHORTEST_HELD_OUT), max(share, 0.5) * total)
    count = int(np.clip(held / (0.5 * SHORTEST_HELD_OUT), 1, MOST_STRETCHES))
    shortest, most = min(SHORTEST_PART, SMALLEST_PART * total), max(most_motion, 1.5 * held / total)
    inside = _stretches(records, count, 0.5 * held / count, shortest, most)
    pieces = [piece for r, marks in zip(records, inside, strict=True) for piece in _pieces(r, marks, name)]
    training, out = (tuple(p for p, held_out in pieces if held_out is side) for side in (False, True))
    if not (training and out) and len(records) > 1:  # the rollouts are too short to be cut
        training, out = _parted(records, _spread(len(records), min(math.ceil(held / max(seconds)), len(records) // 2)))
    if not training or not out or total < SHORTEST_LOG:
        raise InvalidInput(
            f"{total:.2g} s of log are too short to hold a part out: expected some seconds, at least {SHORTEST_LOG:g}"
        )
    return training, out


def _stretches(
    records: Sequence[Record], count: int, half: float, shortest: float, most: float
) -> list[NDArray[np.bool_]]:
    """Whether each interval is in one of `count` stretches that reach `half` [s] to either side: (N,) for each record.

    There is one stretch in each of `count` parts of the log: in its middle, unless together they would hold less than
    LEAST_MOTION of the time in motion, or more than a share `most`. Pieces shorter than `shortest` [s] go with a
    neighbour.
    """
    ends, moves = np.cumsum([len(r) * r.dt for r in records]), _moves(records)
    times = [end - r.dt * (np.arange(len(r))[::-1] + 0.5) for r, end in zip(records, ends, strict=True)]
    middles, room = ends[-1] * (np.arange(count) + 0.5) / count, 0.5 * ends[-1] / count - half
    best, least = list[NDArray[np.bool_]](), math.inf
    for shifts in product(SHIFTS, repeat=count):
        at = middles + room * np.array(shifts)
        inside = [
            _merged(np.any(np.abs(t[:, None] - at) < half, axis=1), shortest / r.dt)
            for r, t in zip(records, times, strict=True)
        ]
        together = np.concatenate(inside)
        cut = bool(np.any(together) and not np.all(together))
        share = float(np.mean(together[moves])) if np.any(moves) else LEAST_MOTION
        one_side_rests = share == 0.0 or share == 1.0 > most
        fault = max(share - most, LEAST_MOTION - share, 0.0) + one_side_rests
        if not best or (cut and fault < least):
            best, least = inside, fault
        if not cut or least == 0.0:
            break
    return best


def _moves(records: Sequence[Record]) -> NDArray[np.bool_]:
    """Whether the joint moves in WAY_TIME after the beginning of each interval of all records, one after the other."""
    ways, noises = [], []
    for record in records:
        ahead = max(round(WAY_TIME / record.dt), 1)
        if record.theta is not None and record.has_angles:
            position, added = record.theta, 1.0
        elif record.theta_dot is not None:
            position = record.dt * np.concatenate([[0.0], np.cumsum(record.theta_dot[:-1])])
            added = math.sqrt(ahead)  # errors of the speed add up over the way
        else:
            position, added = np.zeros(len(record) + 1), 1.0
        last = np.minimum(np.arange(len(record)) + ahead, len(record))
        ways.append(np.abs(position[last] - position[:-1]))
        noises.append(added * np.abs(np.diff(position, 2)))
    way, noise = np.concatenate(ways), np.concatenate(noises)
    standing = STANDING * math.sqrt(float(np.mean(way**2)))
    moves: NDArray[np.bool_] = way > max(standing, ABOVE_NOISE * float(np.median(noise)) if len(noise) else 0.0)
    return moves


def _parted(records: Sequence[Record], chosen: Sequence[int]) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """The other rollouts, and the chosen ones."""
    rest = (k for k in range(len(records)) if k not in chosen)
    return tuple(records[k] for k in rest), tuple(records[k] for k in chosen)


def _spread(n: int, count: int) -> list[int]:
    """One index of each of `count` groups of neighbours among n, at another place in each: rollouts may alternate."""
    groups = np.array_split(np.arange(n), count)
    return [int(group[(len(group) // 2 + k) % len(group)]) for k, group in enumerate(groups)]


def _merged(inside: NDArray[np.bool_], fewest: float) -> NDArray[np.bool_]:
    """The marks (N,) of a record's intervals, changed so that runs of fewer than `fewest` go with a neighbour."""
    for first, last in _runs(inside):
        if last - first < fewest:
            inside[first:last] = inside[first - 1] if first else inside[min(last, len(inside) - 1)]
    return inside


def _pieces(record: Record, inside: NDArray[np.bool_], name: str) -> Iterator[tuple[Record, bool]]:
    """Cut a record into what is inside stretches and what is not. Yields each piece and whether it is in a stretch, in
    which case `name` is in its name."""
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
