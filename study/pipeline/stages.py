"""The way of every experiment: plan -> tasks -> results -> report.

An experiment has stages, and the tasks of one follow from the results of those before. Every finished task goes into
the results at once, so that a run goes on from wherever an earlier attempt left it. Nothing that a number depends on is
decided here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from rich.console import Console

from study.pipeline.database import Database
from study.pipeline.executor import Executor, Task
from study.pipeline.population_task import PopulationTask
from study.pipeline.progress import Meter, duration
from study.pipeline.tables import ResultTable
from sysid.data.files import partial

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
