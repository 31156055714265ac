"""Log files: named columns of numbers, from CSV, .npz or .mat."""

from __future__ import annotations

import csv
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from sysid.data.files import check_input
from sysid.errors import InvalidInput
from sysid.limits import LOG_ROWS, RAW_ROWS, check_size
from sysid.physics.ops import Array

Table = dict[str, Array]

CHUNK = 1 << 24
"""Bytes of text that are turned into numbers at once."""
DELIMITERS = (",", ";", "\t")
EMPTY = frozenset({"", "nan", "na", "n/a", "none", "null", "-", "--"})


class Window(NamedTuple):
    """The rows that are wanted: begin <= t <= end [s], and no more than `most` of them."""

    begin: float = -math.inf
    end: float = math.inf
    most: int = LOG_ROWS


def header(path: Path) -> tuple[str, ...]:
    """The names of a log's columns; raises InvalidInput for what is no log."""
    check_input(path, "a log file", math.inf)
    if path.suffix.lower() in READERS:
        return tuple(READERS[path.suffix.lower()](path))
    with _text(path) as file:
        return _header(path, file)[0]


def load(path: Path, columns: Mapping[str, str], window: Window) -> Table:
    """The columns {our name: the file's name} of the rows inside the window of column "t"; missing numbers are nan.

    Raises InvalidInput, with the place, for text where a number is expected, and for more rows than the window admits.
    """
    if path.suffix.lower() in READERS:
        table = _stacked(path, {ours: v for ours, v in READERS[path.suffix.lower()](path, columns).items()})
        inside = ~((table["t"] < window.begin) | (table["t"] > window.end))
        table = {name: v[inside] for name, v in table.items()}
        _check_size(path, int(inside.sum()), inside.size, window.most)
        return table
    return _load_csv(path, columns, window)


def _check_size(path: Path, kept: int, rows: int, most: int) -> None:
    if kept > most:
        raise InvalidInput(
            f"{path.name} has about {_round(rows):,} rows, and more than {most:,} of them were asked for: "
            "cut a window (begin, end) or ask for a longer sample interval (dt)"
        )


def _round(rows: float) -> int:
    size = 10 ** max(int(math.log10(max(rows, 1.0))) - 1, 0)
    return int(round(rows / size) * size)


# ---- CSV -------------------------------------------------------------------------------------------------------------


@contextmanager
def _text(path: Path) -> Iterator[TextIO]:
    """The file as text; whatever shows that it is none becomes InvalidInput."""
    try:
        with open(path, newline=None, encoding="utf-8-sig") as file:
            yield file
    except (UnicodeDecodeError, csv.Error):
        raise InvalidInput(f"{path.name} is not a text file: expected CSV in UTF-8, .npz or .mat") from None
    except OSError as error:
        raise InvalidInput(f"cannot read {path}: {error.strerror}") from None


def _header(path: Path, file: TextIO) -> tuple[tuple[str, ...], str, int]:
    """The names in the first row, the delimiter, and how many lines were used up."""
    for number, line in enumerate(file, start=1):
        if "\0" in line:
            raise InvalidInput(f"{path.name} is not a text file: expected CSV in UTF-8, .npz or .mat")
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


def _load_csv(path: Path, columns: Mapping[str, str], window: Window) -> Table:
    with _text(path) as file:
        names, delimiter, number = _header(path, file)
        where = [names.index(c) for c in columns.values()]
        t = list(columns).index("t")
        blocks = [np.empty((0, len(where)))]
        kept = characters = rows = 0
        while lines := file.readlines(CHUNK):
            block = _numbers(path, lines, delimiter, where, names, number)
            number += len(lines)
            rows += len(block)
            characters += sum(map(len, lines))
            block = block[~((block[:, t] < window.begin) | (block[:, t] > window.end))]
            kept += len(block)
            _check_size(path, kept, int(rows * max(path.stat().st_size / characters, 1.0)), window.most)
            blocks.append(block)
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
    if text.lower() in EMPTY:
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{place} is {text!r}, expected a number (with a decimal point)") from None


# ---- arrays ----------------------------------------------------------------------------------------------------------


@contextmanager
def _foreign(path: Path, expected: str) -> Iterator[None]:
    """Whatever a reader of foreign bytes stumbles over becomes one sentence: a damaged file may raise anything."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InvalidInput:
        raise
    except Exception:
        raise InvalidInput(f"{path.name} is not {expected}") from None


def _npz(path: Path, columns: Mapping[str, str] | None = None) -> dict[str, Any]:
    """All names, or the wanted arrays, of an .npz file."""
    from zipfile import ZipFile

    with _foreign(path, "an .npz file of plain arrays: expected one as numpy.savez makes it"), ZipFile(path) as file:
        sizes = {info.filename.removesuffix(".npy"): info.file_size for info in file.infolist()}
        if columns is None:
            return dict.fromkeys(sizes)
        for name in columns.values():
            check_size(f"{path.name}: numbers in {name!r}:", sizes[name] / 8.0, RAW_ROWS)
        return {ours: _plain_array(file.read(f"{name}.npy")) for ours, name in columns.items()}


def _plain_array(content: bytes) -> Array:
    """An .npy file's array, which holds as many numbers as there are bytes, whatever its header claims."""
    file = BytesIO(content)
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, kind = read_header(file)
    return np.frombuffer(content, kind, offset=file.tell()).reshape(shape, order="F" if fortran else "C").astype(float)


def _mat(path: Path, columns: Mapping[str, str] | None = None) -> dict[str, Any]:
    """All names, or the wanted arrays, of a .mat file; the fields of its structs count as columns."""
    from scipy.io import loadmat, whosmat

    with _foreign(path, "a .mat file: expected one as MATLAB's save -v7 makes it"):
        try:
            sizes = {name: math.prod(shape) for name, shape, _ in whosmat(path)}
        except NotImplementedError:
            raise InvalidInput(f"{path.name} is a MATLAB v7.3 file: save it with -v7") from None
        for name, size in sizes.items():
            check_size(f"{path.name}: numbers in {name!r}:", size, RAW_ROWS)
        content = loadmat(path, simplify_cells=True)
    arrays: dict[str, Any] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            arrays.update(value if isinstance(value, dict) else {name: value})
    return arrays if columns is None else {ours: arrays[name] for ours, name in columns.items()}


READERS: dict[str, Callable[..., dict[str, Any]]] = {".npz": _npz, ".mat": _mat}


def _stacked(path: Path, arrays: Mapping[str, Any]) -> Table:
    """The arrays as columns of one length: (K,), also from (K, 1) and (1, K); a torque of K - 1 rows gets one more."""
    table = {}
    for name, value in arrays.items():
        try:
            column = np.squeeze(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            raise InvalidInput(f"{path.name}: {name} is not an array of numbers") from None
        if column.ndim > 1:
            raise InvalidInput(f"{path.name}: {name} has shape {column.shape}: expected one dimension")
        table[name] = np.atleast_1d(column)
    rows = len(table["t"])
    for name, column in table.items():
        if name in ("torque", "theta_dot") and len(column) == rows - 1:
            table[name] = np.append(column, math.nan)
        elif len(column) != rows:
            raise InvalidInput(f"{path.name} is ragged: {name} has {len(column)} values, t has {rows}")
    return table
