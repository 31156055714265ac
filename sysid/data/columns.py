"""Columns: which of a log's columns is which, the unit of its clock, and signs that its registers lost."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import numpy as np

from sysid.data.checks import rate_mismatch
from sysid.data.table import Table
from sysid.errors import InvalidInput, check_kind
from sysid.physics.ops import Array

NAMES = ("t", "theta", "theta_dot", "torque", "rollout")
Command = Literal["torque", "current", "voltage", "position"]
"""The kind of a machine's command: see `sysid.physics.effects.actuators`."""
ALSO_TORQUE = ("u", "command", "force")
"""Other names that a command of any kind may have."""
TOLD = r"target|goal|ref|des|set|cmd|command|consigne|soll"
"""How names look of what a machine was told, and not of what was read."""
LOOKS_LIKE = {
    "t": r"^t([^a-z]|$)|[^a-z]t$|time|stamp|millis|micros|^s$|^(?!.*(rad|deg)).*(^|[^/a-z])(secs?|seconds|[mu]s)$",
    "theta": rf"^(?!.*({TOLD})).*(theta$|angle|pos|^q\d*$|phi)",
    "theta_dot": rf"^(?!.*({TOLD})).*(theta_?dot|vel|speed|omega|^q?d(ot)?_?q|rate)",
    "torque": r"tor|tau|^u$|effort|command|current|volt|duty|pwm|goal|ref|des",
}
TimeUnit = Literal["s", "ms", "us"]
PER_SECOND: dict[TimeUnit, float] = {"s": 1.0, "ms": 1e3, "us": 1e6}
UNIT_NAMES: dict[TimeUnit, str] = {"s": "seconds", "ms": "milliseconds", "us": "microseconds"}
NAMED: dict[TimeUnit, str] = {
    "ms": r"ms|msecs?|millis|milliseconds?",
    "us": r"us|µs|μs|usecs?|micros|microseconds?",
    "s": r"s|secs?|seconds?",
}
SLOW = 0.5
"""Rows that are so far apart [s] cannot follow a pendulum: the clock may count a shorter unit."""
FINEST = 2e-5
"""No logger writes rows nearer to each other than this [s]: a unit in a column's name that says so is not believed."""
MOST_LISTED = 40
"""The most names of columns that a sentence lists."""
FEWEST_ROWS = 10
"""Rows from which the unit of a clock can be inferred."""
BITS = (16, 32)
"""Widths of servos' registers."""
EMPTY_MIDDLE = 0.25
"""Share of a register's range, on either side of its middle, in which no value lies if a sign was lost."""


# ---- names -----------------------------------------------------------------------------------------------------------


def wanted_columns(columns: str | Mapping[str, str] | None, command: Command = "torque") -> dict[str, str]:
    """{our name: the file's name} that the user asked for; the command may go by its kind, such as "current"."""
    if columns is None:
        return {}
    check_kind("columns", columns, str | Mapping, "name=column pairs, as in t=time_s,theta=angle_rad, or a mapping")
    pairs = columns.items() if isinstance(columns, Mapping) else _pairs(columns)
    wanted = {"torque" if ours in (command, *ALSO_TORQUE) else ours: theirs for ours, theirs in pairs}
    for ours in wanted:
        if ours not in NAMES:
            hint = f"; where it is what the machine was told: --input {ours}" if ours in get_args(Command) else ""
            raise InvalidInput(
                f"columns name {ours!r}: expected some of {', '.join(NAMES)}, as in t=time_s,theta=angle{hint}"
            )
    return wanted


def _pairs(text: str) -> list[tuple[str, str]]:
    pairs = [pair.partition("=") for pair in text.split(",") if pair.strip()]
    for ours, equals, _ in pairs:
        if not equals:
            raise InvalidInput(f"columns has {ours!r}: expected name=column pairs, as in t=time_s,theta=angle_rad")
    return [(ours.strip(), theirs.strip()) for ours, _, theirs in pairs]


def chosen_columns(
    name: str, titles: Sequence[str], wanted: Mapping[str, str], command: Command = "torque"
) -> dict[str, str]:
    """{our name: the file's name} of the columns to read; raises InvalidInput that says which were found.

    A torque may be missing (a free swing), but not a `command` of another kind, for which the user has asked.
    """
    listed = _listed(titles)
    for ours, theirs in wanted.items():
        if theirs and theirs not in titles:
            raise InvalidInput(f"{name} has no column {theirs!r} for {ours}: found {listed}")
    settled = named_columns(titles, command) | dict(wanted)
    chosen = {ours: theirs for ours, theirs in settled.items() if theirs}
    moves = "theta" in chosen or "theta_dot" in chosen
    if "t" in chosen and moves and (command == "torque" or "torque" in settled):
        return chosen
    missing = f"no {command} that the machine was told" if moves else "neither theta nor theta_dot"
    missing = missing if "t" in chosen else "no t"
    guess = likely_columns(titles, chosen, command)
    likely = {command if n == "torque" else n: theirs for n, theirs in guess.items()}
    pairs = ",".join(f"{ours}={theirs}" for ours, theirs in likely.items())
    which = f", perhaps columns {pairs}" if pairs else ", as in columns t=1,theta=2" if "1" in titles else " (columns)"
    untimed = "" if "t" in {*chosen, *likely} else "; if rows have no time, columns t= and their interval (--dt, dt)"
    raise InvalidInput(f"{name} has {missing}: found {listed}; say which is which{which}{untimed}")


def _listed(titles: Sequence[str]) -> str:
    """The names of a file's columns, at most MOST_LISTED of them; numbers stand for columns without names."""
    named = [title for title in titles if title]
    if named and named == [str(k + 1) for k in range(len(titles))]:
        return f"{len(named)} columns without names, called 1 to {len(named)}" if len(named) > 1 else "one column"
    more = f" and {len(named) - MOST_LISTED} more" if len(named) > MOST_LISTED else ""
    return (", ".join(named[:MOST_LISTED]) or "none") + more


def named_columns(titles: Sequence[str], command: Command = "torque") -> dict[str, str]:
    """{our name: the file's name} of the columns that have our names.

    The command may go by its kind, u, command or force. "position" most often names the angle that was read, unless
    there is a theta, too.
    """
    columns = {name: name for name in NAMES if name in titles}
    named = command != "position" or "theta" in titles
    names = (command, "torque", *ALSO_TORQUE) if named else ("torque", *ALSO_TORQUE)
    title = next((other for other in names if other in titles), None)
    return columns if title is None else columns | {"torque": title}


def likely_columns(titles: Sequence[str], chosen: Mapping[str, str], command: Command = "torque") -> dict[str, str]:
    """A guess at {our name: the file's name} for what is not chosen yet, by the look of the file's names."""
    likely, free = {}, [name for name in titles if name not in chosen.values()]
    looks = LOOKS_LIKE | ({"torque": TOLD} if command == "position" else {})
    for ours, pattern in looks.items():
        match = next((name for name in free if re.search(pattern, name.lower())), None) if ours not in chosen else None
        if match:
            free.remove(match)
            likely[ours] = match
    return likely


# ---- the clock -------------------------------------------------------------------------------------------------------


def _named_unit(title: str) -> TimeUnit | None:
    """The unit that the name of a column ends with, as in t_ms, time [us] or millis; None where it names none."""
    words = [word for word in re.split(r"[\W_]+", title.strip().lower()) if word]
    for unit, pattern in NAMED.items():
        if words and re.fullmatch(pattern, words[-1]):
            return unit
    return None


def _found_unit(name: str, title: str, table: Mapping[str, Array]) -> tuple[TimeUnit, str]:
    """The unit of column t, and the reason for it as half a sentence, empty for seconds that nothing contradicts.

    A unit in the name of the column counts unless rows would be absurdly near to each other; next comes the unit in
    which the speed is the rate of the angle. `name` and `title` are those of the log and of its column t. Raises
    InvalidInput if the unit cannot be seconds and nothing shows which it is.
    """
    steps = np.diff(table["t"][np.isfinite(table["t"])])
    steps = steps[steps > 0.0]
    if len(steps) == 0:
        return "s", ""
    step, named = float(np.median(steps)), _named_unit(title)
    if named is not None and step / PER_SECOND[named] >= FINEST:
        return named, f"as the name of column {title!r} says" if named != "s" else ""
    if len(steps) < FEWEST_ROWS:
        return "s", ""
    moving = [c for c in ("theta", "theta_dot") if c in table and len(table[c]) == len(table["t"])]
    whole = np.all([np.isfinite(table[c]) for c in ("t", *moving)], axis=0)
    if len(moving) == 2 and np.sum(whole) >= FEWEST_ROWS:
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


def in_seconds(name: str, title: str, table: Table, unit: TimeUnit | None, notes: list[str]) -> Table:
    """The table with t converted to seconds, and a note if it was inferred that it counts something else.

    `name` and `title` are those of the log and of its column t.
    """
    if unit is None:
        unit, reason = _found_unit(name, title, table)
        note = f"t is in {UNIT_NAMES[unit]}, {reason}: converted to seconds"
        if unit != "s" and note not in notes:
            notes.append(note)
    return table | {"t": table["t"] / PER_SECOND[unit]}


# ---- signs -----------------------------------------------------------------------------------------------------------


def with_signs(
    name: str, table: Mapping[str, Array], titles: Mapping[str, str]
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The columns of a log with the signs that their registers lost, and a note on each.

    A servo's load, current or speed is a signed integer of 16 or 32 bits. If it is logged as unsigned, -1 becomes
    65535: the column then has integers near 0 and integers just below 2^16, but none in between.
    """
    columns, notes = dict(table), []
    for key in ("theta", "theta_dot", "torque"):
        values = columns.get(key)
        bits = 0 if values is None else _register(values)
        if values is not None and bits:
            columns[key] = np.where(values >= 2.0 ** (bits - 1), values - 2.0**bits, values)
            notes.append(
                f"{name}: column {titles[key]!r} jumps from 0 to {2**bits - 1}: taken for a signed number of {bits} "
                "bits that was logged without its sign"
            )
    return columns, tuple(notes)


def _register(values: Array) -> int:
    """The width [bits] of the register whose sign was lost; 0 if none was."""
    known = values[np.isfinite(values)]
    if len(known) == 0 or np.any(known < 0.0) or np.any(known != np.round(known)):
        return 0
    for bits in BITS:
        share = known / 2.0**bits
        high = share > 0.5
        empty = np.all(np.abs(share - 0.5) > EMPTY_MIDDLE)
        if empty and np.any(high) and not np.all(high) and np.max(share) < 1.0:
            return bits
    return 0
