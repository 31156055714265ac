"""A table of measured rows as CSV: a frozen dataclass is a row, its fields are the columns.

Fields are text, int, float (six digits, or empty for None), bool (yes, no) or a tuple of texts (with blanks between
them).
"""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from sysid import InvalidInput
from sysid.data.files import write_whole

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


def read_table(kind: type[R], path: Path, about: str) -> list[R]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file that is not `about` that."""
    if not path.exists():
        return []
    parse = {f.name: _PARSE[str(f.type)] for f in dataclasses.fields(kind)}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [kind(**{name: of(row[name]) for name, of in parse.items()}) for row in csv.DictReader(file)]
    except (KeyError, ValueError, TypeError, AttributeError, csv.Error):
        raise InvalidInput(f"{path} is not a table of {about}: expected one that this command wrote") from None


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
