"""The paper's sweep as an experiment: measure and identify, train and rate references, publish; and the folder of its
results, tied to one preset, device and version.

First every point is measured and identified, then populations train, and references follow on whatever core is free.
An unfinished population leaves a checkpoint in the folder.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from study.paper.finished_runs import RUNS, Outcomes, read_published
from study.paper.identification_scatter import scatter
from study.paper.imported_runs import read_import, taken_up
from study.paper.presets import PAPER, Estimates, Preset
from study.paper.reference_controllers import REFERENCES, fresh_optimum, reference_tasks
from study.paper.reproduction import reproduce
from study.paper.runs import ESTIMATES, SweepPopulation, identification_task
from study.paper.sweep_findings import PointFindings
from study.paper.sweep_page import outputs, sweep_account
from study.pipeline.database import Database
from study.pipeline.executor import BriefTask, Task
from study.pipeline.publication import PUBLISHED, Account, publish
from study.pipeline.settings import RunOptions
from study.pipeline.stages import Stage, StudyExperiment


def sweep_results(folder: Path, preset: Preset, device: str = "cpu") -> Database:
    """The open results folder of a preset."""
    return Database(folder, preset, (ESTIMATES, RUNS, REFERENCES), (*outputs(preset), *PUBLISHED), device)


@contextlib.contextmanager
def open_experiment(preset: Preset, options: RunOptions) -> Iterator[StudyExperiment]:
    """The experiment over the open folder of its results."""
    theirs = read_published(options.published) if options.published else None
    with sweep_results(options.folder, preset, options.device) as results:
        yield Sweep(preset, results, options.checkpoint_seconds, options.imported, theirs)


@dataclass(eq=False)
class Sweep(StudyExperiment):
    """A preset with its results; imported: a file whose finished runs are taken up; theirs: the authors' runs, which
    ours are paired with in the report."""

    preset: Preset
    results: Database
    checkpoint_seconds: float = 60.0
    imported: Path | None = None
    theirs: Outcomes | None = None

    def stages(self, console: Console) -> Iterator[Stage]:
        """Identification; then training and references, after the runs in `imported` were taken up."""
        imported = read_import(self.imported, self.preset) if self.imported else []
        yield Stage(list(self._unidentified()))
        if self.imported:
            there = self.results.keys(RUNS)
            new = [run for run in taken_up(imported, self.preset, self.estimates()) if run.cell not in there]
            self.results.add(RUNS, new)
            console.print(f"{len(new)} runs taken up from {self.imported}", soft_wrap=True)
        known = {key[:-1] for key in self.results.keys(REFERENCES)}
        tasks: list[Task] = [*self._untrained(), *reference_tasks(self.preset, self.estimates(), known)]
        yield Stage(tasks, self._about(tasks))

    def keep(self, task: Task, answer: Any) -> None:
        """As ever, but for runs of the population that were taken up from elsewhere."""
        there = self.results.keys(RUNS)
        super().keep(task, [run for run in answer if run.cell not in there] if task.table is RUNS else answer)

    def publish(self, console: Console) -> None:
        publish(self.results, self._account, console)

    def _account(self) -> Account:
        runs, references = self.results.all(RUNS), self.results.all(REFERENCES)
        found = [PointFindings(self.preset, point, runs, references) for point in self.preset.points]
        identified, optimum = None, None
        if self.preset.episodes == PAPER.episodes:  # else evaluations are not as published
            identified = scatter(np.random.default_rng(0))
            optimum = partial(fresh_optimum, self.preset, PAPER.points[0].truth)
        return sweep_account(found, reproduce(found, self.results.folder, self.theirs, identified, optimum))

    def estimates(self) -> Estimates:
        """theta_hat by (point, n, seed)."""
        return {(e.point, e.n, e.seed): e.theta for e in self.results.all(ESTIMATES)}

    def _unidentified(self) -> Iterator[BriefTask]:
        known = self.results.keys(ESTIMATES)
        for point in self.preset.points:
            for seed in point.seeds:
                if not all((point.name, n, seed) in known for n in point.budgets):
                    yield identification_task(point, seed)

    def _untrained(self) -> list[SweepPopulation]:
        found, tasks = self.estimates(), []
        for index, cells in enumerate(self.preset.populations(self.results.device)):
            theta = tuple(found[cell.point, cell.n, cell.seed] for cell in cells)
            tasks.append(SweepPopulation(self.preset, index, cells, theta, **self.training))
        return sorted(self.unfinished(tasks, RUNS), key=self._between)

    def _between(self, task: SweepPopulation) -> float:
        """How far inside its point's widths a population trains: the narrowest and the widest band come first, since
        a sweep that is stopped then knows what width costs."""
        w, widths = task.cells[0].w, self.preset.point(task.cells[0].point).widths
        return min(w - min(widths), max(widths) - w)

    def _about(self, tasks: Sequence[Task]) -> str:
        training = [t for t in tasks if isinstance(t, SweepPopulation)]
        resumed = sum(t.checkpoint.exists() for t in training)
        begun = f", {resumed} from a checkpoint" if resumed else ""
        return (
            f"preset [bold]{self.preset.name}[/]: {len(self.preset.cells)} runs, {len(self.results.keys(RUNS))} "
            f"finished; {len(training)} populations to train{begun}, {len(tasks) - len(training)} references"
        )
