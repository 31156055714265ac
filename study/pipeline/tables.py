"""Tables whose rows are values of a frozen dataclass or a NamedTuple, in a results folder and as CSV.

In a results folder
    a text, a number                           is a column; nan: NULL
    a NamedTuple, a tuple of fixed length      a column an entry
    everything else                            a column of JSON
In a CSV file
    text, int, float (six digits, or empty for None), bool (yes, no), a tuple of texts (with blanks between them)
"""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar, get_args, get_origin, get_type_hints

from sysid import InvalidInput
from sysid.data.files import read_file, write_whole

R = TypeVar("R")


@dataclass(frozen=True)
class ResultTable(Generic[R]):
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

    def row(self, value: R) -> list[Any]:
        cells: list[Any] = []
        for name, (width, _) in _fields(self.kind).items():
            entry = getattr(value, name)
            cells += entry if width > 1 else [json.dumps(entry) if isinstance(entry, dict | tuple) else entry]
        return cells

    def value(self, row: Sequence[Any]) -> R:
        cells = iter(row)
        return self.kind(*(make(*(next(cells) for _ in range(width))) for width, make in _fields(self.kind).values()))


@cache
def _fields(kind: type[Any]) -> dict[str, tuple[int, Callable[..., Any]]]:
    """Of each field how many columns it has, and what makes its value of them."""
    return {name: _field(hint) for name, hint in get_type_hints(kind).items()}


def _field(hint: Any) -> tuple[int, Callable[..., Any]]:
    parts = get_args(hint)
    if hint in (str, int, float):
        return 1, lambda cell: math.nan if hint is float and cell is None else _exactly(hint, cell)
    if hasattr(hint, "_fields"):
        kinds = get_type_hints(hint).values()
        return len(kinds), lambda *cells: hint(*(_exactly(kind, cell) for kind, cell in zip(kinds, cells, strict=True)))
    if get_origin(hint) is tuple and parts[-1] is not ...:
        return len(parts), lambda *cells: tuple(_exactly(kind, cell) for kind, cell in zip(parts, cells, strict=True))
    make = _of_json(hint)
    return 1, lambda cell: make(json.loads(cell))


def _exactly(kind: Callable[[Any], Any], cell: Any) -> Any:
    """The cell as that kind; raises ValueError where it is of another, such as 3.7 where a whole number is expected."""
    value = kind(cell)
    if value != cell:
        raise ValueError
    return value


def _of_json(hint: Any) -> Callable[[Any], Any]:
    """What makes a value of a type of plain data, in which tuples are lists."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is dict and get_origin(parts[1]) is tuple:
        return lambda data: {name: tuple(values) for name, values in data.items()}
    if origin is tuple:
        return (lambda data: tuple(map(tuple, data))) if get_origin(parts[0]) is tuple else tuple
    return lambda data: data


_PARSE: dict[str, Callable[[str], Any]] = {
    "str": str,
    "int": int,
    "float": float,
    "float | None": lambda text: float(text) if text else None,
    "bool": lambda text: {"yes": True, "no": False}[text],
    "tuple[str, ...]": lambda text: tuple(text.split()),
}


def read_table(
    kind: type[R], path: Path, about: str, optional: bool = False, known: Mapping[str, Collection[str]] | None = None
) -> list[R]:
    """The rows of a table; a column whose field has a default may be missing or empty.

    optional: there are no rows where there is no file; known: what may stand in some columns. Raises InvalidInput for a
    file that is not `about` that.
    """
    if optional and not path.exists():
        return []
    columns = {f.name: _PARSE[str(f.type)] for f in dataclasses.fields(kind)}
    needed = [f.name for f in dataclasses.fields(kind) if f.default is dataclasses.MISSING]
    try:
        reader = csv.DictReader(read_file(path, f"a table of {about}").decode("utf-8-sig").splitlines())
        if missing := [name for name in needed if name not in (reader.fieldnames or ())]:
            raise InvalidInput(f"{path} has no column {missing[0]!r}: expected {', '.join(needed)}")
        rows = [_row(kind, columns, needed, row, f"{path}, line {line}") for line, row in enumerate(reader, 2)]
    except (UnicodeDecodeError, csv.Error):
        raise InvalidInput(f"{path} is not a table of {about}: expected CSV with columns {', '.join(needed)}") from None
    for column, allowed in (known or {}).items():
        if foreign := [entry for row in rows if (entry := getattr(row, column)) not in allowed]:
            expected = ", ".join(allowed)
            raise InvalidInput(f"{path} has a row of {column} {foreign[0]!r}: expected one of {expected}")
    return rows


def _row(
    kind: type[R], columns: Mapping[str, Callable[[str], Any]], needed: Collection[str], row: Mapping[str, str], at: str
) -> R:
    try:
        return kind(**{name: of(row[name]) for name, of in columns.items() if row.get(name) or name in needed})
    except (KeyError, ValueError, TypeError, AttributeError):
        raise InvalidInput(f"{at} does not hold the numbers of a row: expected {', '.join(columns)}") from None


def write_table(kind: type[R], path: Path, rows: Iterable[R]) -> None:
    """The rows as a CSV file; whole or not at all."""
    names = [f.name for f in dataclasses.fields(kind)]
    write_rows(path, names, (printed(getattr(row, name) for name in names) for row in rows))


def write_rows(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Rows of plain values as a CSV file; whole or not at all."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    write_whole(path, text.getvalue())


def printed(row: Iterable[object]) -> list[str]:
    """The cells of a row as a table holds them."""
    return [_text(value) for value in row]


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    return " ".join(value) if isinstance(value, tuple) else "" if value is None else str(value)
