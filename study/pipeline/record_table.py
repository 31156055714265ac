"""A table of a results folder, whose rows are values of a frozen dataclass or a NamedTuple.

a text, a number                           a column
a NamedTuple, a tuple of fixed length      a column an entry
everything else                            a column of JSON
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import NoneType
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

R = TypeVar("R")


@dataclass(frozen=True)
class Table(Generic[R]):
    """A table of values of a kind; columns: as in CREATE TABLE, the first `keys` of them tell rows apart."""

    name: str
    kind: type[R]
    columns: str
    keys: int

    @property
    def key(self) -> str:
        return ", ".join(column.split()[0] for column in self.columns.split(",")[: self.keys])

    @property
    def schema(self) -> str:
        return f"CREATE TABLE {self.name} ({self.columns}, PRIMARY KEY ({self.key}));"

    @cached_property
    def _fields(self) -> dict[str, tuple[int, Callable[..., Any]]]:
        """Of each field how many columns it has, and what makes its value of them."""
        return {name: _field(hint) for name, hint in get_type_hints(self.kind).items()}

    def row(self, value: R) -> list[Any]:
        cells: list[Any] = []
        for name, (width, _) in self._fields.items():
            own = getattr(value, name)
            cells += own if width > 1 else [json.dumps(own) if isinstance(own, dict | tuple | NoneType) else own]
        return cells

    def value(self, row: Sequence[Any]) -> R:
        cells = iter(row)
        return self.kind(*(make(*(next(cells) for _ in range(width))) for width, make in self._fields.values()))


def _field(hint: Any) -> tuple[int, Callable[..., Any]]:
    parts = get_args(hint)
    if hint in (str, int, float):
        return 1, lambda cell: cell
    if hasattr(hint, "_fields"):
        return len(hint._fields), hint
    if get_origin(hint) is tuple and parts[-1] is not ...:
        return len(parts), lambda *cells: cells
    make = _of_json(hint)
    return 1, lambda cell: make(json.loads(cell))


def _of_json(hint: Any) -> Callable[[Any], Any]:
    """What makes a value of a type of plain data, in which tuples are lists."""
    origin, parts = get_origin(hint), get_args(hint)
    if NoneType in parts:
        return lambda data: None if data is None else parts[0](*data)
    if origin is dict and get_origin(parts[1]) is tuple:
        return lambda data: {name: tuple(own) for name, own in data.items()}
    if origin is tuple:
        return (lambda data: tuple(map(tuple, data))) if get_origin(parts[0]) is tuple else tuple
    return lambda data: data
