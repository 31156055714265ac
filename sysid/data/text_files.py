"""Text files of logs: rows of numbers that commas, semicolons, tabs or blanks part, below a row of names."""

from __future__ import annotations

import codecs
import csv
import math
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np

from sysid.data.table import Table
from sysid.data.text_head import DECIMAL_COMMA, SAMPLE, Head, cells, head, is_empty
from sysid.errors import InvalidInput
from sysid.limits import RAW_ROWS, check_size
from sysid.physics.ops import Array

CHUNK = 1 << 24
"""Bytes of text that are turned into numbers at once."""
EXPECTED = "expected CSV, JSON, .npz, .mat, .xlsx, Parquet, or a ROS 2 bag or MCAP"
BINARY = re.compile(rb"[\x00-\x08\x0e-\x1f]")


def header(path: Path) -> tuple[str, ...]:
    """The names of the columns; raises InvalidInput for what is no log."""
    with _text(path) as file:
        return _head(path.name, _first_lines(file)).names


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


def _first_lines(file: TextIO) -> list[str]:
    """The lines from which the head of a file is told."""
    lines = [file.readline()]
    while lines[-1] and len(lines) < SAMPLE and sum(map(len, lines)) < CHUNK // SAMPLE:
        lines.append(file.readline())
    return lines


def _head(name: str, lines: Sequence[str]) -> Head:
    """The head of a log of this name that begins with these lines; raises InvalidInput for what is no log."""
    if any("\0" in line for line in lines):
        raise InvalidInput(f"{name} is not a text file: {EXPECTED}")
    begun = head(lines)
    if begun is None:
        raise InvalidInput(f"{name} is empty: expected a row that names the columns, then numbers")
    twice = [title for title, times in Counter(filter(None, begun.names)).items() if times > 1]
    if twice:
        raise InvalidInput(f"{name}: column {twice[0]!r} comes twice")
    return begun


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
        lines = _first_lines(file)
        begun = _head(path.name, lines)
        lines, number, blocks = lines[begun.above :], begun.above, [np.empty((0, len(columns)))]
        while lines := lines or file.readlines(CHUNK):
            blocks.append(_numbers(path.name, lines, begun, columns, number, stamps))
            number += len(lines)
            check_size(f"{path.name}: rows, of those read so far:", sum(map(len, blocks)), RAW_ROWS, "in shorter files")
            lines = []
    return dict(zip(columns, np.concatenate(blocks).T.copy(), strict=True))


def read_lines(name: str, lines: Sequence[str], columns: Mapping[str, str] | None) -> dict[str, Array | None]:
    """The columns in all lines of a log, as `load_text` reads them, or for None the names of all columns."""
    begun = _head(name, lines[:SAMPLE])
    if columns is None:
        return dict.fromkeys(filter(None, begun.names))
    numbers = _numbers(name, lines[begun.above :], begun, columns, begun.above, _Stamps())
    return dict(zip(columns, numbers.T, strict=True))


def _numbers(
    name: str, lines: Sequence[str], begun: Head, columns: Mapping[str, str], before: int, stamps: _Stamps
) -> Array:
    """The cells (rows, columns) of the columns in some lines; `before` lines stand above them."""
    where = {ours: begun.names.index(theirs) for ours, theirs in columns.items()}
    split = None if begun.delimiter == " " else begun.delimiter
    commas = begun.delimiter != "," and any("," in line for line in lines)
    pointed = [DECIMAL_COMMA.sub(".", line) for line in lines] if commas else lines
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            used = list(where.values())
            numbers = np.loadtxt(pointed, delimiter=split, usecols=used, ndmin=2, comments="#", quotechar='"')
        return numbers.reshape(-1, len(where))
    except (ValueError, IndexError):
        pass
    rows = []
    for k, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        row = cells(line, begun.delimiter)
        if len(row) <= max(where.values()):
            if k < len(lines):
                raise InvalidInput(f"{name}, line {before + k}: {len(row)} cells, expected {len(begun.names)}")
            row += [""] * len(begun.names)  # the logger died in the middle of the last line
        place = f"{name}, line {before + k}"
        rows.append(
            [_number(row[i], f"{place}: {begun.names[i]}", stamps if n == "t" else None) for n, i in where.items()]
        )
    return np.array(rows, dtype=float).reshape(-1, len(where))


def _number(cell: str, place: str, stamps: _Stamps | None) -> float:
    text = cell.strip()
    if is_empty(text):
        return math.nan
    with suppress(ValueError):
        return float(text)
    with suppress(ValueError):
        if stamps:
            return stamps.seconds(text)
    raise InvalidInput(f"{place} is {text!r}, expected a number (with a decimal point)")
