"""A Ray cluster: the same tasks on the nodes of a cluster (extra [cluster]).

The driver alone writes the store. Checkpoints lie in the results folder, which every node has to see under the same
path. Ray starts no task again by itself: it cannot tell one that gets on from one that dies over and over, so that is
decided here as for processes (`executor.Supervised`). A small actor on the driver's node holds what running
tasks have said and whether they shall stop; it lives as long as the driver, and Ray ends the tasks of a dead driver.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import platform
import signal
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from study.pipeline.executor import PATIENCE, SECOND, Heard, Link, Supervised, Task, WorkerFailed, outcome
from study.pipeline.settings import versions
from sysid import InvalidInput


@dataclass(frozen=True)
class Cluster:
    """Runs tasks on a Ray cluster (a `study.pipeline.executor.Executor`).

    address: HOST:PORT of a running cluster, "auto" for the one that this machine belongs to. Raises InvalidInput where
    Ray is not installed or no cluster answers.
    """

    address: str
    workers: ClassVar[None] = None

    def __post_init__(self) -> None:
        if importlib.util.find_spec("ray") is None:
            raise InvalidInput("--address needs Ray: pip install 'gapfinder[cluster]'")
        if "://" in self.address:
            raise InvalidInput(f"address {self.address!r}: expected HOST:PORT or 'auto', on a machine of the cluster")

    def execute(self, tasks: Sequence[Task], heard: Heard) -> None:
        """Run the tasks; see `Executor.execute`. Raises InvalidInput for tasks that no node can run."""
        ray = _connect(self.address)
        try:
            _check_needs(tasks, ray.cluster_resources(), self.address)
            _Driver(ray).execute(tasks, heard)
        except ray.exceptions.RayError as error:
            raise WorkerFailed(f"the Ray cluster failed: {_sentence(error)}") from error
        finally:
            ray.shutdown()


def _connect(address: str) -> Any:
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ.setdefault("RAY_DEDUP_LOGS_SKIP_REGEX", "worker died|marked dead")  # `heard` tells it in a line
    import ray

    terminate = signal.getsignal(signal.SIGTERM)
    try:
        _knock(address)
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except (OSError, RuntimeError, ValueError) as error:
        raise InvalidInput(f"no Ray cluster at {address}: {_sentence(error)}") from None
    signal.signal(signal.SIGTERM, terminate)  # Ray's own would end the driver before tasks have saved
    return ray


def _knock(address: str) -> None:
    """Raise OSError where nobody listens, for which Ray itself would wait for minutes."""
    host, colon, port = address.rpartition(":")
    if colon and port.isdecimal():
        socket.create_connection((host, int(port)), timeout=PATIENCE).close()


def _check_needs(tasks: Sequence[Task], there: dict[str, float], address: str) -> None:
    gpus = max((task.gpus for task in tasks), default=0)
    if gpus > there.get("GPU", 0.0):
        has = f"the cluster at {address} has {there.get('GPU', 0.0):g}"
        raise InvalidInput(f"a task needs {gpus} GPU, {has}: take --device cpu")


def _sentence(error: Exception) -> str:
    """The first sentence of Ray's messages, which are long."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0].split(". ")[0].rstrip(".") if lines else type(error).__name__


class _Driver:
    """The driver's side of a study on a connected cluster."""

    def __init__(self, ray: Any) -> None:
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        actor = ray.remote(num_cpus=0, max_restarts=-1, scheduling_strategy=here)(_Mailbox)
        self.ray, self.mailbox, self.versions = ray, actor.remote(), versions()
        # each in a process of its own: memory is given back, and no task finds what another left
        self.serve = ray.remote(max_retries=0, max_calls=1)(_serve)
        self.running: dict[Any, Supervised] = {}
        self.begun: set[str] = set()

    def execute(self, tasks: Sequence[Task], heard: Heard) -> None:
        """Submit every task, pass on what they say until all are done, and submit again those that died."""
        supervised = {task.name: Supervised(task, heard) for task in tasks}
        try:
            for one in supervised.values():
                self._submit(one)
            while self.running:
                finished, _ = self.ray.wait(list(self.running), timeout=SECOND)
                self._hear(supervised)
                for reference in finished:
                    kind, payload = self._result(reference)
                    one = self.running[reference]
                    one.hear(kind, payload)
                    del self.running[reference]
                    if kind == "died":
                        self._submit(one)
        finally:
            self._stop(supervised)

    def _submit(self, one: Supervised) -> None:
        needs = {"num_cpus": 1, "num_gpus": one.task.gpus}
        reference = self.serve.options(**needs, name=one.task.name).remote(one.task, self.mailbox, self.versions)
        self.begun.discard(one.task.name)
        self.running[reference] = one

    def _hear(self, supervised: dict[str, Supervised], kinds: tuple[str, ...] = ("progress", "saved")) -> None:
        try:
            news = self.ray.get(self.mailbox.take.remote(), timeout=PATIENCE)
        except (self.ray.exceptions.RayActorError, self.ray.exceptions.GetTimeoutError):
            return
        for name, kind, payload in news:
            self.begun.add(name)
            if kind in kinds:
                supervised[name].hear(kind, payload)

    def _result(self, reference: Any) -> tuple[str, Any]:
        try:
            return self.ray.get(reference)
        except self.ray.exceptions.RayTaskError as error:
            cause = error.cause or error
            return "failed", f"{type(cause).__name__}: {_sentence(cause)}"
        except self.ray.exceptions.RayError as error:
            return "died", _sentence(error)

    def _stop(self, supervised: dict[str, Supervised]) -> None:
        """Ask what is running to save, and wait for it; what has not begun is dropped when the driver leaves."""
        deadline = time.monotonic() + PATIENCE
        left = [r for r, one in self.running.items() if one.task.saves and one.task.name in self.begun]
        while left and time.monotonic() < deadline:
            self.mailbox.stop.remote()
            finished, left = self.ray.wait(left, timeout=SECOND)
            self._hear(supervised, ("saved",))
            for reference in finished:
                kind, payload = self._result(reference)
                if kind == "done":
                    self.running[reference].hear(kind, payload)


class _Mailbox:
    """What tasks have said since the driver last asked, and whether they shall stop; an actor."""

    def __init__(self) -> None:
        self.news: dict[tuple[str, str], Any] = {}
        self.stopping = False

    def say(self, name: str, kind: str, payload: Any) -> bool:
        self.news[name, kind] = payload
        return self.stopping

    def take(self) -> list[tuple[str, str, Any]]:
        news, self.news = self.news, {}
        return [(name, kind, payload) for (name, kind), payload in news.items()]

    def stop(self) -> None:
        self.stopping = True


@dataclass
class _Post(Link):
    """A task's end of the line: what it says is answered by whether it shall stop."""

    mailbox: Any
    name: str
    stopping: bool = False

    def stop_asked(self) -> bool:
        return self.stopping

    def say(self, kind: str, payload: Any) -> None:
        """Leave a word in the mailbox, and take from it whether to stop."""
        import ray

        # a mailbox that was started again, or is out of reach for a while, hears the next word
        with contextlib.suppress(ray.exceptions.RayActorError, ray.exceptions.GetTimeoutError):
            self.stopping = ray.get(self.mailbox.say.remote(self.name, kind, payload), timeout=PATIENCE)


def _serve(task: Task, mailbox: Any, expected: dict[str, str]) -> tuple[str, Any]:
    """Run a task and return how it ended; the main function of a Ray task."""
    other = [f"{name} {here}, not {expected[name]}" for name, here in versions().items() if here != expected[name]]
    if other:
        return "failed", f"the node {platform.node()} has {' and '.join(other)}, which may give other numbers"
    post = _Post(mailbox, task.name)
    post.say("begun", None)
    return outcome(task, post)
