"""Held starts: a free swing begins where the machine is let go, and not where the log does.

Before, a hand lifts it or holds it: a torque acts that no model has, and bends every number. A machine without a drive
only loses energy. So no swing goes further from the rest than the first one, and what a log shows before it leaves that
place for good was made by a hand, where it stood there, or took longer than a swing does.
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
FEWEST = 6
"""Samples that show whether it stands, and that are left to fit, at least."""


def without_held_start(record: Record) -> tuple[Record, str]:
    """The record from where it moves freely, and a sentence where that is not its begin, which else is empty."""
    if record.theta is None or not record.has_angles:
        return record, ""
    known = np.flatnonzero(np.isfinite(record.theta))
    at = int(known[_let_go(record.theta[known])]) if len(known) > FEWEST else 0
    if at < FEWEST or len(record) - at < FEWEST or np.any(record.u[:at] != 0.0):
        return record, ""
    said = f"the first {at * record.dt:.3g} s are left out: without a torque a hand holds or moves it until then"
    return record.part(at, len(record)), f"{record.name}: {said}"


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
