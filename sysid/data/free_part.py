"""Free part: the part of a free swing in which no hand lifts, holds or catches the machine.

A hand's torque is in no model and bends every number. It shows because a machine without a drive only loses energy. No
swing goes further from the rest than the first; so what comes before the machine leaves its furthest place for good was
made by a hand, if it stood there or took longer than a swing does. And the machine comes to rest by itself only once
its swings are as small as what friction holds; where it stops earlier, a hand has caught it. Where its first period is
not what the later ones let expect, a hand still led it, or the logger lost time.

A rest much longer than the swing, as of a logger that runs on, says nothing more, and is shortened: what is held out of
a log would be a rest.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Record
from sysid.physics.ops import Array

LEFT = 0.95
"""Share of the largest deflection below which the machine has been let go."""
HALF = 0.5
"""Share of the largest deflection at which it is on its way."""
ACROSS = 0.25
"""A log that has gone so far to the other side (share of the largest deflection) shows swings and no preparation."""
LONGER = 7.0
"""A swing from the other side reaches LEFT within 5 times the time from LEFT to HALF; this adds a margin."""
LARGEST_CREEP = 0.1
"""A machine stands if half of the time before LEFT takes it at most this share of the way there; if it were let go at
the first sample, it would have gone a quarter."""
TURNS = 0.05
"""The least prominence of a turn, and the range within which the machine stands, as shares of the whole range."""
STICKS = 3.0
"""Friction that may hold a machine at rest, at most, in units of the friction of its motion."""
SETTLING_BAND = 0.01
"""A machine stands at its end from where it stays within this share of the whole range."""
LONGEST_REST = 3.0
"""Rest behind a swing that is too long, as a multiple of the swing's duration."""
KEPT_REST = 0.5
"""Rest that is kept then, as a multiple of the swing's duration."""
FEWEST_PERIODS = 5
"""Fewest periods that tell how long one takes."""
LARGEST_DEVIATION = 0.05
"""How far the first periods may deviate from that in any log, as a share of it."""
OUTLYING = 6.0
"""How far they may deviate where periods are uneven, in units of the median deviation."""
MOST_IRREGULAR = 3
"""Half swings, at most, that are left out since they take too long or too short."""
FEWEST_SAMPLES = 6
"""Samples, at least, that show whether it stands, and that must be left to fit."""


def free_part(record: Record) -> tuple[Record, str]:
    """The part of a record in which no hand holds the machine, without a long rest behind it; and a sentence on what is
    left out, empty for nothing.

    Nothing is left out of a record without angles, or where a torque acts meanwhile.
    """
    if record.theta is None or not record.has_angles:
        return record, ""
    if len(record) < FEWEST_SAMPLES:
        return record, ""
    let_go, caught = _let_go(record.theta), 0 if record.driven else _caught(record.theta)
    first = let_go if let_go >= FEWEST_SAMPLES and not np.any(record.u[:let_go]) else 0
    last = caught or len(record)
    irregular = 0 if record.driven else _irregular(record.theta[first:last])
    first += irregular
    swing = 0 if record.driven or caught else _stops(record.theta) - first
    if swing >= FEWEST_SAMPLES and len(record) - first > (1.0 + LONGEST_REST) * swing:
        last = first + round((1.0 + KEPT_REST) * swing)
    if (first, last) == (0, len(record)) or last - first < FEWEST_SAMPLES:
        return record, ""
    after, said = f"what comes after {record.t[last]:.4g} s", list[str]()
    by_hand = [f"the first {first * record.dt:.3g} s"] * (first > 0) + [after] * (caught > 0)
    if by_hand:
        are, why = "are" if first else "is", "without a torque a hand holds or moves it there"
        why += ", or the logger loses time: it swings in another time than later" if irregular else ""
        said.append(f"{' and '.join(by_hand)} {are} left out: {why}")
    if last < len(record) and not caught:
        said.append(f"{after} is left out: it is a long rest")
    return record.part(first, last), f"{record.name}: {'; '.join(said)}"


def _turns(theta: Array) -> NDArray[np.intp]:
    """The samples at which a motion (K,) turns back."""
    from scipy.signal import find_peaks  # loads for a fifth of a second

    way = float(np.ptp(theta))
    turns = [find_peaks(angle, prominence=TURNS * way)[0] for angle in (theta, -theta)]
    return np.sort(np.concatenate(turns))


def _irregular(theta: Array) -> int:
    """The turn (sample) of a motion (K,) from which its periods fit the later ones; 0 if the first one does.

    A period of a pendulum, over the complete elliptic integral K(sin^2(A / 2)) of its amplitude A [rad], or one of a
    linear spring, is constant: of these two laws that one counts which the later periods follow better.
    """
    from scipy.special import ellipk

    turns, later = _turns(theta), slice(MOST_IRREGULAR, None)
    if len(turns) < FEWEST_PERIODS + MOST_IRREGULAR + 2:
        return 0
    way = np.abs(np.diff(theta[turns]))
    period = (turns[2:] - turns[:-2]).astype(float)
    amplitude = np.minimum(0.25 * (way[1:] + way[:-1]), 3.0)
    laws = (period, period / ellipk(np.sin(0.5 * amplitude) ** 2))
    deviations = [np.abs(law / np.median(law[later]) - 1.0) for law in laws]
    deviation = min(deviations, key=lambda values: float(np.median(values[later])))
    limit = max(LARGEST_DEVIATION, OUTLYING * float(np.median(deviation[later])))
    off = deviation[: MOST_IRREGULAR + 1] > limit
    return int(turns[np.argmin(off)]) if off[0] and not off[-1] else 0


def _stops(theta: Array) -> int:
    """The last sample of a motion (K,) before it stands to its end."""
    end = float(np.median(theta[-max(len(theta) // 10, 1) :]))
    return int(np.max(np.flatnonzero(np.abs(theta - end) > SETTLING_BAND * np.ptp(theta)), initial=0))


def _let_go(theta: Array) -> int:
    """The sample from which a motion (K,) is free; 0 if it is free from the first."""
    deflection = theta - float(np.median(theta[len(theta) // 2 :]))
    largest = float(np.max(np.abs(deflection)))
    if largest == 0.0:
        return 0
    share = deflection / largest
    share *= np.sign(share[np.argmax(np.abs(share))])
    first = int(np.argmax(share > LEFT))
    half = first + int(np.argmax(share[first:] < HALF))
    free = first + int(np.flatnonzero(share[first:half] > LEFT)[-1]) + 1 if half > first else 0
    if free < FEWEST_SAMPLES or np.any(share[:free] < -ACROSS):
        return 0
    middle, window = free // 2, max(free // 4, 1)
    begin, later = share[:window], share[middle - window // 2 : middle - window // 2 + window]
    gone = abs(float(np.median(later) - np.median(begin)))
    unsure = float(np.std(share[:middle])) / math.sqrt(window)
    stands = max(gone, unsure) < LARGEST_CREEP * (1.0 - LEFT)
    return half if stands or free > LONGER * (half - free) else 0


def _caught(theta: Array) -> int:
    """The last turn (sample) of a motion (K,) that then stands where friction could not hold it; 0 if it does not.

    With dry friction tau_c against a stiffness k, each half swing is shorter than the one before by 4 tau_c / k; other
    losses shorten it by less and less. The machine comes to rest at most tau_c / k beside the middle.
    """
    way, turns = float(np.ptp(theta)), _turns(theta)
    if len(turns) < 3:
        return 0
    places = theta[turns[-3:]]
    before, last = np.diff(places)
    rest = theta[turns[-1] + round(1.5 * (turns[-1] - turns[-2])) :]
    if len(rest) < FEWEST_SAMPLES or np.ptp(rest) > TURNS * way:
        return 0
    middle = 0.25 * float(places[0] + 2.0 * places[1] + places[2])
    shorter = max(abs(before) - abs(last), 0.0)
    next_half = max(abs(last) - shorter, 0.0)
    beside = next_half - abs(float(places[2]) - middle)
    return int(turns[-1]) if beside > STICKS * 0.25 * shorter + TURNS * way else 0
