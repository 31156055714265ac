"""The results of a study: one SQLite file, tied to one preset, device and version (`study.pipeline.database`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from study.paper.presets import FORMAT, Cell, Preset, Theta
from study.paper.reference_controllers import REFERENCES
from study.paper.runs import ESTIMATES, RUNS, Run
from study.pipeline.database import Database, identity
from study.pipeline.policy_files import FOLDER

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

    def finished(self) -> set[Cell]:
        return {Cell(*row) for row in self.db.execute(f"SELECT {RUNS.key} FROM runs")}
