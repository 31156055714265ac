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

from sysid.data.foreign_files import READERS, foreign
from sysid.data.table import column
from sysid.errors import InvalidInput

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

    def ask(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Ask a question and return the answer, its columns as arrays. Raises EOFError if the process ends over it."""
        assert self.process.stdin and self.process.stdout
        late = threading.Timer(SECONDS, self.process.kill)
        late.start()
        try:
            self.process.stdin.write(json.dumps(question).encode() + b"\n")
            self.process.stdin.flush()
            answer: dict[str, Any] = json.loads(self.process.stdout.readline())
            for title, size in answer.get("columns", {}).items():
                content = self.process.stdout.read(8 * size)
                if len(content) < 8 * size:
                    raise EOFError
                answer["columns"][title] = np.frombuffer(content).copy()
            return answer
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


def read_guarded(kind: str, path: Path, columns: Mapping[str, str] | None = None, joint: str = "") -> dict[str, Any]:
    """Run a reader of `sysid.data.foreign_files` in the guarded process, and return what it finds.

    Raises InvalidInput as the reader does, and where it crashes, takes too long or needs too much memory.
    """
    global _reader  # noqa: PLW0603 - the process is started once
    with _lock:
        if _reader is None or not _reader.ready:
            _reader = Reader()  # it ends when its input does: with this program
        question = {"kind": kind, "path": os.fspath(path.absolute()), "columns": columns, "joint": joint}
        try:
            answer = _reader.ask(question)
        except BaseException as error:
            _reader.end()
            if not isinstance(error, EOFError):
                raise
            raise InvalidInput(
                f"{path.name} crashes or stalls the reader of its format: it is damaged, or not what it claims to be"
            ) from None
    if "refused" in answer:
        raise InvalidInput(answer["refused"])
    return answer["columns"] if columns is not None else dict.fromkeys(answer["names"])


def answer_questions() -> None:
    """Answer questions from the standard input until it ends; what libraries print is discarded."""
    _limit()
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    for line in sys.stdin.buffer:
        _answer(out, **json.loads(line))
        out.flush()


def _limit() -> None:
    with suppress(ImportError, ValueError, OSError):
        import resource  # not on Windows

        for what, most in ((resource.RLIMIT_AS, MEMORY), (resource.RLIMIT_FSIZE, LARGEST_FILE)):
            resource.setrlimit(what, (most, most))


def _answer(out: IO[bytes], kind: str, path: str, columns: dict[str, str] | None, joint: str) -> None:
    name, arrays, answer = Path(path).name, dict[str, Any](), dict[str, Any]()
    try:
        reader, expected = READERS[kind]
        with foreign(Path(path), expected):
            found = reader(Path(path), columns, joint)
        if columns is None:
            answer["names"] = list(found)
        else:
            arrays = {ours: column(name, columns[ours], values) for ours, values in found.items()}
            answer["columns"] = {ours: len(values) for ours, values in arrays.items()}
    except InvalidInput as refusal:
        answer["refused"] = str(refusal)
    except MemoryError:
        answer["refused"] = f"{name} needs more memory than its reader is given"
    out.write(json.dumps(answer).encode() + b"\n")
    for values in arrays.values():
        out.write(values.tobytes())
