"""Tables: named columns of numbers, and how they are made from arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from sysid.errors import InvalidInput, excerpt
from sysid.physics.ops import Array

Table = dict[str, Array]


def column(name: str, title: str, values: Any) -> Array:
    """An array of numbers as a column (K,), also from (K, 1) and (1, K); raises InvalidInput for anything else."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub":
        raise InvalidInput(f"{name}: {excerpt(title)} holds {array.dtype}, not numbers: expected an array of numbers")
    array = np.squeeze(array.astype(float))
    if array.ndim > 1:
        raise InvalidInput(f"{name}: {excerpt(title)} has shape {array.shape}: expected one dimension")
    return np.atleast_1d(array)


def seconds(nanoseconds: Any, missing: Any) -> Array:
    """Whole nanoseconds (K,) as seconds since the first that is not missing; nan where they are missing."""
    known = np.flatnonzero(~missing)
    begin = nanoseconds[known[0]] if len(known) else 0
    return np.where(missing, np.nan, (nanoseconds - begin) / 1e9)


def rows_of(name: str, columns: Mapping[str, Array]) -> Table:
    """A table of columns (K,); a torque or a speed of K - 1 values gets a last one, nan."""
    lead = next(title for title in ("t", "theta", *columns) if title in columns)
    table, rows = dict(columns), len(columns[lead])
    for title, values in columns.items():
        if title in ("torque", "theta_dot") and len(values) == rows - 1:
            table[title] = np.append(values, math.nan)
        elif len(values) != rows:
            raise InvalidInput(f"{name} is ragged: {title} has {len(values)} values, {lead} has {rows}")
    return table
