"""Nested columns: how the columns are called that lie in structs, in structs of these, and in matrices.

A field of a file's only struct goes by its own name, else as scope.time; a field of a struct in it goes as
signals.values, and one of the first of several structs as signals1.values. The columns of a matrix x are x:1, x:2, ...
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

Part = tuple[Any, tuple[slice | int, ...]]
"""What holds a column, and where in it; () for all of it."""


def columns_within(members: Mapping[str, Any]) -> dict[str, Part]:
    """The columns in the members of a file, by their names, without what is no array of numbers."""
    structs = [name for name, value in members.items() if isinstance(value, Mapping)]
    if len(structs) == 1:
        members = {name: value for name, value in members.items() if name not in structs} | dict(members[structs[0]])
    return {title: part for title, part in _columns_of("", members) if _are_numbers(part[0])}


def _are_numbers(value: Any) -> bool:
    """Whether a value is an array of more than one number; MATLAB's texts in HDF5 only look like one."""
    text = getattr(value, "attrs", {}).get("MATLAB_class") == b"char"
    return getattr(value, "size", 0) > 1 and value.dtype.kind in "fiub" and not text


def _columns_of(title: str, value: Any) -> Iterator[tuple[str, Part]]:
    """The columns of a struct, of several, or of a matrix, whose columns are longer than its rows; else the value."""
    if isinstance(value, Mapping):
        for name, member in value.items():
            yield from _columns_of(f"{title}.{name}" if title else name, member)
    elif several := _structs(value):
        for k, one in enumerate(several, start=1):
            yield from _columns_of(f"{title}{k}", one)
    else:
        shape: tuple[int, ...] = getattr(value, "shape", None) or ()
        matrix = len(shape) == 2 and min(shape) > 1 and shape[0] != shape[1]
        for k in range(min(shape) if matrix else 0):  # MATLAB's version 7.3 has them transposed
            yield f"{title}:{k + 1}", (value, (slice(None), k) if shape[1] < shape[0] else (k, slice(None)))
        if not matrix:
            yield title, (value, ())


def _structs(value: Any) -> list[Mapping[str, Any]]:
    """The structs in an array of structs; none in anything else."""
    several = value.tolist() if isinstance(value, np.ndarray) and value.dtype.kind == "O" else value
    return several if isinstance(several, list) and all(isinstance(one, Mapping) for one in several) else []
