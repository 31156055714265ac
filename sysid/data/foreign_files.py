"""Readers for the formats of other programs: NumPy's .npz, Matlab's .mat, HDF5, Parquet, ROS 2 bags and MCAP.

Each reader takes a path, the columns that are wanted, {our name: the file's name}, or None for the names alone, and the
name of a joint, which bags have. None of them loads a pickle. They rest on compiled libraries, and are called in a
process in which a crash harms nothing (`sysid.data.guarded`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from sysid.data.bag import read_bag
from sysid.data.table import seconds
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
    """A .mat file of MATLAB's versions 4 to 7.2; the fields of its structs count as columns."""
    from scipy.io import loadmat, whosmat

    for name, shape, _ in whosmat(path):
        check_size(f"{path.name}: numbers in {name!r}:", math.prod(shape), RAW_ROWS)
    content = loadmat(path, simplify_cells=True)
    arrays: dict[str, Any] = {}
    for name, value in content.items():
        if not name.startswith("__"):
            arrays.update(value if isinstance(value, dict) else {name: value})
    return arrays if columns is None else {ours: arrays[name] for ours, name in columns.items()}


def _hdf5(path: Path, columns: Columns, joint: str) -> dict[str, Any]:
    """An HDF5 file, such as MATLAB's version 7.3 writes; the members of its groups (structs) count as columns.

    Only what the file itself holds is read: links out of it are passed over, and columns stored elsewhere are refused.
    """
    import h5py

    with h5py.File(path, "r") as file:
        members: dict[str, Any] = {}
        for name, item in _members(h5py, file):
            members.update(dict(_members(h5py, item)) if isinstance(item, h5py.Group) else {name: item})
        sets = {name: item for name, item in members.items() if isinstance(item, h5py.Dataset)}
        if columns is None:
            return dict.fromkeys(sets)
        for name in columns.values():
            check_size(f"{path.name}: numbers in {name!r}:", math.prod(sets[name].shape or ()), RAW_ROWS)
            if sets[name].is_virtual or sets[name].external:
                raise InvalidInput(f"{path.name}: {name!r} lies in other files: expected it in this one")
        return {ours: sets[name][()] for ours, name in columns.items()}


def _members(h5py: Any, group: Any) -> Iterator[tuple[str, Any]]:
    """The members that a group itself holds, without MATLAB's internal ones and without links to elsewhere."""
    for name in group:
        if not name.startswith("#") and isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, group[name]


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
    "bag": (read_bag, "a ROS 2 bag or MCAP file that is whole: expected messages of ROS 2, serialized as CDR"),
}
"""The reader of each format, and what its error message says that a file should have been."""
