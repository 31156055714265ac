"""The way of every experiment: plan -> tasks -> results -> report.

An experiment has stages, and the tasks of one follow from the results of those before. Every finished task goes into
the results at once, so that a run goes on from wherever an earlier attempt left it. Nothing that a number depends on is
decided here. Its progress is a bar with the time left on a terminal, a plain line now and then elsewhere.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from study.pipeline.database import Database
from study.pipeline.executor import Executor, Task
from study.pipeline.population_task import PopulationTask
from study.pipeline.tables import ResultTable
from sysid.data.files import partial

DRAW_SECONDS = 0.2
"""Least time between two looks at all tasks, of which there may be thousands."""

PLAIN_SECONDS = 30.0
"""Least time between two plain lines."""


def duration(seconds: float) -> str:
    """As a person would say it: "40 s", "6 min", "3 h 20 min"."""
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"


class Meter:
    """Shows how much of the expected work is done; a context manager.

    time left = work left / (work done here / time passed)
    """

    def __init__(self, console: Console, tasks: Sequence[Task]) -> None:
        self.console, self.tasks = console, {task.name: task for task in tasks}
        self.total = max(sum(task.work for task in tasks), 1e-9)
        self.share = dict.fromkeys(self.tasks, 0.0)
        self.first: dict[str, float] = {}
        self.begin = self.said = time.monotonic()
        self.drawn = -math.inf
        about, percent = TextColumn("{task.description}"), TextColumn("{task.percentage:>3.0f} %")
        columns = about, BarColumn(bar_width=32), percent, TextColumn("[dim]{task.fields[left]}")
        self.bar = Progress(*columns, console=console, disable=not console.is_terminal)
        self.row = self.bar.add_task("starting", total=self.total, left="")

    def __enter__(self) -> Meter:
        self.bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._draw()
        self.bar.stop()

    def update(self, task: str, share: float) -> None:
        """`share` (0 to 1) of a task is done. Where a resumed task starts is not counted as speed."""
        if not self.first:
            self.begin = time.monotonic()
        self.first.setdefault(task, share if share < 1.0 else 0.0)
        self.share[task] = share
        if time.monotonic() - self.drawn >= DRAW_SECONDS:
            self.drawn = time.monotonic()
            self._draw()

    def _draw(self) -> None:
        """A look at the bar, or a plain line; what goes on is what the first task does that is not done."""
        ahead = [task for name, task in self.tasks.items() if self.share[name] < 1.0] or list(self.tasks.values())
        label, now = ahead[0].activity, time.monotonic()
        self.bar.update(self.row, description=label, completed=self.done, left=self.left())
        if not self.console.is_terminal and now - self.said >= PLAIN_SECONDS:
            self.said, percent = now, 100.0 * self.done / self.total
            line = f"{time.strftime('%H:%M:%S')}  {label}: {percent:.0f} % done, {self.left()}"
            self.console.print(line, highlight=False)

    @property
    def done(self) -> float:
        """Work that is done [s]."""
        return sum(task.work * self.share[name] for name, task in self.tasks.items())

    def left(self) -> str:
        """The time left in words; empty until it can be told."""
        passed = time.monotonic() - self.begin
        here = sum(self.tasks[name].work * (self.share[name] - first) for name, first in self.first.items())
        if passed < 5.0 or here <= 0.0:
            return ""
        return f"about {duration((self.total - self.done) * passed / here)} left"


P = TypeVar("P", bound=PopulationTask)


@dataclass(frozen=True)
class Stage:
    """Tasks that may run at the same time, the first ones first; about: what is ahead, "" where that is not said."""

    tasks: Sequence[Task]
    about: str = ""


class StudyExperiment(ABC):
    """A plan with the folder of its results."""

    results: Database
    checkpoint_seconds: float

    @abstractmethod
    def stages(self, console: Console) -> Iterator[Stage]:
        """What is left to do; a stage is asked for when the one before it is done."""

    def keep(self, task: Task, answer: Any) -> None:
        """Put what a finished task answered into the results; its checkpoint is done with."""
        self.results.add(task.table, answer)
        if isinstance(task, PopulationTask):
            task.discard()

    def unfinished(self, populations: Iterable[P], table: ResultTable[Any]) -> list[P]:
        """Those with agents that the table lacks; the checkpoints of the others are removed."""
        finished, left = self.results.keys(table), []
        for task in populations:
            partial(task.checkpoint).unlink(missing_ok=True)
            if all((key if isinstance(key, tuple) else (key,)) in finished for key in task.keys):
                task.discard()
            else:
                left.append(task)
        return left

    @property
    def training(self) -> dict[str, Any]:
        """Where and how its populations train, as `PopulationTask` asks it."""
        folder, device = self.results.folder.resolve(), self.results.device
        return {"folder": folder, "checkpoint_seconds": self.checkpoint_seconds, "device": device}

    @abstractmethod
    def publish(self, console: Console) -> None:
        """Write tables, figures and report from finished results, and say what was found."""


def run(experiment: StudyExperiment, executor: Executor, console: Console) -> None:
    """Finish every task whose answer the results lack.

    Raises WorkerFailed where a task fails, after the others have saved; what is finished stays in the results.
    """
    for stage in experiment.stages(console):
        if not stage.tasks:
            continue
        if stage.about:
            _announce(console, stage, executor.workers)
        with Meter(console, stage.tasks) as meter:

            def heard(task: Task, kind: str, payload: Any, meter: Meter = meter) -> None:
                """What a worker said: shown, and kept where it is an answer."""
                if kind == "progress":
                    meter.update(task.name, payload)
                elif kind == "died":
                    console.print(f"[dim]{task.name}: {payload}; it is started again", soft_wrap=True)
                elif kind == "done":
                    experiment.keep(task, payload)
                    meter.update(task.name, 1.0)

            executor.execute(stage.tasks, heard)


def _announce(console: Console, stage: Stage, workers: int | None) -> None:
    by_whom = "a Ray cluster" if workers is None else f"{workers} workers" if workers > 1 else "1 worker"
    console.print(f"{stage.about}; {by_whom}", soft_wrap=True)
    if workers is not None:
        seconds = sum(task.work for task in stage.tasks) / min(workers, len(stage.tasks))
        console.print(f"[dim]expect very roughly {duration(seconds)}; stop it at any time, it goes on", soft_wrap=True)
