"""Worker processes of this machine: one task each, one line to the driver, no shared state.

A worker cannot hang the study: it is watched for its exit, and it ends by itself when the driver is gone. Ctrl-C
reaches the driver alone, which asks its workers to save and end.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any

from study.pipeline.executor import PATIENCE, Heard, Link, Supervised, Task, outcome

ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


@dataclass(frozen=True)
class Processes:
    """Runs so many tasks at a time, each in a process of its own (a `study.pipeline.executor.Executor`)."""

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
                    worker = running[connection]
                    kind, payload = worker.receive()
                    if kind in ("done", "died"):
                        running.pop(connection).end()
                    worker.supervised.hear(kind, payload)
                    if kind == "died":
                        waiting.appendleft(worker.supervised)
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

    def end(self) -> None:
        """Wait for the process, which has nothing more to do."""
        self.process.join(PATIENCE)
        self.process.kill()
        self.connection.close()

    def last_words(self) -> None:
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
                worker.connection.send("stop")
        for worker in workers:
            worker.last_words()
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


def _serve(connection: Connection, task: Task) -> None:
    """Run a task and send how it ended; the main function of a worker process."""
    threading.Thread(target=_end_with_driver, daemon=True).start()
    connection.send(outcome(task, _Pipe(connection)))
    connection.close()


def _end_with_driver() -> None:
    driver = multiprocessing.parent_process()
    if driver is not None:
        driver.join()
        os._exit(1)
