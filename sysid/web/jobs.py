"""Jobs: the work on a model runs in a process of its own, one a session; it can be watched and cancelled."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from sysid.web.session import EFFECTS, ERROR, MODEL, REPORT, Session
from sysid.web.work import PROGRESS


@dataclass(frozen=True)
class Job:
    """A process that works on a model."""

    node: int
    process: subprocess.Popen[bytes]


class Jobs:
    """The processes of all sessions. `effects` is a file with the user's own, named on the command line."""

    def __init__(self, effects: Path | None = None) -> None:
        self.effects, self._jobs, self._lock = effects, dict[str, Job](), threading.RLock()

    def begin(self, session: Session, node: int, *more: str) -> None:
        """Work on a model; what was worked on in this session before is cancelled. `more`: "--next" plans, too."""
        with self._lock:
            self.cancel(session)
            folder = session.of(node)
            for name in (ERROR, PROGRESS):
                (folder / name).unlink(missing_ok=True)
            command = [sys.executable, "-m", "sysid.web.work", str(session.folder), str(node), *more]
            command += [str(self.effects)] if self.effects else []
            with (folder / "work.log").open("wb") as log:
                process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    start_new_session=True,
                    env=environment(),
                )
            self._jobs[session.identifier] = Job(node, process)

    def cancel(self, session: Session) -> None:
        """End what is under way; a model that was not fitted yet is taken back."""
        with self._lock:
            job = self._jobs.pop(session.identifier, None)
            if job is None:
                return
            kill(job.process)
            if not (session.of(job.node) / MODEL).is_file() and job.node == len(session.state.nodes) - 1:
                session.drop_last_node()

    def running(self, session: Session) -> int | None:
        """The model that is being worked on."""
        with self._lock:
            job = self._jobs.get(session.identifier)
            return job.node if job is not None and job.process.poll() is None else None

    def message(self, session: Session) -> str:
        """Why the last work ended without an answer, once; "" where it did not. Such a model is taken back."""
        with self._lock:
            job = self._jobs.get(session.identifier)
            if job is None or job.process.poll() is None:
                return ""
            del self._jobs[session.identifier]
            found = session.read(job.node, ERROR)
            if found is None and job.process.returncode == 0:
                return ""
            if not (session.of(job.node) / MODEL).is_file():
                session.drop_last_node()
            return str(found["message"]) if found else "the work ended early: perhaps memory was short"

    def progress(self, session: Session) -> tuple[str, str, float]:
        """What is being done: the part of the work, what of it, and for how long [s]."""
        node = self.running(session)
        if node is None:
            return "", "", 0.0
        with suppress(ValueError, OSError):
            seen = session.read(node, PROGRESS)
            if seen:
                return seen["part"], seen["text"], max(0.0, time.time() - seen["began"])
        return "starting", "", 0.0

    def end(self) -> None:
        """Cancel everything."""
        with self._lock:
            for job in self._jobs.values():
                kill(job.process)
            self._jobs.clear()


def finished(session: Session, node: int) -> bool:
    """Whether all answers about a model are there."""
    return all((session.of(node) / name).is_file() for name in (MODEL, EFFECTS, REPORT))


def kill(process: subprocess.Popen[bytes]) -> None:
    """End a process and those that it began."""
    if process.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def environment() -> dict[str, str]:
    """One thread: the server has to answer meanwhile."""
    return {**os.environ, **{f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}}
