"""Column names: which of a log's columns are t, theta, theta_dot, torque and rollout, told or guessed."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from sysid.errors import InvalidInput

NAMES = ("t", "theta", "theta_dot", "torque", "rollout")
LOOKS_LIKE = {
    "t": r"t$|^t_|time|stamp|sec|^[mu]s$|millis|micros",
    "theta": r"theta$|angle|pos|^q\d*$|phi",
    "theta_dot": r"theta_?dot|vel|speed|omega|^q?d(ot)?_?q|rate",
    "torque": r"tor|tau|^u$|effort|command|current|volt|duty|pwm|goal|ref|des",
}


def wanted_columns(columns: str | Mapping[str, str] | None) -> dict[str, str]:
    """{our name: the file's name} that the user asked for."""
    if columns is None:
        return {}
    pairs = columns.items() if isinstance(columns, Mapping) else _pairs(columns)
    wanted = {"torque" if ours in ("u", "command") else ours: theirs for ours, theirs in pairs}
    for ours in wanted:
        if ours not in NAMES:
            raise InvalidInput(
                f"columns name {ours!r}: expected some of {', '.join(NAMES)}, as in t=time_s,theta=angle"
            )
    return wanted


def _pairs(text: str) -> list[tuple[str, str]]:
    pairs = [pair.partition("=") for pair in text.split(",") if pair.strip()]
    for ours, equals, _ in pairs:
        if not equals:
            raise InvalidInput(f"columns has {ours!r}: expected name=column pairs, as in t=time_s,theta=angle_rad")
    return [(ours.strip(), theirs.strip()) for ours, _, theirs in pairs]


def chosen_columns(name: str, found: Sequence[str], wanted: Mapping[str, str]) -> dict[str, str]:
    """{our name: the file's name} of the columns to read; raises InvalidInput that says which were found."""
    listed = ", ".join(title for title in found if title) or "none"
    for ours, theirs in wanted.items():
        if theirs and theirs not in found:
            raise InvalidInput(f"{name} has no column {theirs!r} for {ours}: found {listed}")
    chosen = {ours: theirs for ours, theirs in (named_columns(found) | dict(wanted)).items() if theirs}
    if "t" in chosen and ("theta" in chosen or "theta_dot" in chosen):
        return chosen
    missing = "no t" if "t" not in chosen else "neither theta nor theta_dot"
    pairs = ",".join(f"{ours}={theirs}" for ours, theirs in likely_columns(found, chosen).items())
    which = f", perhaps columns {pairs}" if pairs else " (columns)"
    raise InvalidInput(f"{name} has {missing}: found {listed}; say which is which{which}")


def named_columns(found: Sequence[str]) -> dict[str, str]:
    """{our name: the file's name} of the columns that are called as we call them."""
    own = {name: name for name in NAMES if name in found}
    for other in ("u", "command"):
        if "torque" not in own and other in found:
            own["torque"] = other
    return own


def likely_columns(found: Sequence[str], chosen: Mapping[str, str]) -> dict[str, str]:
    """{our name: the file's name} of what is not chosen yet, by what the file's names look like."""
    likely, free = {}, [name for name in found if name not in chosen.values()]
    for ours, pattern in LOOKS_LIKE.items():
        match = next((name for name in free if re.search(pattern, name.lower())), None) if ours not in chosen else None
        if match:
            free.remove(match)
            likely[ours] = match
    return likely
