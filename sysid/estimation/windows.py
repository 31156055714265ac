"""Windows: stretches of a log, each with an initial state of its own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sysid.data.record import Record

UNKNOWN = 0.5
"""Seconds at the start of a record that are not scored if the commands before it are not known."""


@dataclass(frozen=True)
class Window:
    """Instants begin ... begin + count of record number `record`; the first `lead` instants are not scored."""

    record: int
    begin: int
    count: int
    lead: int = 0

    @property
    def overlap(self) -> int:
        """The number of its first instants that belong to the window before it: its lead, or 0 at a record's start."""
        return self.lead if self.begin > 0 else 0


def cut(records: Sequence[Record], length: float = math.inf, lead: float = 0.0) -> tuple[Window, ...]:
    """Windows of `length` [s] that tile the records, each preceded by up to `lead` [s] that is not scored.

    Where a record begins in the middle of a rollout, its own first `lead` [s] are not scored either, and at least
    UNKNOWN [s] if the commands before it are not known: meanwhile memories fill.

    The windows of a record are equally long to one interval. None is shorter than two thirds of `length`, unless its
    record is.
    """
    windows = []
    for i, record in enumerate(records):
        n, dt = len(record), record.dt
        blind = max(lead, UNKNOWN if record.starts_midway else 0.0) if record.time_since_start[0] > 0.0 else 0.0
        first = min(_intervals(blind, dt), n // 2)
        pieces = max(1, round((n - first) * dt / length)) if math.isfinite(length) else 1
        edges = np.linspace(first, n, min(pieces, n - first) + 1).round().astype(int)
        for begin, end in pairwise(edges):
            early = min(int(begin), _intervals(lead, dt)) if begin > first else first
            windows.append(Window(i, int(begin) - early, int(end - begin) + early, early if begin > 0 else 0))
    return tuple(windows)


def _intervals(seconds: float, dt: float) -> int:
    return math.ceil(seconds / dt - 1e-9)
