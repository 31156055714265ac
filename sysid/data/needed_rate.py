"""The sample rate that a motion needs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sysid.data.record import Record

DRIVEN_RATE, FREE_SWING_RATE = 100.0, 50.0
"""Least rates [Hz] of a driven motion and of a free swing, which answers no command."""
SAMPLES = 20.0
"""Samples in a period of a motion's fastest part."""
FAST = 1e-4
"""Share of a motion's power that may lie above the frequency of its fastest part."""
SHORT_PIECE = 0.2
"""Pieces shorter than this share of the longest tell no rate: the course of a moment has a part at every frequency."""


def needed_rate(records: Sequence[Record]) -> float:
    """The sample rate [Hz] that a motion needs: 20 samples in a period of its fastest part, and at least 100 Hz; 50 Hz
    if it is a free swing."""
    least = DRIVEN_RATE if any(r.driven for r in records) else FREE_SWING_RATE
    return max(least, SAMPLES * fastest_part(records))


def fastest_part(records: Sequence[Record]) -> float:
    """The frequency of a motion's fastest part [Hz]; 0 if the records do not show it.

    All but a ten-thousandth of the power of the angle (or of the summed speeds, where no angle was read) lies below it.
    White noise does not count; its level is taken from the upper half of the frequencies.
    """
    fastest, longest = 0.0, max(map(len, records))
    for r in (record for record in records if len(record) >= SHORT_PIECE * longest):
        y = r.theta
        if not r.has_angles and r.theta_dot is not None:
            y = r.dt * np.cumsum(r.theta_dot)
        if y is None or len(y) < 8:
            continue
        t = np.linspace(0.0, 1.0, len(y))
        y = y - y[0] - (y[-1] - y[0]) * t  # without a trend: a step from end to begin would leak into all frequencies
        power = np.abs(np.fft.rfft(y)) ** 2
        noise, count = float(np.median(power[len(power) // 2 :])) / math.log(2.0), np.arange(len(power), 0, -1)
        above = power[::-1].cumsum()[::-1]
        moves = np.flatnonzero(above - noise * (count + 4.0 * np.sqrt(count)) > FAST * above[0])
        fastest = max(fastest, (moves[-1] + 1.0) / (len(y) * r.dt)) if len(moves) else fastest
    return fastest
