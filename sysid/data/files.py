"""Files that are whole or not there: a full disk or a power cut never leaves half of one in the place of another."""

from __future__ import annotations

import os
from pathlib import Path

from sysid.errors import InvalidInput


def partial(path: Path) -> Path:
    """Where a file grows until it is whole."""
    return path.with_name(path.name + ".partial")


def save_text(path: Path | str, text: str) -> None:
    """`write_whole` for what a user asked for: raises InvalidInput, in a sentence, where it cannot be written."""
    try:
        write_whole(Path(path), text)
    except OSError as error:
        raise InvalidInput(f"cannot write {path}: {error.strerror}") from None


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
