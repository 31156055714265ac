"""The paper's sweep as an experiment: measure and identify, train and rate references, publish; and the folder of its
results, tied to one preset, device and version.

First every point is measured and identified, then populations train, and references follow on whatever core is free.
An unfinished population leaves a checkpoint in the folder.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from study.paper.imported_runs import import_references, import_runs, is_database
from study.paper.presets import FORMAT, Cell, Preset, Theta
from study.paper.published_runs import Outcomes
from study.paper.reference_controllers import REFERENCES, Designs, reference_tasks
from study.paper.runs import ESTIMATES, RUNS, IdentificationTask, Run, SweepPopulation
from study.pipeline.database import Database, identity
from study.pipeline.executor import Task
from study.pipeline.experiment import Stage, StudyExperiment
from study.pipeline.policy_files import FOLDER
from study.pipeline.population_task import left

POINT_FIGURES = ("heatmap", "pareto", "gap", "curves")
REPRODUCTION_FIGURES = (
    "published_heatmap",
    "published_pareto",
    "published_contrasts",
    "published_claims",
    "identifiers",
)
"""Figures of a point, and those of the whole preset beside the publication."""

PROGRESS = "training (population INTEGER PRIMARY KEY, seconds REAL)"


def outputs(preset: Preset) -> tuple[str, ...]:
    """What a study writes beside its database; never over files of somebody else."""
    drawn = tuple(figure_name(preset, point.name, name) for point in preset.points for name in POINT_FIGURES)
    reproduction = (f"{name}.png" for name in REPRODUCTION_FIGURES)
    return ("runs.csv", "references.csv", "ratings.csv", "study.json", *drawn, *reproduction, "report.html", FOLDER)


def figure_name(preset: Preset, point: str, name: str) -> str:
    """The file of a figure: NAME.png, and NAME_POINT.png where the preset has several points."""
    return f"{name}.png" if len(preset.points) == 1 else f"{name}_{point}.png"


class SweepResults(Database):
    """The open results folder of a preset."""

    def __init__(self, folder: Path, preset: Preset, device: str = "cpu") -> None:
        self.preset, self.device = preset, device
        super().__init__(
            folder, identity(preset, str(FORMAT), device), (ESTIMATES, RUNS, REFERENCES), outputs(preset), PROGRESS
        )

    def estimates(self) -> dict[tuple[str, int, int], Theta]:
        return {(e.point, e.n, e.seed): e.theta for e in self.all(ESTIMATES)}

    def add_imported(self, runs: Sequence[Run]) -> int:
        """Take up runs from elsewhere where there are none yet, all or none of them; returns how many."""
        there = self.finished()
        new = [run for run in runs if run.cell not in there]
        self.add(RUNS, new)
        return len(new)

    def has(self, cell: Cell) -> bool:
        """Whether its run is kept."""
        where = "point = ? AND n = ? AND w = ? AND seed = ?"
        return self.db.execute(f"SELECT 1 FROM runs WHERE {where}", cell).fetchone() is not None

    def finished(self) -> set[Cell]:
        return {Cell(*row) for row in self.db.execute(f"SELECT {RUNS.key} FROM runs")}


@dataclass(eq=False)
class Sweep(StudyExperiment):
    """A preset with its results; imported: a file whose finished runs are taken up; theirs: the authors' runs, which
    ours are paired with in the report."""

    preset: Preset
    results: SweepResults
    checkpoint_seconds: float = 60.0
    imported: Path | None = None
    theirs: Outcomes | None = None

    def stages(self, console: Console) -> Iterator[Stage]:
        """Identification; then training and references, after the runs in `imported` were taken up."""
        if self.imported is not None:
            is_database(self.imported)  # a file that cannot be read is refused before anything runs
        yield Stage(list(self._unidentified()))
        if self.imported is not None:
            taken = self.results.add_imported(import_runs(self.imported, self.preset, self.results.estimates()))
            console.print(f"{taken} runs taken up from {self.imported}", soft_wrap=True)
            known = self._rated()
            rated = import_references(self.imported, self.preset, self._designs())
            self.results.add(REFERENCES, [r for r in rated if (r.controller, r.theta, r.truth) not in known])
        tasks: list[Task] = [*self._untrained(), *reference_tasks(self.preset, self._designs(), self._rated())]
        yield Stage(tasks, self._about(tasks))

    def keep(self, task: Task, answer: Any) -> None:
        """As ever, but for runs of the population that were taken up from elsewhere."""
        super().keep(task, [own for own in answer if task.table is not RUNS or not self.results.has(own.cell)])

    def publish(self, console: Console) -> None:
        from study.paper.sweep_report import publish_sweep

        publish_sweep(self.preset, self.results, console, self.theirs)

    def _unidentified(self) -> Iterator[IdentificationTask]:
        known = self.results.estimates()
        for point in self.preset.points:
            for seed in point.seeds:
                if not all((point.name, n, seed) in known for n in point.budgets):
                    yield IdentificationTask(point, seed)

    def _untrained(self) -> Iterator[SweepPopulation]:
        results, tasks = self.results, []
        populations, found = self.preset.populations(results.device), results.estimates()
        for index, cells in enumerate(populations):
            theta = tuple(found[cell.point, cell.n, cell.seed] for cell in cells)
            tasks.append(SweepPopulation(self.preset, index, len(populations), cells, theta, **self.training))
        return left(tasks, results.finished(), lambda task: results.training_seconds(task.progress_key))

    def _designs(self) -> Designs:
        designs: Designs = {}
        for (name, _, _), theta in self.results.estimates().items():
            designs.setdefault(theta, set()).add(self.preset.point(name).truth)
        return designs

    def _rated(self) -> set[tuple[str, Theta, Theta]]:
        return {(r.controller, r.theta, r.truth) for r in self.results.all(REFERENCES)}

    def _about(self, tasks: Sequence[Task]) -> str:
        training = [t for t in tasks if isinstance(t, SweepPopulation)]
        resumed = sum(t.checkpoint.exists() for t in training)
        begun = f", {resumed} from a checkpoint" if resumed else ""
        return (
            f"preset [bold]{self.preset.name}[/]: {len(self.preset.cells)} runs, {len(self.results.finished())} "
            f"finished; {len(training)} populations to train{begun}, {len(tasks) - len(training)} references"
        )
