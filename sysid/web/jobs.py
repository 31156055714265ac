"""Jobs: the work on a model, and a training on it, run in processes of their own, which can be watched and ended."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from sysid.errors import InvalidInput
from sysid.web.session import Answer, Session


class Job(NamedTuple):
    """A process that works on a model."""

    node: int
    process: subprocess.Popen[bytes]

    def kill(self) -> None:
        """End it and the processes that it began."""
        if self.process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()


class SessionProcesses:
    """One process a session; the server has to answer meanwhile, so that each has one thread.

    `effects` is the file with the user's own that the command line named.
    """

    def __init__(self, effects: Path | None = None) -> None:
        self.effects, self.of_sessions, self.lock = effects, dict[str, Job](), threading.RLock()

    def start(self, session: Session, node: int, command: list[str], said: Path) -> None:
        """Run a Python module on a model; what it says goes into a file."""
        one_thread = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
        with self.lock, said.open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-u", "-m", *command], stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                start_new_session=True, env={**os.environ, **one_thread},
            )  # fmt: skip
            self.of_sessions[session.identifier] = Job(node, process)

    def running(self, session: Session) -> int | None:
        """The model that is being worked on."""
        with self.lock:
            job = self.of_sessions.get(session.identifier)
            return job.node if job is not None and job.process.poll() is None else None

    def end(self, session: Session) -> Job | None:
        """End what is under way, and forget it; what that was."""
        with self.lock:
            job = self.of_sessions.pop(session.identifier, None)
            if job is not None:
                job.kill()
            return job

    def end_all(self) -> None:
        with self.lock:
            for job in self.of_sessions.values():
                job.kill()
            self.of_sessions.clear()


class Jobs(SessionProcesses):
    """The work on models in all sessions."""

    def begin(self, session: Session, node: int, *more: str) -> None:
        """Work on a model; what was worked on in this session before is cancelled. `more`: "--next" plans, too."""
        with self.lock:
            if (job := self.end(session)) and job.node != node:
                _take_back(session, job.node)
            folder = session.of(node)
            for name in (Answer.ERROR, Answer.PROGRESS):
                (folder / name).unlink(missing_ok=True)
            command = ["sysid.web.work", str(session.folder), str(node), *more]
            command += [str(self.effects)] if self.effects else []
            self.start(session, node, command, folder / "work.log")

    def cancel(self, session: Session) -> None:
        """End what is under way; an addition of which the page does not know all is taken back."""
        with self.lock:
            if job := self.end(session):
                first = session.state.nodes[job.node].parent is None
                _take_back(session, job.node, Answer.MODEL if first else Answer.EFFECTS)

    def message(self, session: Session) -> str:
        """Why the last work ended without an answer, once; "" where it did not. Such a model is taken back."""
        with self.lock:
            if self.running(session) is not None or (job := self.end(session)) is None:
                return ""
            error = session.read(job.node, Answer.ERROR)
            if error is None and job.process.returncode == 0:
                return ""
            _take_back(session, job.node)
            return str(error["message"]) if error else "the work ended early: perhaps memory was short"

    def progress(self, session: Session) -> tuple[str, str, float]:
        """What is being done: the part of the work, what of it, and for how long [s]."""
        with suppress(ValueError, OSError):
            seen = session.read(self.running(session), Answer.PROGRESS)
            if seen:
                return seen["part"], seen["text"], max(0.0, time.time() - seen["began"])
        return "starting", "", 0.0


class Trainings(SessionProcesses):
    """The trainings of all sessions, by the command line of `policies`, which keeps what was learnt when one ends."""

    def begin(self, session: Session, node: int, u_max: float, *more: str) -> None:
        """Train on a model; raises InvalidInput where that cannot be."""
        if not 0.0 < u_max < 1e6:
            raise InvalidInput(f"the largest command is {u_max:g}: expected one above 0")
        folder = session.of(node)
        own_effects = folder / Answer.OWN_EFFECTS
        effects = own_effects if own_effects.is_file() else self.effects
        command = ["policies", "train", str(folder / Answer.MODEL), "-o", str(folder / "policy"), "--force"]
        command += ["--u-max", f"{u_max!r}", *more, *(["--effects", str(effects)] if effects else [])]
        self.end(session)
        self.start(session, node, command, folder / Answer.TRAINING)


def _take_back(session: Session, node: int, wanted: Answer = Answer.MODEL) -> None:
    """Take back the newest model if that is the one and it has no such answer."""
    if node == len(session.state.nodes) - 1 and not session.has(node, wanted):
        session.drop_last_node()


def finished(session: Session, node: int) -> bool:
    """Whether all answers about a model are there."""
    wanted = (Answer.MODEL, Answer.EXPORTED, Answer.FAILS, Answer.EFFECTS, Answer.REPORT)
    return all(session.has(node, name) for name in wanted)
