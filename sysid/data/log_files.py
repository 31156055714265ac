"""Sources of logs: files of any of the formats, recognised by content and not by name, and DataFrames."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from sysid.data import text_files
from sysid.data.bag import MCAP
from sysid.data.files import check_input, check_installed, file_errors, full_path
from sysid.data.guarded import read_guarded
from sysid.data.table import Table, column, rows_of, seconds
from sysid.errors import InvalidInput, check_kind, printable

BEGINS = {
    b"PK\3\4": "npz",
    b"PK\5\6": "npz",
    b"\x89HDF\r\n\x1a\n": "hdf5",
    b"PAR1": "parquet",
    MCAP: "bag",
    b"SQLite format 3\0": "bag",
    b"#ROSBAG V": "bag of ROS 1",
}
"""The first bytes of a file of each format; a text file begins with none of these."""
NEEDS = {"hdf5": "h5py", "parquet": "pyarrow", "bag": "rosbags", "xlsx": "openpyxl"}
"""The package that reads a format; all are in the extra [files]."""
IN_WORKBOOK = (b"[Content_Types].xml", b"docProps/", b"xl/", b"_rels/")
"""How the first file of a zip archive is called if the archive is a workbook of Excel."""
JSON = re.compile(rb"\s*(\{|\[\s*[\[{\d-])")
"""How JSON begins; a text may begin with a word in brackets."""
CLOCK = "(the row's time)"
"""The column t of a log whose rows have none."""


@dataclass(frozen=True, eq=False)
class Source:
    """A log that can be read.

    name   what sentences call it
    title  what its rollouts are called
    names  the names of its columns
    load   reads columns {our name: the log's name}; missing numbers are nan
    """

    name: str
    title: str
    names: tuple[str, ...]
    load: Callable[[Mapping[str, str]], Table]

    def timed(self, dt: float) -> Source:
        """The source with one column more, CLOCK: the time [s] of rows that were written every dt [s]."""

        def load(columns: Mapping[str, str]) -> Table:
            table = self.load({ours: theirs for ours, theirs in columns.items() if theirs != CLOCK})
            rows = len(next(iter(table.values())))
            return table | {"t": dt * np.arange(rows, dtype=float)}

        return replace(self, names=(*self.names, CLOCK), load=load)


def sources(given: Iterable[Any], joint: str = "") -> Iterator[Source]:
    """A Source for each path or DataFrame; its rollouts have the file's name, with the folder where two names agree.

    Raises InvalidInput for what is no log, for a file that cannot be read or is given twice, and if a joint is asked
    for of what is no bag.
    """
    logs = [log for one in given for log in (one if _is_several(one) else [one])]
    if not logs:
        raise InvalidInput("no log was given: expected one or more files, or DataFrames")
    for log in logs:
        if not _is_frame(log):
            check_kind("a log", log, str | PathLike, "a path or a DataFrame, as pandas makes one of arrays")
    paths = [full_path(Path(log), "read") for log in logs if not _is_frame(log)]
    for path in paths:
        if paths.count(path) > 1:
            raise InvalidInput(f"{path.name} is given twice: what is held out of one would be fitted in the other")
    for path in (Path(log) for log in logs if not _is_frame(log)):
        if not path.is_dir():  # of a folder, `_kind` says what it is
            check_input(path, "a log file", math.inf)
    frames, stems = sum(map(_is_frame, logs)), [Path(log).stem for log in logs if not _is_frame(log)]
    frame = 0
    for log in logs:
        if _is_frame(log):
            frame += 1
            name = f"DataFrame {frame}" if frames > 1 else "DataFrame"
            yield _arrays(name, name, partial(_frame, log, name))
        else:
            path = Path(log)
            title = f"{path.parent.name}/{path.stem}" if stems.count(path.stem) > 1 else path.stem
            yield _file(path, title, joint)


def _is_several(log: Any) -> bool:
    return isinstance(log, Iterable) and not (_is_frame(log) or isinstance(log, str | PathLike))


def _is_frame(log: Any) -> bool:
    return all(hasattr(log, name) for name in ("columns", "iloc", "reset_index"))


def _file(path: Path, title: str, joint: str) -> Source:
    kind = _kind(path)
    if joint and kind != "bag":
        raise InvalidInput(f"{path.name} has no joints to choose from: expected a ROS 2 bag or MCAP file")
    if kind == "text":
        return Source(path.name, title, text_files.header(path), partial(text_files.load_text, path))
    if kind in NEEDS:
        check_installed(NEEDS[kind], "files", f"{path.name}: reading its format ({kind})")
    return _arrays(path.name, title, partial(read_guarded, kind, path, joint))


def _arrays(name: str, title: str, read: Callable[[Mapping[str, str] | None], Mapping[str, Any]]) -> Source:
    """A Source of whole arrays; `read` gives the columns that are wanted or, for None, the names of all."""

    def load(columns: Mapping[str, str]) -> Table:
        return rows_of(name, {ours: column(name, columns[ours], values) for ours, values in read(columns).items()})

    return Source(name, title, tuple(read(None)), load)


def _kind(path: Path) -> str:
    """The format of a file, by its content. Raises InvalidInput for what cannot be read."""
    with file_errors(path, "read"):
        if full_path(path, "read").is_dir() and (path / "metadata.yaml").exists():
            return "bag"
        check_input(path, "a log file", math.inf)
        with path.open("rb") as file:
            begin = file.read(1024)
    if begin.startswith(b"PK\3\4") and begin[30:].startswith(IN_WORKBOOK):
        return "xlsx"
    for mark, kind in BEGINS.items():
        if begin.startswith(mark):
            if kind == "bag of ROS 1":
                raise InvalidInput(f"{path.name} is a bag of ROS 1: expected one of ROS 2 (rosbags-convert makes one)")
            return kind
    if JSON.match(begin.removeprefix(codecs.BOM_UTF8)):
        return "json"
    if begin[512:520] == b"\x89HDF\r\n\x1a\n":  # behind MATLAB's own header
        return "hdf5"
    return "mat" if begin[124:128] in (b"\0\1IM", b"\1\0MI") or _is_mat_4(begin) else "text"


def _is_mat_4(begin: bytes) -> bool:
    """Whether a file begins as MATLAB's version 4: with the type of a matrix, its size, and the length of its name."""
    heads = [np.frombuffer(begin[:20], order).tolist() for order in ("<i4", ">i4")] if len(begin) >= 20 else []
    return any(
        0 <= kind < 5000 and kind // 100 % 10 == 0 and kind % 10 < 3 and imaginary in (0, 1) and 0 < name < 1000
        for kind, _, _, imaginary, name in heads
    )


def _frame(frame: Any, name: str, columns: Mapping[str, str] | None) -> dict[str, Any]:
    """The columns of a DataFrame, its index among them where it has a name; times become seconds since the first."""
    if any(index is not None for index in frame.index.names):
        try:
            frame = frame.reset_index()
        except ValueError:
            raise InvalidInput(f"{name}: its index has the name of a column: expected names that differ") from None
    names = [printable(str(title)) for title in frame.columns]
    if len(set(names)) < len(names):
        raise InvalidInput(f"{name}: a column comes twice: expected names that differ")
    if columns is None:
        return dict.fromkeys(names)
    return {ours: _series(frame.iloc[:, names.index(title)]) for ours, title in columns.items()}


def _series(series: Any) -> Any:
    kind = series.dtype.kind
    if kind in "Mm":
        unit = "datetime64[ns]" if kind == "M" else "timedelta64[ns]"
        return seconds(series.to_numpy(dtype=unit).astype("int64"), series.isna().to_numpy())
    return series.to_numpy(dtype=float, na_value=math.nan) if kind in "fiub" else series.to_numpy()
