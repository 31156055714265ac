"""Readers for files that are no text of rows: .npz, .mat, JSON, HDF5, Excel, Parquet, ROS 2 bags and MCAP.

Each reader takes a path, the columns that are wanted, {our name: the file's name}, or None for the names alone, and the
name of a joint, which bags have. None of them loads a pickle. They rest on compiled libraries, and are called in a
process in which a crash harms nothing (`sysid.data.guarded`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from sysid.data.bag import read_bag
from sysid.data.nested_columns import columns_within
from sysid.data.table import seconds
from sysid.data.text_files import read_lines
from sysid.errors import InvalidInput
from sysid.limits import RAW_ROWS, check_size

Columns = Mapping[str, str] | None


def _npz(path: Path, columns: Columns, joint: str) -> dict[str, Any]:
    """NumPy's .npz, without arrays of objects, which are pickled."""
    with ZipFile(path) as file:
        sizes = {info.filename.removesuffix(".npy"): info.file_size for info in file.infolist()}
    if columns is None:
        return dict.fromkeys(sizes)
    for name in columns.values():
        check_size(f"{path.name}: numbers in {name!r}:", sizes[name] / 8.0, RAW_ROWS)
    with np.load(path, allow_pickle=False) as arrays:
        return {ours: arrays[name] for ours, name in columns.items()}


def _mat(path: Path, columns: Columns, joint: str) -> dict[str, Any]:
    """A .mat file of MATLAB's versions 4 to 7.2; fields of structs and columns of matrices count as columns."""
    from scipy.io import loadmat, whosmat

    with suppress(TypeError):  # of objects, which are passed over
        for name, shape, _ in whosmat(path):
            check_size(f"{path.name}: numbers in {name!r}:", math.prod(shape), RAW_ROWS)
    content = loadmat(path, simplify_cells=True)
    return _chosen({name: content[name] for name in content if name and not name.startswith("__")}, columns)


def _json(path: Path, columns: Columns, joint: str) -> dict[str, Any]:
    """JSON: lists of numbers by their names, or a list of records, or a record in each line; members of objects and
    columns of lists of lists count as columns, named as those of a .mat file are."""
    text = path.read_text(encoding="utf-8-sig")
    try:
        content = json.loads(text)
    except json.JSONDecodeError:
        content = [json.loads(line) for line in text.splitlines() if line.strip()]
    members = _as_arrays(content)
    return _chosen(members if isinstance(members, Mapping) else {"rows": members}, columns)


def _as_arrays(value: Any) -> Any:
    """What JSON holds, with lists as arrays, nan for null, and lists of records as records of arrays."""
    if isinstance(value, dict):
        return {name: _as_arrays(member) for name, member in value.items()}
    if not isinstance(value, list):
        return value
    if value and all(isinstance(one, dict) for one in value):
        names = dict.fromkeys(name for record in value for name in record)
        return {name: _as_arrays([record.get(name) for record in value]) for name in names}
    try:
        return np.array([math.nan if one is None else one for one in value], dtype=float)
    except (TypeError, ValueError):
        return np.array(value, dtype=object)


def _chosen(members: Mapping[str, Any], columns: Columns) -> dict[str, Any]:
    """The columns in these members that are wanted, or all."""
    arrays = {title: value[at] if at else value for title, (value, at) in columns_within(members).items()}
    return arrays if columns is None else {ours: arrays[name] for ours, name in columns.items()}


def _hdf5(path: Path, columns: Columns, joint: str) -> dict[str, Any]:
    """An HDF5 file, such as MATLAB's version 7.3 writes; members of its groups (structs) and columns of its matrices
    count as columns, named as those of a .mat file are.

    Only what the file itself holds is read: links out of it are passed over, and columns stored elsewhere are refused.
    """
    import h5py

    with h5py.File(path, "r") as file:
        sets = columns_within(_members(h5py, file))
        if columns is None:
            return dict.fromkeys(sets)
        arrays = {}
        for ours, name in columns.items():
            item, at = sets[name]
            check_size(f"{path.name}: numbers in {name!r}:", math.prod(item.shape or ()), RAW_ROWS)
            if item.is_virtual or item.external:
                raise InvalidInput(f"{path.name}: {name!r} lies in other files: expected it in this one")
            arrays[ours] = item[at]
        return arrays


def _members(h5py: Any, group: Any) -> dict[str, Any]:
    """The members that a group itself holds, and theirs, without MATLAB's internal ones and without links elsewhere."""
    members: dict[str, Any] = {}
    for name in group:
        if not name.startswith("#") and isinstance(group.get(name, getlink=True), h5py.HardLink):
            item = group[name]
            members[name] = _members(h5py, item) if isinstance(item, h5py.Group) else item
    return members


def _xlsx(path: Path, columns: Columns, joint: str) -> dict[str, Any]:
    """The first sheet of an Excel workbook that is not empty, read as a text is."""
    from openpyxl import load_workbook

    with path.open("rb") as file:  # of a path it would ask for its own suffix
        for sheet in load_workbook(file, read_only=True, data_only=True).worksheets:
            check_size(f"{path.name}: rows:", sheet.max_row or 0, RAW_ROWS)
            lines = ["\t".join(map(_text, row)) for row in sheet.values]
            if any(map(str.strip, lines)):
                return read_lines(path.name, lines, columns)
    raise InvalidInput(f"{path.name} has no sheet that is not empty")


def _text(cell: Any) -> str:
    """What a cell of a workbook holds, as a text has it."""
    if isinstance(cell, datetime):
        return cell.isoformat()
    return "" if cell is None else " ".join(str(cell).split())


def _parquet(path: Path, columns: Columns, joint: str) -> dict[str, Any]:
    """A Parquet file; time stamps become seconds since the first row."""
    from pyarrow import parquet

    file = parquet.ParquetFile(path)
    names = file.schema_arrow.names
    if columns is None:
        if len(set(names)) < len(names):
            raise InvalidInput(f"{path.name}: a column comes twice: expected names that differ")
        return dict.fromkeys(names)
    check_size(f"{path.name}: rows:", file.metadata.num_rows, RAW_ROWS)
    table = file.read(list(dict.fromkeys(columns.values())), use_threads=False)
    return {ours: _numbers(path, name, table[name]) for ours, name in columns.items()}


def _numbers(path: Path, name: str, values: Any) -> Any:
    """The values of a column of a Parquet file, nan where it has none."""
    import pyarrow as pa

    kind, types = values.type, pa.types
    if types.is_timestamp(kind) or types.is_duration(kind):
        unit = pa.duration("ns") if types.is_duration(kind) else pa.timestamp("ns", kind.tz)
        whole = values.cast(unit).cast(pa.int64()).fill_null(0).to_numpy()
        return seconds(whole, values.is_null().to_numpy())
    if not (types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind) or types.is_null(kind)):
        raise InvalidInput(f"{path.name}: {name!r} holds {kind}, not numbers: expected numbers")
    if types.is_boolean(kind):
        values = values.cast(pa.int8())
    return np.asarray(values.cast(pa.float64(), safe=False).to_numpy(), dtype=float)


READERS: dict[str, tuple[Callable[[Path, Columns, str], dict[str, Any]], str]] = {
    "npz": (_npz, "an .npz file of plain arrays: expected one as numpy.savez makes it"),
    "mat": (_mat, "a .mat file: expected one as MATLAB's save makes it"),
    "hdf5": (_hdf5, "an HDF5 or MATLAB v7.3 file that is whole"),
    "parquet": (_parquet, "a Parquet file that is whole"),
    "xlsx": (_xlsx, "an Excel workbook that is whole"),
    "json": (_json, "JSON that is whole: expected lists of numbers, or a list of records"),
    "bag": (read_bag, "a ROS 2 bag or MCAP file that is whole: expected messages of ROS 2, serialized as CDR"),
}
"""The reader of each format, and what its error message says that a file should have been."""
