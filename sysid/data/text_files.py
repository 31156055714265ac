"""Text files of logs: CSV with commas, semicolons, tabs or blanks, a first row of names if there is one, then numbers.

Numbers may have decimal commas where commas do not part them. Without a row of names the columns are called 1, 2, ...
"""

from __future__ import annotations

import codecs
import csv
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np

from sysid.data.table import Table
from sysid.errors import InvalidInput
from sysid.limits import RAW_ROWS, check_size
from sysid.physics.ops import Array

CHUNK = 1 << 24
"""Bytes of text that are turned into numbers at once."""
DELIMITERS = (",", ";", "\t")
EMPTY_CELLS = frozenset({"", "nan", "na", "n/a", "none", "null", "-", "--"})
EXPECTED = "expected CSV, JSON, .npz, .mat, .xlsx, Parquet, or a ROS 2 bag or MCAP"
BINARY = re.compile(rb"[\x00-\x08\x0e-\x1f]")
DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")


class _Head(NamedTuple):
    """How a file begins: the names of its columns, the delimiter, how many lines stand above its numbers, and those of
    the numbers that were read already."""

    names: tuple[str, ...]
    delimiter: str
    above: int
    begun: list[str]


def header(path: Path) -> tuple[str, ...]:
    """The names of the columns; raises InvalidInput for what is no log."""
    with _text(path) as file:
        return _head(path, file).names


@contextmanager
def _text(path: Path) -> Iterator[TextIO]:
    """Open a file as text; raises InvalidInput if it turns out to be none."""
    try:
        with open(path, newline=None, encoding=_encoding(path)) as file:
            yield file
    except (UnicodeError, csv.Error):
        raise InvalidInput(f"{path.name} is not a text file: {EXPECTED}") from None
    except OSError as error:
        raise InvalidInput(f"cannot read {path}: {error.strerror}") from None


def _encoding(path: Path) -> str:
    """UTF-8, or UTF-16 if the first bytes say so, or what Windows writes in western languages; raises UnicodeError for
    what is no text."""
    with path.open("rb") as file:
        begin = file.read(1 << 16)
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(begin)  # the last character may be cut
    except UnicodeDecodeError:
        if BINARY.search(begin):
            raise
        return "cp1252"
    return "utf-8-sig"


def _head(path: Path, file: TextIO) -> _Head:
    for number, line in enumerate(file, start=1):
        if "\0" in line:
            raise InvalidInput(f"{path.name} is not a text file: {EXPECTED}")
        text, comment = line.strip().lstrip("#").strip(), line.lstrip().startswith("#")
        delimiter = next((d for d in (";", "\t", " ") if d in text and _are_numbers(_with_points(text), d)), None)
        if delimiter is None:
            delimiter = max(DELIMITERS, key=text.count)
            delimiter = delimiter if delimiter in text else " "
        numbers = _are_numbers(_with_points(text) if delimiter != "," else text, delimiter)
        if not text or (comment and (delimiter == " " or numbers)):
            continue
        cells = _cells(text, delimiter)
        if numbers:
            return _Head(tuple(str(k + 1) for k in range(len(cells))), delimiter, number - 1, [line])
        names = tuple(cell.strip() for cell in cells)
        twice = [n for n in names if n and names.count(n) > 1]
        if twice:
            raise InvalidInput(f"{path.name}: column {twice[0]!r} comes twice")
        return _Head(names, delimiter, number, [])
    raise InvalidInput(f"{path.name} is empty: expected a row that names the columns, then numbers")


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])


def _with_points(line: str) -> str:
    """A line with decimal points in place of decimal commas."""
    return DECIMAL_COMMA.sub(".", line)


def _are_numbers(line: str, delimiter: str) -> bool:
    """Whether a line holds numbers and empty cells only."""
    cells = [cell.strip() for cell in _cells(line, delimiter)]
    filled = [cell for cell in cells if cell.lower() not in EMPTY_CELLS]
    return bool(filled) and all(map(_is_number, filled))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


class _Stamps:
    """Turns dates with times, as ISO 8601 writes them, into seconds since the first."""

    first: datetime | None = None

    def seconds(self, text: str) -> float:
        """The seconds of a stamp; raises ValueError for what is none. Without a time zone it is taken for UTC."""
        stamp = datetime.fromisoformat(text)
        stamp = stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)
        self.first = self.first or stamp
        return (stamp - self.first).total_seconds()


def load_text(path: Path, columns: Mapping[str, str]) -> Table:
    """The columns {our name: the file's name}; missing numbers are nan, and dates in t become seconds since the first.

    Raises InvalidInput, with the place, for text where a number is expected, and as soon as there are too many rows.
    """
    stamps = _Stamps()
    with _text(path) as file:
        head = _head(path, file)
        where = {ours: head.names.index(theirs) for ours, theirs in columns.items()}
        blocks, number, lines = [np.empty((0, len(where)))], head.above, head.begun
        while lines := lines or file.readlines(CHUNK):
            blocks.append(_numbers(path, lines, head, where, number, stamps))
            number += len(lines)
            check_size(f"{path.name}: rows, of those read so far:", sum(map(len, blocks)), RAW_ROWS, "in shorter files")
            lines = []
    return dict(zip(columns, np.concatenate(blocks).T.copy(), strict=True))


def _numbers(
    path: Path, lines: Sequence[str], head: _Head, where: Mapping[str, int], before: int, stamps: _Stamps
) -> Array:
    """The wanted cells (rows, columns) of some lines; `before` lines stand above them."""
    split = None if head.delimiter == " " else head.delimiter
    if head.delimiter != "," and any("," in line for line in lines):
        lines = [_with_points(line) for line in lines]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            used = list(where.values())
            numbers = np.loadtxt(lines, delimiter=split, usecols=used, ndmin=2, comments="#", quotechar='"')
        return numbers.reshape(-1, len(where))
    except (ValueError, IndexError):
        pass
    rows = []
    for k, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = _cells(line, head.delimiter)
        if len(cells) <= max(where.values()):
            if k < len(lines):
                raise InvalidInput(f"{path.name}, line {before + k}: {len(cells)} cells, expected {len(head.names)}")
            cells += [""] * len(head.names)  # the logger died in the middle of the last line
        place = f"{path.name}, line {before + k}"
        rows.append(
            [_number(cells[i], f"{place}: {head.names[i]}", stamps if n == "t" else None) for n, i in where.items()]
        )
    return np.array(rows, dtype=float).reshape(-1, len(where))


def _number(cell: str, place: str, stamps: _Stamps | None) -> float:
    text = cell.strip()
    if text.lower() in EMPTY_CELLS:
        return math.nan
    for read in (float, stamps.seconds if stamps else float):
        try:
            return read(text)
        except ValueError:
            pass
    raise InvalidInput(f"{place} is {text!r}, expected a number (with a decimal point)")
