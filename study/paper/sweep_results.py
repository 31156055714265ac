"""The results of a study: one SQLite file, tied to one preset, device and version, as study/pipeline/database.py says.

estimates     theta_hat of every (point, n, seed)
runs          every finished (point, n, w, seed): settings, theta_hat, returns, learning curve, versions, seconds
controllers   returns on the hidden plant (truth_m, truth_l) of a reference designed at (m, l), by seed
training      seconds spent on each unfinished population, as of its last checkpoint
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from study.paper.identification import Estimated
from study.paper.presets import FORMAT, Cell, Preset, Theta
from study.paper.reference_controllers import Reference
from study.paper.runs import Run, RunSummary
from study.pipeline.database import Database, identity, readable
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

SWEEP_SCHEMA = """
CREATE TABLE estimates (
    point TEXT, n INTEGER, seed INTEGER, m REAL, l REAL, seconds REAL, PRIMARY KEY (point, n, seed));
CREATE TABLE runs (
    point TEXT, n INTEGER, w REAL, seed INTEGER, population INTEGER, theta_hat_m REAL, theta_hat_l REAL, id_error REAL,
    returns TEXT, curve TEXT, settings TEXT, versions TEXT, seconds REAL, fresh_returns TEXT, imported TEXT,
    summary TEXT, PRIMARY KEY (point, n, w, seed));
CREATE TABLE controllers (
    controller TEXT, m REAL, l REAL, truth_m REAL, truth_l REAL, seed INTEGER, returns TEXT, versions TEXT,
    seconds REAL, PRIMARY KEY (controller, m, l, truth_m, truth_l, seed));
CREATE TABLE training (population INTEGER PRIMARY KEY, seconds REAL);
"""


def outputs(preset: Preset) -> tuple[str, ...]:
    """What a study writes beside its database; never over files of somebody else."""
    drawn = tuple(figure_name(preset, point.name, name) for point in preset.points for name in POINT_FIGURES)
    reproduction = (f"{name}.png" for name in REPRODUCTION_FIGURES)
    return ("runs.csv", "references.csv", "ratings.csv", "study.json", *drawn, *reproduction, "report.html", FOLDER)


def figure_name(preset: Preset, point: str, name: str) -> str:
    """The file of a figure: NAME.png, and NAME_POINT.png where the preset has several points."""
    return f"{name}.png" if len(preset.points) == 1 else f"{name}_{point}.png"


class SweepResults(Database):
    """The open results folder of a preset; a context manager that holds the folder's lock.

    Raises InvalidInput where the folder cannot be used, also where it holds foreign files of the names in `outputs`.
    """

    progress = "training"

    def __init__(self, folder: Path, preset: Preset, device: str = "cpu") -> None:
        self.preset, self.device = preset, device
        super().__init__(folder, SWEEP_SCHEMA, identity(preset, str(FORMAT), device), outputs(preset))

    def add_estimates(self, estimates: Sequence[Estimated]) -> None:
        """Keep what identification found, in place of an earlier answer."""
        rows = [(e.point, e.n, e.seed, *e.theta, e.seconds) for e in estimates]
        self.put("estimates", rows)

    def estimates(self) -> dict[tuple[str, int, int], Theta]:
        """theta_hat by (point, n, seed)."""
        rows = self.db.execute("SELECT point, n, seed, m, l FROM estimates ORDER BY point, n, seed")
        return {(point, n, seed): (m, length) for point, n, seed, m, length in rows}

    def add_runs(self, runs: Sequence[Run]) -> None:
        """Keep the runs of a finished population, all or none, but for those that were imported before."""
        imported = "SELECT 1 FROM runs WHERE point = ? AND n = ? AND w = ? AND seed = ? AND imported <> ''"
        rows = [write_run(run) for run in runs if not self.db.execute(imported, run.cell).fetchone()]
        self.put("runs", rows, {run.population for run in runs}, new=True)

    def add_imported(self, runs: Sequence[Run]) -> int:
        """Take up runs from elsewhere where there are none yet, all or none of them; returns how many."""
        finished = self.finished()
        rows = [write_run(run) for run in runs if run.cell not in finished]
        self.put("runs", rows, new=True)
        return len(rows)

    def finished(self) -> set[Cell]:
        """The cells whose runs are kept."""
        return {Cell(*row) for row in self.db.execute("SELECT point, n, w, seed FROM runs")}

    def runs(self) -> list[Run]:
        """The finished runs, sorted by point, n, w, seed."""
        with readable(self.path):
            return [read_run(row) for row in self.db.execute("SELECT * FROM runs ORDER BY point, n, w, seed")]

    def add_references(self, references: Sequence[Reference]) -> None:
        """Keep what reference controllers returned."""
        rows = [
            (r.controller, *r.theta, *r.truth, r.seed, json.dumps(r.returns), json.dumps(r.versions), r.seconds)
            for r in references
        ]
        self.put("controllers", rows, new=True)

    def references(self) -> list[Reference]:
        """What reference controllers returned, sorted."""
        return [
            Reference(controller, (m, l), (truth_m, truth_l), seed, tuple(json.loads(returns)), json.loads(found), s)
            for controller, m, l, truth_m, truth_l, seed, returns, found, s in self.db.execute(  # noqa: E741
                "SELECT * FROM controllers ORDER BY controller, m, l, truth_m, truth_l, seed"
            )
        ]


def write_run(run: Run) -> tuple[Any, ...]:
    """A run as a row of the table `runs`."""
    summary = None if run.summary is None else (run.summary.mean, run.summary.std, run.summary.fresh_mean)
    return (
        *run.cell, run.population, *run.theta_hat, run.id_error, json.dumps(run.returns), json.dumps(run.curve),
        json.dumps(run.settings), json.dumps(run.versions), run.seconds, json.dumps(run.fresh_returns), run.imported,
        json.dumps(summary),
    )  # fmt: skip


def read_run(row: Sequence[Any]) -> Run:
    """The run in a row of the table `runs`."""
    point, n, w, seed, population, m, length, error, returns, curve, settings, found, seconds, fresh, source, mean = row
    summary = json.loads(mean)
    return Run(
        cell=Cell(point, n, w, seed),
        population=population,
        theta_hat=(m, length),
        id_error=error,
        returns=tuple(json.loads(returns)),
        curve=tuple((step, value) for step, value in json.loads(curve)),
        settings=json.loads(settings),
        versions=json.loads(found),
        seconds=seconds,
        fresh_returns=tuple(json.loads(fresh)),
        imported=source,
        summary=None if summary is None else RunSummary(*summary),
    )
