"""Unsigned registers: signed numbers of a servo that a logger wrote as if they had no sign."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sysid.physics.ops import Array

BITS = (16, 32)
"""Widths of the registers that servos have."""
EMPTY = 0.25
"""The share of a register's range, on either side of its middle, in which no value may lie."""


def with_signs(
    name: str, table: Mapping[str, Array], titles: Mapping[str, str]
) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The columns of a log with the signs that their registers lost, and a note on each.

    A servo's load, current or speed is a signed integer of 16 or 32 bits. Read without its sign, -1 is 65535: the
    column then has integers near 0 and integers just below 2^16, and none between.
    """
    found, notes = dict(table), []
    for key in ("theta", "theta_dot", "torque"):
        values = found.get(key)
        bits = 0 if values is None else _register(values)
        if values is not None and bits:
            found[key] = np.where(values >= 2.0 ** (bits - 1), values - 2.0**bits, values)
            notes.append(
                f"{name}: column {titles[key]!r} jumps from 0 to {2**bits - 1}: taken for a signed number of {bits} "
                "bits that was logged without its sign"
            )
    return found, tuple(notes)


def _register(values: Array) -> int:
    """The bits of the register whose sign was lost; 0 where none was."""
    known = values[np.isfinite(values)]
    if len(known) == 0 or np.any(known < 0.0) or np.any(known != np.round(known)):
        return 0
    for bits in BITS:
        share = known / 2.0**bits
        high = share > 0.5
        empty = np.all(np.abs(share - 0.5) > EMPTY)
        if empty and np.any(high) and not np.all(high) and np.max(share) < 1.0:
            return bits
    return 0
