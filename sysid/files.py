"""Files that are whole or not there: a full disk or a power cut never leaves half of one in the place of another."""

from __future__ import annotations

import os
from pathlib import Path


def partial(path: Path) -> Path:
    """Where a file grows until it is whole."""
    return path.with_name(path.name + ".partial")


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file, in UTF-8, that replaces an older one only when it is on the disk.

    Raises OSError, which names the file, and leaves the older one and no rest of the new.
    """
    growing = partial(path)
    try:
        with growing.open("wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        growing.replace(path)
    except OSError as error:
        growing.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(path)) from error
