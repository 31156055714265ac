"""An unfinished training on disk: whole or not at all, and nothing is executed when it is read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import BadZipFile, ZipFile

import torch

from sysid import InvalidInput
from sysid.data.files import whole


def write_checkpoint(path: Path, content: Mapping[str, Any]) -> None:
    """The file is replaced only when the new one is on the disk. Raises OSError."""
    with whole(path) as file:
        torch.save(dict(content), file)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What a checkpoint holds; raises InvalidInput for another file.

    torch.load does not look at the checksums that torch.save writes: zipfile does.
    """
    try:
        with ZipFile(path) as archive:
            damaged = archive.testzip()
        stored = torch.load(path, map_location="cpu", weights_only=True) if damaged is None else {}
    except (RuntimeError, OSError, EOFError, ValueError, KeyError, UnpicklingError, BadZipFile) as error:
        raise InvalidInput(f"{path} is not a checkpoint: expected a file that Population.save wrote") from error
    if damaged is not None:
        raise InvalidInput(f"{path} is damaged ({damaged}): expected a checkpoint as Population.save wrote it")
    if not isinstance(stored, dict):
        raise InvalidInput(f"{path} is not a checkpoint: it holds a {type(stored).__name__}")
    return stored
