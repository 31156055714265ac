"""Runs a study to its end, from wherever an earlier attempt left it.

First every point is measured and identified, then populations train, and references follow on whatever core is free.
Every finished task goes into the store at once; an unfinished population leaves a checkpoint in the folder. Nothing a
number depends on is decided here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from study.cells import PopulationTask
from study.config import Preset
from study.executors.executor import Executor, Task
from study.identification import IdentificationTask
from study.progress import Meter, duration
from study.references import Designs, ReferenceTask, reference_tasks
from study.storage.imports import is_database, read_runs
from study.storage.store import Store
from study.training import left


def run(
    preset: Preset,
    store: Store,
    executor: Executor,
    console: Console,
    checkpoint_seconds: float = 60.0,
    imported: Path | None = None,
) -> None:
    """Finish every run and reference of the preset that the store lacks, after taking up the runs in `imported`.

    Raises WorkerFailed where a task fails, after the others have saved; what is finished stays in the store.
    """
    if imported is not None:
        is_database(imported)  # a file that cannot be read is refused before anything runs
    keep, note = partial(_keep, store=store), partial(_note, store=store)
    execute(list(_unidentified(preset, store)), executor, console, keep, note)
    if imported is not None:
        taken = store.add_imported(read_runs(imported, preset, store.estimates()))
        console.print(f"{taken} runs taken up from {imported}", soft_wrap=True)
    tasks = [*_untrained(preset, store, checkpoint_seconds), *_unrated(preset, store)]
    if tasks:
        announce(console, tasks, executor.workers, _about(store, tasks))
    execute(tasks, executor, console, keep, note)


def execute(
    tasks: Sequence[Task],
    executor: Executor,
    console: Console,
    keep: Callable[[Task, Any], None],
    note: Callable[[Task, float], None],
) -> None:
    """Run tasks and show how far they are; keep(task, answer) as each is done, note(task, seconds) at a checkpoint."""
    if not tasks:
        return
    with Meter(console, tasks) as meter:

        def heard(task: Task, kind: str, payload: Any) -> None:
            """What a worker said: shown, and kept where it is an answer."""
            if kind == "progress":
                meter.update(task.name, payload)
            elif kind == "saved":
                note(task, payload)
            elif kind == "died":
                console.print(f"[dim]{task.name}: {payload}; it is started again", soft_wrap=True)
            elif kind == "done":
                keep(task, payload)
                meter.update(task.name, 1.0)

        executor.execute(tasks, heard)


def announce(console: Console, tasks: Sequence[Task], workers: int | None, about: str) -> None:
    """Say what is ahead."""
    workers_said = "a Ray cluster" if workers is None else f"{workers} workers" if workers > 1 else "1 worker"
    console.print(f"{about}; {workers_said}", soft_wrap=True)
    if workers is None:
        return
    seconds = sum(task.work for task in tasks) / min(workers, max(len(tasks), 1))
    console.print(f"[dim]expect very roughly {duration(seconds)}; stop it at any time, it goes on", soft_wrap=True)


def _keep(task: Task, payload: Any, store: Store) -> None:
    if isinstance(task, PopulationTask):
        store.add_runs(payload)
        task.discard()
    elif isinstance(task, IdentificationTask):
        store.add_estimates(payload)
    else:
        store.add_references(payload)


def _note(task: Task, seconds: float, store: Store) -> None:
    if isinstance(task, PopulationTask):
        store.note_training(task.index, seconds)


def _unidentified(preset: Preset, store: Store) -> Iterator[IdentificationTask]:
    known = store.estimates()
    for point in preset.points:
        for seed in point.seeds:
            if not all((point.name, n, seed) in known for n in point.budgets):
                yield IdentificationTask(point, seed)


def _untrained(preset: Preset, store: Store, checkpoint_seconds: float) -> Iterator[PopulationTask]:
    estimates, populations = store.estimates(), preset.populations(store.device)
    tasks = [
        PopulationTask(
            preset,
            index,
            len(populations),
            cells,
            tuple(estimates[c.point, c.n, c.seed] for c in cells),
            folder=store.folder.resolve(),
            checkpoint_seconds=checkpoint_seconds,
            device=store.device,
        )
        for index, cells in enumerate(populations)
    ]
    return left(tasks, store.finished(), lambda task: store.training_seconds(task.index))


def _unrated(preset: Preset, store: Store) -> Iterable[ReferenceTask]:
    known = {(r.controller, r.theta, r.truth) for r in store.references()}
    designs: Designs = {}
    for (name, _, _), theta in store.estimates().items():
        designs.setdefault(theta, set()).add(preset.point(name).truth)
    return reference_tasks(preset, designs, known)


def _about(store: Store, tasks: Sequence[Task]) -> str:
    training = [t for t in tasks if isinstance(t, PopulationTask)]
    resumed = sum(t.checkpoint.exists() for t in training)
    begun = f", {resumed} from a checkpoint" if resumed else ""
    return (
        f"preset [bold]{store.preset.name}[/]: {len(store.preset.cells)} runs, {len(store.finished())} finished; "
        f"{len(training)} populations to train{begun}, {len(tasks) - len(training)} references"
    )
