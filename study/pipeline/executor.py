"""What runs the tasks of a study: one interface, behind it processes of this machine or a Ray cluster.

    Processes(workers=8).execute(tasks, heard)
    Cluster(address="10.0.0.1:6379").execute(tasks, heard)         study/pipeline/cluster.py

A task whose worker dies is started again and goes on from its checkpoint. Only one that dies again and again without a
new checkpoint, or raises an error, ends the study, and the others save before that.

Processes have one task each, one line to the driver and no shared state. None can hang the study: it is watched for its
exit, and it ends by itself when the driver is gone. Ctrl-C reaches the driver alone, which asks its workers to save and
end.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, ClassVar, Protocol

PATIENCE = 30.0
"""Seconds that workers have to save and end when asked."""

DEATHS = 3
"""So many deaths of a task's workers without a new checkpoint in between end the study."""


class WorkerFailed(RuntimeError):
    """A task did not end well; the message says which and why."""


class Stopped(Exception):
    """The driver asked this task to end; what there was to save is saved."""


SECOND = 1.0
"""Least seconds between two messages of progress from a task: thousands of tasks must not drown the driver."""


class Link(ABC):
    """A task's line to the driver."""

    said = -math.inf

    def progress(self, done: float) -> None:
        """Say how much of the task is done, from 0 to 1, where that was not said just now."""
        now = time.monotonic()
        if now - self.said >= SECOND:
            self.said = now
            self.say("progress", done)

    def saved(self) -> None:
        """Say that there is a new checkpoint."""
        self.say("saved", None)

    @abstractmethod
    def say(self, kind: str, payload: Any) -> None:
        """Send a message to the driver."""

    @abstractmethod
    def stop_asked(self) -> bool:
        """Whether the driver wants this task to save and end."""


class Task(ABC):
    """Picklable work. Without a checkpoint one whose worker dies begins anew.

    name, activity   it to people, among all of its study, and what it does in a word
    work             about its seconds on one core; gpus: how many it needs
    table            of the results, that its answer is rows of
    saves            whether it has a checkpoint, from which it goes on, and writes it when asked to end
    """

    name: str
    activity: str
    work: float
    table: Any
    gpus: int = 0
    saves: ClassVar[bool] = False

    @abstractmethod
    def run(self, link: Link) -> Any:
        """The answer."""


@dataclass(frozen=True)
class BriefTask(Task):
    """A task without a checkpoint, on a CPU. Its answer is

    function(*arguments, progress)        progress: says how much is done, from 0 to 1
    """

    name: str
    activity: str
    work: float
    table: Any
    function: Callable[..., Any]
    arguments: tuple[Any, ...]

    def run(self, link: Link) -> Any:
        return self.function(*self.arguments, link.progress)


Heard = Callable[[Task, str, Any], None]
"""heard(task, kind, payload): "progress" (0 to 1), "saved", "died" (why; it is started again) or "done"."""


class Executor(Protocol):
    """Runs tasks somewhere; workers: how many at a time, None where only the cluster knows."""

    @property
    def workers(self) -> int | None: ...

    def execute(self, tasks: Sequence[Task], heard: Heard) -> None:
        """Run the tasks, the first ones first; heard is called here, in the driver, and never by two at once.

        Raises WorkerFailed for the first task that fails. However this is left, Ctrl-C included, running tasks are
        first asked to save.
        """
        ...


@dataclass
class Supervised:
    """A task, and how often its workers died since its last checkpoint."""

    task: Task
    heard: Heard
    deaths: int = 0

    def hear(self, kind: str, payload: Any) -> None:
        """Pass on what a worker said of the task. Raises WorkerFailed where there is no sense in another attempt."""
        if kind == "failed":
            raise WorkerFailed(f"{self.task.name} failed: {payload}")
        if kind == "saved":
            self.deaths = 0
        if kind == "died":
            self.deaths += 1
            if self.deaths == DEATHS:
                since = " without a new checkpoint" if self.task.saves else ""
                raise WorkerFailed(f"{self.task.name} failed: its worker died {DEATHS} times{since}; {payload}")
        self.heard(self.task, kind, payload)


def outcome(task: Task, link: Link) -> tuple[str, Any]:
    """Run a task in a worker: ("done", what it returned), ("stopped", None) or ("failed", why)."""
    try:
        return "done", task.run(link)
    except Stopped:
        return "stopped", None
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return "failed", f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"


STOP = "stop"
"""What a driver says to a worker that shall save and end."""

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


@dataclass(frozen=True)
class Processes:
    """Runs so many tasks at a time, each in a process (a `study.pipeline.executor.Executor`).

    A process goes on with the next task after a brief one: what it has loaded serves again.
    """

    workers: int

    def execute(self, tasks: Sequence[Task], heard: Heard) -> None:
        """Run the tasks and tell `heard` what each says. Raises WorkerFailed where a task raises an error or its
        processes die again and again."""
        waiting = deque(Supervised(task, heard) for task in tasks)
        running: dict[Connection, _Worker] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.workers:
                    worker = _Worker(waiting.popleft())
                    running[worker.connection] = worker
                for connection in multiprocessing.connection.wait(list(running)):
                    worker, supervised = running[connection], running[connection].supervised
                    kind, payload = worker.receive()
                    if kind == "done" and waiting and not supervised.task.saves:
                        worker.go_on(waiting.popleft())
                    elif kind in ("done", "died"):
                        running.pop(connection).end()
                    supervised.hear(kind, payload)
                    if kind == "died":
                        waiting.appendleft(supervised)
        finally:
            _stop(list(running.values()))


class _Worker:
    """A process and the driver's end of its line."""

    def __init__(self, supervised: Supervised) -> None:
        context = multiprocessing.get_context("spawn")
        self.supervised, task = supervised, supervised.task
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=_serve, args=(theirs, task), name=task.name, daemon=True)
        os.environ.update(ONE_THREAD)
        with _interrupts_blocked():
            self.process.start()
        theirs.close()

    def receive(self) -> tuple[str, Any]:
        """The next message; ("died", why) where the process ended, though it be in the middle of one."""
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode
            if code is None or code >= 0:
                return "died", f"its process ended with exit code {code}"
            why = f"its process was ended by signal {signal.Signals(-code).name}"
            return "died", why + (" (out of memory?)" if -code == signal.SIGKILL else "")

    def go_on(self, supervised: Supervised) -> None:
        """Give another task to the process, which has finished one. Where it has died, `receive` tells."""
        self.supervised = supervised
        with contextlib.suppress(OSError):
            self.connection.send(supervised.task)

    def end(self) -> None:
        """Wait for the process, which has nothing more to do."""
        with contextlib.suppress(OSError):
            self.connection.send(None)
        self.process.join(PATIENCE)
        self.process.kill()
        self.connection.close()

    def receive_remaining(self) -> None:
        """Hear what the process, which was asked to end, still has to say."""
        with contextlib.suppress(OSError):
            while self.supervised.task.saves and self.connection.poll(PATIENCE):
                kind, payload = self.receive()
                if kind in ("saved", "done"):
                    self.supervised.hear(kind, payload)
                if kind in ("done", "died", "failed", "stopped"):
                    return


def _stop(workers: list[_Worker]) -> None:
    try:
        for worker in workers:
            with contextlib.suppress(OSError):
                worker.connection.send(STOP)
        for worker in workers:
            worker.receive_remaining()
    finally:
        for worker in workers:
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


@dataclass
class _Pipe(Link):
    """The worker's end of the line."""

    connection: Connection

    def say(self, kind: str, payload: Any) -> None:
        self.connection.send((kind, payload))

    def stop_asked(self) -> bool:
        return self.connection.poll()


def _serve(connection: Connection, task: Any) -> None:
    """Run a task and send how it ended, and go on with others; the main function of a worker process."""
    threading.Thread(target=_end_with_driver, daemon=True).start()
    with contextlib.suppress(EOFError):
        while task not in (None, STOP):
            connection.send(outcome(task, _Pipe(connection)))
            task = connection.recv()
    connection.close()


def _end_with_driver() -> None:
    driver = multiprocessing.parent_process()
    if driver is not None:
        driver.join()
        os._exit(1)
