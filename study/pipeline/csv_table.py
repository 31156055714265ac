"""A table of measured rows as CSV: a frozen dataclass is a row, its fields are the columns.

Fields are text, int, float (six digits, or empty for None), bool (yes, no) or a tuple of texts (with blanks between
them).
"""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from sysid import InvalidInput
from sysid.data.files import read_file, write_whole

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    R = TypeVar("R", bound=DataclassInstance)
else:
    R = TypeVar("R")

_PARSE: dict[str, Callable[[str], Any]] = {
    "str": str,
    "int": int,
    "float": float,
    "float | None": lambda text: float(text) if text else None,
    "bool": lambda text: {"yes": True, "no": False}[text],
    "tuple[str, ...]": lambda text: tuple(text.split()),
}


def read_table(kind: type[R], path: Path, about: str, optional: bool = False) -> list[R]:
    """The rows of a table; a column whose field has a default may be missing or empty.

    optional: there are no rows where there is no file. Raises InvalidInput for a file that is not `about` that.
    """
    if optional and not path.exists():
        return []
    columns = {f.name: _PARSE[str(f.type)] for f in dataclasses.fields(kind)}
    needed = [f.name for f in dataclasses.fields(kind) if f.default is dataclasses.MISSING]
    try:
        reader = csv.DictReader(read_file(path, f"a table of {about}").decode("utf-8-sig").splitlines())
        if missing := [name for name in needed if name not in (reader.fieldnames or ())]:
            raise InvalidInput(f"{path} has no column {missing[0]!r}: expected {', '.join(needed)}")
        return [_row(kind, columns, needed, row, f"{path}, line {line}") for line, row in enumerate(reader, 2)]
    except (UnicodeDecodeError, csv.Error):
        raise InvalidInput(f"{path} is not a table of {about}: expected CSV with columns {', '.join(needed)}") from None


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
    write_csv(path, names, (printed(getattr(row, name) for name in names) for row in rows))


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
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
