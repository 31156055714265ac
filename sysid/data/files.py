"""Files: every path is checked here, and what is written is whole or not there.

Whatever the file system refuses (a name too long, links in a circle, a device, a folder without permission) becomes a
sentence. A full disk or a power cut never leaves half of a file in the place of another.
"""

from __future__ import annotations

import csv
import importlib.util
import io
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import IO

from sysid.errors import InvalidInput, check_kind

FIGURES = (".png", ".pdf", ".svg")
MARKS = (b"gapfinder", b"residual_torque")
"""What stands in every answer and report, and in a table of predictions."""
PLANNED = (b"t,torque", b"rollout,t,torque")
"""The first line of a planned experiment, of one rollout or several."""
LARGEST = 1 << 26
"""Bytes, at most, of a file that is read at once, such as a model.json."""


@contextmanager
def file_errors(path: Path, doing: str) -> Iterator[None]:
    """Turn the file system's errors about a path into one sentence; nothing but file access may be done within."""
    try:
        yield
    except InvalidInput:
        raise
    except OSError as error:
        raise InvalidInput(f"cannot {doing} {path}: {error.strerror or error}") from None
    except (ValueError, RuntimeError):  # a NUL or half a character; before Python 3.13, links in a circle
        raise InvalidInput(f"cannot {doing} {str(path)!r}: expected the name of a file") from None


def path_of(path: str | PathLike[str]) -> Path:
    """The path that a user gave. Raises InvalidInput for what is none."""
    check_kind("path", path, str | PathLike, "the name of a file")
    return Path(path)


def full_path(path: Path, doing: str) -> Path:
    """The full path of a file that is there or may be made; raises InvalidInput for a name that is refused."""
    with file_errors(path, doing):
        full = path.resolve()
        with suppress(FileNotFoundError, NotADirectoryError):
            full.stat()
        return full


def check_input(path: Path, expected: str, largest: float = LARGEST) -> None:
    """Raise InvalidInput where a file cannot be read: not there, a folder, a device, or of more bytes than `largest`.

    expected: what the file should be, in a word or two.
    """
    full = full_path(path, "read")
    if not full.exists():
        raise InvalidInput(f"no such file: {path}: expected {expected}")
    if not full.is_file():
        raise InvalidInput(f"{path} is {'a folder' if full.is_dir() else 'no regular file'}: expected {expected}")
    if full.stat().st_size > largest:
        raise InvalidInput(f"{path} has {full.stat().st_size:,} bytes: expected {expected} of at most {largest:,}")


def read_file(path: Path, expected: str, largest: float = LARGEST) -> bytes:
    """The content of a file. Raises InvalidInput as `check_input` does."""
    check_input(path, expected, largest)
    with file_errors(path, "read"):
        return path.read_bytes()


def check_outputs(inputs: Iterable[Path | None], outputs: Iterable[Path | None], force: bool | None = None) -> None:
    """Raise InvalidInput where an output is an input, comes twice, cannot be written, or is there and must stay.

    force: whether a file that is there may be replaced; by default only a figure, or what was written here before.
    """
    read_from = {full_path(p, "read") for p in inputs if p is not None}
    written: set[Path] = set()
    for path in (p for p in outputs if p is not None):
        full = full_path(path, "write")
        if full in read_from:
            raise InvalidInput(f"{path} is read by this command: expected another file to write to")
        if full in written:
            raise InvalidInput(f"{path} is to hold two answers: expected two files")
        if full.exists() and not full.is_file():
            what = "a folder" if full.is_dir() else "no regular file"
            raise InvalidInput(f"{path} is {what}: expected a file to write to")
        if not full.parent.is_dir():
            raise InvalidInput(f"cannot write {path}: there is no folder {path.parent}")
        if full.exists() and force is False:
            raise InvalidInput(f"{path} is there already: expected another name, or --force")
        if full.exists() and force is None and not _is_ours(full):
            raise InvalidInput(f"{path} is there already, and no answer of ours: expected another name")
        written.add(full)


def _is_ours(path: Path) -> bool:
    """Whether a file is empty, a figure, or holds what an answer, a report or a table of ours begins or ends with."""
    if path.suffix.lower() in FIGURES:
        return True
    with file_errors(path, "read"), path.open("rb") as file:
        head = file.read(1000)
        file.seek(-min(path.stat().st_size, 10_000), os.SEEK_END)
        ends = head + file.read()
    return not head or head.split(b"\n")[0].strip() in PLANNED or any(mark in ends for mark in MARKS)


def partial(path: Path) -> Path:
    """The path at which a file is written until it is complete."""
    return path.with_name(path.name + ".partial")


def save_file(path: str | PathLike[str], content: bytes | str) -> None:
    """Write a file that a user asked for; where that fails it raises InvalidInput, in a sentence, and not OSError."""
    path = path_of(path)
    check_outputs((), [path], force=True)
    with file_errors(path, "write"):
        write_whole(path, content)


def save_csv(path: Path | str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Write rows under the names of their columns. Raises InvalidInput as `save_file` does."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(columns)
    writer.writerows(rows)
    save_file(path, text.getvalue())


@contextmanager
def whole(path: Path) -> Iterator[IO[bytes]]:
    """Open a file for writing that replaces an older one only once it is complete and on the disk.

    On failure it raises OSError with the file's name, keeps the older file and removes what was written.
    """
    growing = partial(path)
    try:
        with growing.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        growing.replace(path)
    except BaseException as error:
        growing.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror or str(error), str(path)) from error
        raise


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a `whole` file, text in UTF-8."""
    with whole(path) as file:
        file.write(content.encode(errors="backslashreplace") if isinstance(content, str) else content)


def check_installed(package: str, extra: str, doing: str) -> None:
    """Raise InvalidInput where a package of an extra is not installed; doing: what needs it."""
    if importlib.util.find_spec(package) is None:
        raise InvalidInput(
            f"{doing} needs the package {package}, which is not installed: pip install 'gapfinder[{extra}]'"
        )
