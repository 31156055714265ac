"""Text files of logs: CSV with commas, semicolons, tabs or blanks, a first row of names, then numbers."""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np

from sysid.data.table import Table
from sysid.errors import InvalidInput
from sysid.limits import RAW_ROWS, check_size
from sysid.physics.ops import Array

CHUNK = 1 << 24
"""Bytes of text that are turned into numbers at once."""
DELIMITERS = (",", ";", "\t")
EMPTY_CELLS = frozenset({"", "nan", "na", "n/a", "none", "null", "-", "--"})
NO_TEXT = "is not a text file: expected CSV in UTF-8, .npz, .mat, Parquet, or a ROS 2 bag or MCAP"


def header(path: Path) -> tuple[str, ...]:
    """The names of the columns; raises InvalidInput for what is no log."""
    with _text(path) as file:
        return _header(path, file)[0]


@contextmanager
def _text(path: Path) -> Iterator[TextIO]:
    """Open a file as text; raises InvalidInput if it turns out to be none."""
    try:
        with open(path, newline=None, encoding="utf-8-sig") as file:
            yield file
    except (UnicodeDecodeError, csv.Error):
        raise InvalidInput(f"{path.name} {NO_TEXT}") from None
    except OSError as error:
        raise InvalidInput(f"cannot read {path}: {error.strerror}") from None


def _header(path: Path, file: TextIO) -> tuple[tuple[str, ...], str, int]:
    """The names in the first row, the delimiter, and how many lines were used up."""
    for number, line in enumerate(file, start=1):
        if "\0" in line:
            raise InvalidInput(f"{path.name} {NO_TEXT}")
        text = line.strip().lstrip("#").strip()
        delimiter = max(DELIMITERS, key=text.count)
        delimiter = delimiter if delimiter in text else " "
        if not text or (line.lstrip().startswith("#") and delimiter == " "):
            continue
        names = tuple(cell.strip() for cell in _cells(text, delimiter))
        if all(_is_number(name) for name in names):
            raise InvalidInput(f"{path.name} begins with numbers: expected a first row that names the columns")
        twice = [n for n in names if n and names.count(n) > 1]
        if twice:
            raise InvalidInput(f"{path.name}: column {twice[0]!r} comes twice")
        return names, delimiter, number
    raise InvalidInput(f"{path.name} is empty: expected a row that names the columns, then numbers")


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter), [])


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def load_text(path: Path, columns: Mapping[str, str]) -> Table:
    """The columns {our name: the file's name}; missing numbers are nan.

    Raises InvalidInput, with the place, for text where a number is expected, and as soon as there are too many rows.
    """
    with _text(path) as file:
        names, delimiter, number = _header(path, file)
        where = [names.index(c) for c in columns.values()]
        blocks = [np.empty((0, len(where)))]
        while lines := file.readlines(CHUNK):
            blocks.append(_numbers(path, lines, delimiter, where, names, number))
            number += len(lines)
            check_size(f"{path.name}: rows, of those read so far:", sum(map(len, blocks)), RAW_ROWS, "in shorter files")
    return dict(zip(columns, np.concatenate(blocks).T.copy(), strict=True))


def _numbers(
    path: Path, lines: Sequence[str], delimiter: str, where: Sequence[int], names: Sequence[str], before: int
) -> Array:
    """The wanted cells (rows, columns) of some lines; `before` lines stand above them."""
    split = None if delimiter == " " else delimiter
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            numbers = np.loadtxt(lines, delimiter=split, usecols=where, ndmin=2, comments="#", quotechar='"')
        return numbers.reshape(-1, len(where))
    except (ValueError, IndexError):
        pass
    rows = []
    for k, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = _cells(line, delimiter)
        if len(cells) <= max(where):
            if k < len(lines):
                raise InvalidInput(f"{path.name}, line {before + k}: {len(cells)} cells, expected {len(names)}")
            cells += [""] * len(names)  # the logger died in the middle of the last line
        rows.append([_number(cells[i], f"{path.name}, line {before + k}: {names[i]}") for i in where])
    return np.array(rows, dtype=float).reshape(-1, len(where))


def _number(cell: str, place: str) -> float:
    text = cell.strip()
    if text.lower() in EMPTY_CELLS:
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{place} is {text!r}, expected a number (with a decimal point)") from None
