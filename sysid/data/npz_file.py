"""NumPy's .npz files, whose arrays are taken out of their bytes: none is a pickle, none larger than what it holds."""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from sysid.data.foreign_files import foreign
from sysid.limits import RAW_ROWS, check_size
from sysid.physics.ops import Array


def read_npz(path: Path, columns: Mapping[str, str] | None = None) -> dict[str, Any]:
    """All names, or the wanted arrays {our name: the file's name}, of an .npz file."""
    with foreign(path, "an .npz file of plain arrays: expected one as numpy.savez makes it"), ZipFile(path) as file:
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
