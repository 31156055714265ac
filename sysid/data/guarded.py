"""Guarded reading: compiled parsers run in a process of their own.

Damaged bytes may crash such a parser, stall it or make it ask for all memory. One process serves all reads of a
program. It is asked in a line of JSON, and answers with a line of JSON and the columns' bytes. If it ends or takes too
long, the file is refused, and the next question starts another process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np

from sysid.data.foreign_files import READERS
from sysid.data.table import column
from sysid.errors import InvalidInput
from sysid.physics.ops import Array

MEMORY = 6 << 30
"""Bytes of memory that the process may take."""
LARGEST_FILE = 1 << 31
"""Bytes of a file that the process may write, when it unpacks a compressed bag."""
SECONDS = 120.0
"""How long a question may take."""
PROGRAM = "import sys; sys.path[:] = sys.argv[1:]; from sysid.data.guarded import answer_questions; answer_questions()"


class Reader:
    """The process that reads; it belongs to the process that started it."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.process = subprocess.Popen(
            [sys.executable, "-I", "-c", PROGRAM, *map(str, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    @property
    def ready(self) -> bool:
        """Whether it can be asked: it runs, and this object is no copy that a fork has made."""
        return self.owner == os.getpid() and self.process.poll() is None

    def ask(self, *question: Any) -> tuple[str, dict[str, Array]]:
        """Why a file is refused, empty if it is not, and its columns. Raises EOFError if the process ends over it."""
        assert self.process.stdin and self.process.stdout
        late = threading.Timer(SECONDS, self.process.kill)
        late.start()
        try:
            self.process.stdin.write(json.dumps(question).encode() + b"\n")
            self.process.stdin.flush()
            refused, sizes = json.loads(self.process.stdout.readline())
            contents = {title: self.process.stdout.read(8 * size) for title, size in sizes.items()}
            if any(len(contents[title]) < 8 * size for title, size in sizes.items()):
                raise EOFError
            return refused, {title: np.frombuffer(content).copy() for title, content in contents.items()}
        except (BrokenPipeError, ValueError):
            raise EOFError from None
        finally:
            late.cancel()

    def end(self) -> None:
        """Kill the process and close its pipes."""
        with suppress(OSError), self.process:
            self.process.kill()


_reader: Reader | None = None
_lock = threading.Lock()


def read_guarded(kind: str, path: Path, joint: str, columns: Mapping[str, str] | None) -> dict[str, Array]:
    """Run a reader of `sysid.data.foreign_files` in the guarded process, and return its columns; empty ones for None.

    Raises InvalidInput as the reader does, and where it crashes, takes too long or needs too much memory.
    """
    global _reader  # noqa: PLW0603 - the process is started once
    with _lock:
        if _reader is None or not _reader.ready:
            _reader = Reader()  # it ends when its input does: with this program
        try:
            refused, arrays = _reader.ask(kind, os.fspath(path.absolute()), columns, joint)
        except BaseException as error:
            _reader.end()
            if not isinstance(error, EOFError):
                raise
            raise InvalidInput(
                f"{path.name} crashes or stalls the reader of its format: it is damaged, or not what it claims to be"
            ) from None
    if refused:
        raise InvalidInput(refused)
    return arrays


def answer_questions() -> None:
    """Answer questions from the standard input until it ends; what libraries print is discarded."""
    _limit()
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    for line in sys.stdin.buffer:
        _answer(out, *json.loads(line))
        out.flush()


def _limit() -> None:
    with suppress(ImportError, ValueError, OSError):
        import resource  # not on Windows

        for what, most in ((resource.RLIMIT_AS, MEMORY), (resource.RLIMIT_FSIZE, LARGEST_FILE)):
            resource.setrlimit(what, (most, most))


def _answer(out: IO[bytes], kind: str, path: str, columns: dict[str, str] | None, joint: str) -> None:
    (reader, expected), name, arrays, refused = READERS[kind], Path(path).name, dict[str, Array](), ""
    try:
        raw = reader(Path(path), columns, joint)
        arrays = {n: np.empty(0) if columns is None else column(name, columns[n], v) for n, v in raw.items()}
    except InvalidInput as refusal:
        refused = str(refusal)
    except MemoryError:
        refused = f"{name} needs more memory than its reader is given"
    except Exception:  # a damaged file may raise anything
        refused = f"{name} is not {expected}"
    out.write(json.dumps([refused, {n: len(v) for n, v in arrays.items()}]).encode() + b"\n")
    for values in arrays.values():
        out.write(values.tobytes())
