"""The unit of a log's clock: seconds, or the milliseconds and microseconds that many loggers count."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Literal

import numpy as np

from sysid.data.checks import rate_mismatch
from sysid.data.log_files import Source
from sysid.data.table import Table, TimeWindow
from sysid.errors import InvalidInput
from sysid.physics.ops import Array

TimeUnit = Literal["s", "ms", "us"]
PER_SECOND: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e3, "us": 1e6}
WORDS: dict[TimeUnit, str] = {"s": "seconds", "ms": "milliseconds", "us": "microseconds"}
NAMED: dict[TimeUnit, str] = {
    "ms": r"ms|msecs?|millis|milliseconds?",
    "us": r"us|µs|μs|usecs?|micros|microseconds?",
    "s": r"s|secs?|seconds?",
}
SLOW = 0.5
"""Rows that are so far apart [s] follow no pendulum: the clock may count something shorter."""
FINEST = 2e-5
"""Nor does a logger write rows nearer to each other than this [s], whatever a column is called."""
FEWEST = 10
"""Rows that the unit of a clock can be told from."""


def _named_unit(title: str) -> TimeUnit | None:
    """The unit that the name of a column ends with, as in t_ms, time [us] or millis; None where it names none."""
    words = [word for word in re.split(r"[\W_]+", title.strip().lower()) if word]
    for unit, pattern in NAMED.items():
        if words and re.fullmatch(pattern, words[-1]):
            return unit
    return None


def _found_unit(name: str, title: str, table: Mapping[str, Array]) -> tuple[TimeUnit, str]:
    """The unit of column t, and what shows it.

    The name of the column counts where rows are then not absurdly near to each other; else the unit in which the speed
    is the rate of the angle. name and title are those of the log and of its column t, the reason is half a sentence,
    empty where nothing speaks against seconds. Raises InvalidInput where seconds cannot be and nothing tells the unit.
    """
    steps = np.diff(table["t"][np.isfinite(table["t"])])
    steps = steps[steps > 0.0]
    if len(steps) == 0:
        return "s", ""
    step, named = float(np.median(steps)), _named_unit(title)
    if named is not None and step / PER_SECOND[named] >= FINEST:
        return named, f"as the name of column {title!r} says" if named != "s" else ""
    if len(steps) < FEWEST:
        return "s", ""
    moving = [c for c in ("theta", "theta_dot") if c in table and len(table[c]) == len(table["t"])]
    whole = np.all([np.isfinite(table[c]) for c in ("t", *moving)], axis=0)
    if len(moving) == 2 and np.sum(whole) >= FEWEST:
        t, theta, theta_dot = (table[c][whole] for c in ("t", *moving))
        if np.ptp(theta) > 0.0 and np.ptp(theta_dot) > 0.0:
            off = {u: rate_mismatch(t / per, theta, theta_dot) for u, per in PER_SECOND.items()}
            best = min(off, key=lambda unit: off[unit])
            if off[best] < 0.3 and (best == "s" or off["s"] > 0.9):
                return best, "in which theta_dot is the rate of theta" if best != "s" else ""
    if step < SLOW:
        return "s", ""
    choices = " or ".join(f"{u} ({PER_SECOND[u] / step:.4g} Hz)" for u in PER_SECOND)
    raise InvalidInput(
        f"{name}: rows are {step:.4g} apart in {title!r}, too far for seconds, and nothing tells which unit it is: "
        f"give the time unit (--time-unit, time_unit), one of {choices}"
    )


def in_seconds(
    source: Source, chosen: Mapping[str, str], window: TimeWindow, unit: TimeUnit | None, notes: list[str]
) -> Table:
    """The columns of the rows in the window, t in seconds whatever the file counts; a note where it was converted."""
    reason, named = "", _named_unit(chosen["t"])
    table = source.load(chosen, _counted(window, unit or "s"))
    if unit is None:
        unit, reason = _found_unit(source.name, chosen["t"], table)
        bounded = math.isfinite(window.begin) or math.isfinite(window.end)
        if unit == "s" and bounded and len(table["t"]) < FEWEST:  # of a clock that counts faster, next to nothing
            for other in (named,) if named else (u for u in PER_SECOND if u != "s"):
                rows = source.load(chosen, _counted(window, other))
                if _found_unit(source.name, chosen["t"], rows)[0] == other:
                    unit, reason = _found_unit(source.name, chosen["t"], rows)
        if unit != "s" and bounded:
            table = source.load(chosen, _counted(window, unit))
        note = f"t is in {WORDS[unit]}, {reason}: converted to seconds"
        if unit != "s" and note not in notes:
            notes.append(note)
    return table | {"t": table["t"] / PER_SECOND[unit]}


def _counted(window: TimeWindow, unit: TimeUnit) -> TimeWindow:
    """The window in units of the file's clock."""
    return window._replace(begin=window.begin * PER_SECOND[unit], end=window.end * PER_SECOND[unit])
