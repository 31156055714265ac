"""Runs a study to its end, from wherever an earlier attempt left it.

Populations train first, references follow on whatever core is free. Every finished task goes into the store at once;
an unfinished population leaves a checkpoint in the folder. Nothing a number depends on is decided here.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console

from study.cells import PopulationTask, Theta, estimates
from study.config import Preset
from study.progress import Meter, duration
from study.references import ReferenceTask, reference_tasks
from study.store import Store
from study.workers import Task, execute


def run(
    preset: Preset,
    store: Store,
    workers: int,
    console: Console,
    device: str = "cpu",
    checkpoint_seconds: float = 60.0,
) -> None:
    """Finish every run and reference of the preset that the store lacks.

    Raises WorkerFailed where a task fails, after the others have saved; what is finished stays in the store.
    """
    with console.status("measuring and identifying"):
        found = estimates(preset, preset.cells)
    tasks = list(_unfinished(preset, store, found, device, checkpoint_seconds))
    if not tasks:
        return
    work = {task.name: task.work for task in tasks}
    _announce(console, preset, tasks, workers)
    with Meter(console, work) as meter:

        def heard(task: Task, kind: str, payload: Any) -> None:
            """What a worker said: shown, and kept where it is an answer."""
            if kind == "progress":
                meter.update(task.name, payload)
            elif kind == "saved" and isinstance(task, PopulationTask):
                store.note_training(task.index, payload)
            elif kind == "done":
                _keep(task, payload, store)
                meter.update(task.name, 1.0)

        execute(tasks, workers, heard)


def checkpoint_path(folder: Path, population: int) -> Path:
    """Where an unfinished population is kept."""
    return folder / f"population_{population + 1}.checkpoint"


def _partial(checkpoint: Path) -> Path:
    """What a process leaves that dies while it writes a checkpoint."""
    return checkpoint.with_name(checkpoint.name + ".partial")


def _discard(checkpoint: Path) -> None:
    for path in (checkpoint, _partial(checkpoint)):
        path.unlink(missing_ok=True)


def _keep(task: Task, payload: Any, store: Store) -> None:
    if isinstance(task, PopulationTask):
        store.add_runs(payload)
        _discard(task.checkpoint)
    else:
        store.add_references(payload)


def _unfinished(
    preset: Preset, store: Store, found: dict[tuple[int, int], Theta], device: str, checkpoint_seconds: float
) -> Iterable[PopulationTask | ReferenceTask]:
    finished = {run.cell for run in store.runs()}
    for index, cells in enumerate(preset.populations):
        checkpoint = checkpoint_path(store.folder, index)
        if finished.issuperset(cells):
            _discard(checkpoint)
            continue
        _partial(checkpoint).unlink(missing_ok=True)
        before = store.training_seconds(index) if checkpoint.exists() else 0.0
        thetas = tuple(found[c.n, c.seed] for c in cells)
        yield PopulationTask(preset, index, thetas, checkpoint, checkpoint_seconds, before, device)
    known = {(r.controller, r.theta) for r in store.references()}
    for task in reference_tasks(preset, set(found.values())):
        if (task.controller, task.theta) not in known:
            yield task


def _announce(console: Console, preset: Preset, tasks: list[PopulationTask | ReferenceTask], workers: int) -> None:
    training = [t for t in tasks if isinstance(t, PopulationTask)]
    resumed = sum(t.checkpoint.exists() for t in training)
    total = len(preset.cells)
    missing = sum(len(t.cells) for t in training)
    begun = f", {resumed} from a checkpoint" if resumed else ""
    console.print(
        f"preset [bold]{preset.name}[/]: {total} runs, {total - missing} finished; {len(training)} populations to train"
        f"{begun}, {len(tasks) - len(training)} references; {workers} worker{'s' if workers > 1 else ''}",
        soft_wrap=True,
    )
    seconds = sum(t.work for t in tasks) / min(workers, max(len(tasks), 1))
    console.print(f"[dim]expect very roughly {duration(seconds)}; stop it at any time, it goes on", soft_wrap=True)
