"""Worker processes: one task each, one line to the parent, no shared state.

A worker cannot hang the study: it is watched for its exit, and it ends by itself when the parent is gone. Ctrl-C
reaches the parent alone, which asks its workers to save and end.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, ClassVar, Protocol

from study.cells import Link, Stopped

PATIENCE = 30.0
"""Seconds a worker has to save and end when asked."""

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


class WorkerFailed(RuntimeError):
    """A task did not end well; the message says which and why."""


class Task(Protocol):
    """Picklable work with a name and an estimate of its seconds; `saves`: it can save when asked to end."""

    saves: ClassVar[bool]

    @property
    def name(self) -> str: ...
    @property
    def work(self) -> float: ...
    def run(self, link: Link) -> Any: ...


@dataclass(frozen=True)
class Pipe:
    """The worker's end of the line (a `study.cells.Link`)."""

    connection: Connection

    def progress(self, done: float) -> None:
        self.connection.send(("progress", done))

    def saved(self, seconds: float) -> None:
        self.connection.send(("saved", seconds))

    def stop_asked(self) -> bool:
        return self.connection.poll()


def execute(tasks: Sequence[Task], workers: int, heard: Callable[[Task, str, Any], None]) -> None:
    """Run the tasks in order, `workers` at a time; heard(task, kind, payload) is called here, in the parent.

    Kinds: "progress" (0 to 1), "saved" (seconds), "done" (what the task returned). Raises WorkerFailed for the first
    task that fails. However this is left, Ctrl-C included, running workers are first asked to save, then ended.
    """
    waiting, running = list(tasks), {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                worker = _Worker(waiting.pop(0))
                running[worker.connection] = worker
            for connection in multiprocessing.connection.wait(list(running)):
                worker = running[connection]
                kind, payload = worker.hear()
                if kind == "failed":
                    raise WorkerFailed(f"{worker.task.name} failed: {payload}")
                heard(worker.task, kind, payload)
                if kind == "done":
                    running.pop(connection).end()
    finally:
        _stop(list(running.values()), heard)


class _Worker:
    """A process and the parent's end of its line."""

    def __init__(self, task: Task) -> None:
        context = multiprocessing.get_context("spawn")
        self.task = task
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(theirs, task), name=task.name, daemon=True)
        os.environ.update(ONE_THREAD)
        with _interrupts_blocked():
            self.process.start()
        theirs.close()

    def hear(self) -> tuple[str, Any]:
        """The next message; ("failed", reason) where the process ended without one."""
        try:
            return self.connection.recv()
        except (EOFError, ConnectionResetError):
            self.process.join()
            code = self.process.exitcode
            if code is not None and code < 0:
                reason = f"its process was ended by signal {signal.Signals(-code).name}"
                return "failed", reason + (" (out of memory?)" if -code == signal.SIGKILL else "")
            return "failed", f"its process ended with exit code {code}"

    def end(self) -> None:
        """Wait for the process, which has nothing more to do."""
        self.process.join(PATIENCE)
        self.process.kill()
        self.connection.close()


def _stop(workers: list[_Worker], heard: Callable[[Task, str, Any], None]) -> None:
    for worker in workers:
        with contextlib.suppress(OSError):
            worker.connection.send("stop")
    for worker in workers:
        with contextlib.suppress(OSError):
            while worker.task.saves and worker.connection.poll(PATIENCE):
                kind, payload = worker.hear()
                if kind in ("saved", "done"):
                    heard(worker.task, kind, payload)
                if kind in ("done", "failed", "stopped"):
                    break
        worker.process.kill()
        worker.process.join()


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """A process started in here never sees Ctrl-C; one that comes meanwhile reaches this process afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, task: Task) -> None:
    """Run a task and send what it returned; the main function of a worker process."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        connection.send(("done", task.run(Pipe(connection))))
    except Stopped:
        connection.send(("stopped", None))
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.basename(place.filename)}, line {place.lineno}"
        connection.send(("failed", f"{type(error).__name__}: {error} ({where})"))
    connection.close()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
