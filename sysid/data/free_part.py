"""Free part: a free swing begins where the machine is let go and ends where it is caught, and not where the log does.

There a hand lifts it or holds it: a torque acts that no model has, and bends every number. A machine without a drive
only loses energy. So no swing goes further from the rest than the first one, and what a log shows before it leaves that
place for good was made by a hand, where it stood there, or took longer than a swing does. Nor does it come to rest
before its swings are as small as what its friction holds, but in a hand.
"""

from __future__ import annotations

import math

import numpy as np

from sysid.data.record import Record
from sysid.physics.ops import Array

LEFT, HALF = 0.95, 0.5
"""Shares of the largest deflection: below the first the machine is let go, at the second it is on its way."""
ACROSS = 0.25
"""A deflection to the other side, as a share of the largest, after which a log shows swings and no preparation."""
LONGER = 7.0
"""Multiple of the time from the first to the second deflection, until which a swing may have come from the other side:
five, with a margin."""
STILL = 0.1
"""The share of its way to the first that it has gone after half of the time, at most, where it stands; what is let go
at the first sample has gone a quarter."""
TURNS = 0.05
"""The prominence of a swing, and the way within which the machine stands, as a share of all of its way."""
STICKS = 3.0
"""How many times the friction of its motion may hold a machine at rest."""
FEWEST = 6
"""Samples that show whether it stands, and that are left to fit, at least."""


def free_part(record: Record) -> tuple[Record, str]:
    """The part of a record in which no hand holds the machine, and a sentence where that is not all of it, which else
    is empty: of a record in which angles are read and a torque does not act where it is held."""
    if record.theta is None or not record.has_angles:
        return record, ""
    known = np.flatnonzero(np.isfinite(record.theta))
    theta, first, last = record.theta[known], 0, len(record)
    if len(known) > FEWEST:
        let_go = int(known[_let_go(theta)])
        first = let_go if let_go >= FEWEST and not np.any(record.u[:let_go]) else 0
        caught = 0 if np.any(record.u) else _caught(theta)
        last = int(known[caught]) if caught else last
    if (first, last) == (0, len(record)) or last - first < FEWEST:
        return record, ""
    parts = [f"the first {first * record.dt:.3g} s"] if first else []
    parts += [f"what comes after {record.t[last]:.4g} s"] if last < len(record) else []
    said = f"{' and '.join(parts)} {'are' if first else 'is'} left out: without a torque a hand holds or moves it there"
    return record.part(first, last), f"{record.name}: {said}"


def _let_go(theta: Array) -> int:
    """The sample from which a motion (K,) is free, where that is not the first."""
    deflection = theta - float(np.median(theta[len(theta) // 2 :]))
    largest = float(np.max(np.abs(deflection)))
    if largest == 0.0:
        return 0
    share = deflection / largest
    share *= np.sign(share[np.argmax(np.abs(share))])
    first = int(np.argmax(share > LEFT))
    half = first + int(np.argmax(share[first:] < HALF))
    free = first + int(np.flatnonzero(share[first:half] > LEFT)[-1]) + 1 if half > first else 0
    if free < FEWEST or np.any(share[:free] < -ACROSS):
        return 0
    middle, window = free // 2, max(free // 4, 1)
    begin, later = share[:window], share[middle - window // 2 : middle - window // 2 + window]
    gone = abs(float(np.median(later) - np.median(begin)))
    unsure = float(np.std(share[:middle])) / math.sqrt(window)
    stands = max(gone, unsure) < STILL * (1.0 - LEFT)
    return half if stands or free > LONGER * (half - free) else 0


def _caught(theta: Array) -> int:
    """The last sample at which a motion (K,) turns round before it stands where friction could not hold it; 0 where it
    does not.

    With dry friction tau_c against a stiffness k each half swing is shorter than the one before by 4 tau_c / k, with
    other losses by less and less, and the machine comes to rest at most tau_c / k beside the middle.
    """
    from scipy.signal import find_peaks  # loads for a fifth of a second

    way = float(np.ptp(theta))
    turns = np.sort(np.concatenate([find_peaks(own, prominence=TURNS * way)[0] for own in (theta, -theta)]))
    if len(turns) < 3:
        return 0
    places = theta[turns[-3:]]
    before, last = np.diff(places)
    rest = theta[turns[-1] + round(1.5 * (turns[-1] - turns[-2])) :]
    if len(rest) < FEWEST or np.ptp(rest) > TURNS * way:
        return 0
    middle = 0.25 * float(places[0] + 2.0 * places[1] + places[2])
    shorter = max(abs(before) - abs(last), 0.0)
    next_half = max(abs(last) - shorter, 0.0)
    beside = next_half - abs(float(places[2]) - middle)
    return int(turns[-1]) if beside > STICKS * 0.25 * shorter + TURNS * way else 0
