"""The results of a study: one SQLite file, tied to one preset, device and version, as study/pipeline/database.py says.

ESTIMATES    theta_hat of every (point, n, seed)
RUNS         every finished (point, n, w, seed): settings, theta_hat, returns, learning curve, versions, seconds
REFERENCES   returns on the hidden plant (truth_m, truth_l) of a reference designed at (m, l), by seed
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from study.paper.identification import Estimated
from study.paper.presets import FORMAT, Cell, Preset, Theta
from study.paper.reference_controllers import Reference
from study.paper.runs import Run
from study.pipeline.database import Database, identity
from study.pipeline.policy_files import FOLDER
from study.pipeline.record_table import Table

POINT_FIGURES = ("heatmap", "pareto", "gap", "curves")
REPRODUCTION_FIGURES = (
    "published_heatmap",
    "published_pareto",
    "published_contrasts",
    "published_claims",
    "identifiers",
)
"""Figures of a point, and those of the whole preset beside the publication."""

ESTIMATES = Table("estimates", Estimated, "point TEXT, n INTEGER, seed INTEGER, m REAL, l REAL, seconds REAL", keys=3)
RUNS = Table(
    "runs",
    Run,
    "point TEXT, n INTEGER, w REAL, seed INTEGER, population INTEGER, theta_hat_m REAL, theta_hat_l REAL, "
    "id_error REAL, returns TEXT, curve TEXT, settings TEXT, versions TEXT, seconds REAL, fresh_returns TEXT, "
    "imported TEXT, summary TEXT",
    keys=4,
)
REFERENCES = Table(
    "controllers",
    Reference,
    "controller TEXT, m REAL, l REAL, truth_m REAL, truth_l REAL, seed INTEGER, returns TEXT, versions TEXT, "
    "seconds REAL",
    keys=6,
)
TABLES = (ESTIMATES, RUNS, REFERENCES)
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
        super().__init__(folder, identity(preset, str(FORMAT), device), TABLES, outputs(preset), PROGRESS)

    def estimates(self) -> dict[tuple[str, int, int], Theta]:
        return {(e.point, e.n, e.seed): e.theta for e in self.all(ESTIMATES)}

    def add_runs(self, runs: Sequence[Run]) -> None:
        """Keep the runs of a finished population, all or none, but for those that were imported before."""
        there = {Cell(*row) for row in self.db.execute(f"SELECT {RUNS.key} FROM runs WHERE imported <> ''")}
        self.add(RUNS, [run for run in runs if run.cell not in there], {run.population for run in runs}, new=True)

    def add_imported(self, runs: Sequence[Run]) -> int:
        """Take up runs from elsewhere where there are none yet, all or none of them; returns how many."""
        there = self.finished()
        new = [run for run in runs if run.cell not in there]
        self.add(RUNS, new, new=True)
        return len(new)

    def finished(self) -> set[Cell]:
        return {Cell(*row) for row in self.db.execute(f"SELECT {RUNS.key} FROM runs")}
