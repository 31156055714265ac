"""Finished runs: as a study keeps them, in runs.csv, and in the authors' per-run files, which begin with its columns.

    theirs = read_published(Path("sim2real_budget/results"))     summary.csv, exp_*.csv; `missing`: those not there
    ours = read_runs(Path("study/results/paper-small/runs.csv"))

A cell is a Spot (point, n, w); its runs are told apart by their seeds.

Runs from elsewhere, of another study's runs.csv or the paper's own summary.csv, are taken up where they are the
preset's and their estimate is the one that this code finds from the same rollouts. A table has no episodes and no
learning curves. Reference controllers are run anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from study.paper.presets import Cell, Estimates, Preset, Theta
from study.paper.published_numbers import POINTS, URL, CellSummary, Spot
from study.pipeline.tables import ResultTable, read_table
from study.statistics import sem
from sysid import InvalidInput


@dataclass(frozen=True)
class Run:
    """A finished cell, with everything its number depends on.

    theta_hat (m [kg], l [m]); id_error = ||theta_hat - truth||; mean and std (divided by E) of the returns (E,) from
    the paper's start states, and fresh_mean of fresh_returns (E,), from start states that no other seed shares, nan
    where these were not evaluated; curve: (env steps done, return) of the training episodes; seconds: the run's share
    of its population's time.

    A run that was taken up from elsewhere says in `imported` from which file; it has no episodes and no curve.
    """

    cell: Cell
    theta_hat: Theta
    id_error: float
    mean: float
    std: float = math.nan
    fresh_mean: float = math.nan
    seconds: float = math.nan
    returns: tuple[float, ...] = ()
    fresh_returns: tuple[float, ...] = ()
    curve: tuple[tuple[int, float], ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    imported: str = ""


RUNS = ResultTable(
    "runs",
    Run,
    "point TEXT, n INTEGER, w REAL, seed INTEGER, theta_hat_m REAL, theta_hat_l REAL, id_error REAL, mean REAL, "
    "std REAL, fresh_mean REAL, seconds REAL, returns TEXT, fresh_returns TEXT, curve TEXT, settings TEXT, "
    "versions TEXT, imported TEXT",
    keys=4,
)


@dataclass(frozen=True, kw_only=True)
class RunRow:
    """A row of runs.csv: first the columns of the paper's summary.csv, so that one program reads both files.

    eval_return_std is over the run's episodes and divided by their number E (ddof = 0), which is what NumPy's std does
    by default and what the authors' published code calls. eval_return_fresh is the mean from start states that no
    other seed shares; None for a run that was imported without.
    """

    n: int
    w: float
    seed: int
    id_error: float
    eval_return_mean: float
    eval_return_std: float = math.nan
    theta_hat_mass: float
    theta_hat_length: float
    wall_time_s: float = math.nan
    point: str = ""
    eval_return_fresh: float = math.nan


def run_table(runs: Iterable[Run]) -> tuple[Sequence[str], Iterable[Sequence[object]]]:
    """Columns and rows of runs.csv, a `RunRow` a run in their order."""
    return [f.name for f in fields(RunRow)], [
        (r.cell.n, r.cell.w, r.cell.seed, r.id_error, r.mean, r.std, *r.theta_hat, r.seconds, r.cell.point,
         "" if math.isnan(r.fresh_mean) else r.fresh_mean)
        for r in runs
    ]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Runs by cell and seed; `missing` names the files that were expected and not there."""

    table: Mapping[Spot, Mapping[int, Run]]
    missing: tuple[str, ...] = ()

    def __contains__(self, spot: object) -> bool:
        return spot in self.table

    @property
    def points(self) -> tuple[str, ...]:
        """Operating points, in the order in which they came."""
        return tuple(dict.fromkeys(spot.point for spot in self.table))

    def budgets(self, point: str) -> tuple[int, ...]:
        """Budgets that an operating point was run with, ascending."""
        return tuple(sorted({spot.n for spot in self.table if spot.point == point}))

    def seeds(self, *spots: Spot) -> tuple[int, ...]:
        """Seeds that all of these cells share, ascending."""
        return tuple(sorted(set.intersection(*(set(self.table.get(spot, {})) for spot in spots))))

    def returns(self, spot: Spot, seeds: Sequence[int] | None = None, *, fresh: bool = False) -> NDArray[np.float64]:
        """Mean returns (S,) of a cell, by default of all its seeds in their order."""
        runs = self.table[spot]
        chosen = [runs[seed] for seed in (sorted(runs) if seeds is None else seeds)]
        return np.array([run.fresh_mean if fresh else run.mean for run in chosen])

    def pair(self, a: Spot, b: Spot, *, fresh: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Returns (S,) of two cells over the seeds that both have."""
        seeds = self.seeds(a, b)
        return self.returns(a, seeds, fresh=fresh), self.returns(b, seeds, fresh=fresh)

    def summary(self, spot: Spot, *, fresh: bool = False) -> CellSummary:
        """Mean, its standard error, median and number of seeds of a cell."""
        values = self.returns(spot, fresh=fresh)
        return CellSummary(float(np.mean(values)), sem(values), float(np.median(values)), len(values))

    def id_errors(self, point: str, n: int) -> NDArray[np.float64]:
        """||theta_hat - truth|| (S,) of a budget, from its narrowest width: all widths share the estimate."""
        spot = min((s for s in self.table if (s.point, s.n) == (point, n)), key=lambda s: s.w)
        return np.array([self.table[spot][seed].id_error for seed in sorted(self.table[spot])])

    def merged(self, other: Outcomes) -> Outcomes:
        """These, and those cells of the others that are not here."""
        return Outcomes({**other.table, **self.table}, self.missing)


def outcomes(runs: Iterable[Run]) -> Outcomes:
    """The runs by cell and seed; raises InvalidInput where one comes twice."""
    table: dict[Spot, dict[int, Run]] = {}
    for run in runs:
        by_seed = table.setdefault(Spot(*run.cell[:3]), {})
        if run.cell.seed in by_seed:
            raise InvalidInput(f"{run.cell} comes twice: expected it once")
        by_seed[run.cell.seed] = run
    return Outcomes(table)


def read_runs(path: Path, point: str = "main") -> Outcomes:
    """The runs of a CSV file; rows without a point are of the one named here.

    Raises InvalidInput for a file that cannot be read, lacks a column, holds something else than finite numbers, or one
    run twice.
    """
    runs = []
    for line, row in enumerate(read_table(RunRow, path, "runs"), 2):
        theta = row.theta_hat_mass, row.theta_hat_length
        if not all(map(math.isfinite, (row.eval_return_mean, row.id_error, *theta, row.w))):
            raise InvalidInput(f"{path}, line {line} holds NaN or infinity: expected finite numbers")
        reached = row.eval_return_mean, row.eval_return_std, row.eval_return_fresh
        cell = Cell(row.point or point, row.n, row.w, row.seed)
        runs.append(Run(cell, theta, row.id_error, *reached, row.wall_time_s))
    try:
        return outcomes(runs)
    except InvalidInput as error:
        raise InvalidInput(f"{path}: {error}") from None


def read_published(folder: Path) -> Outcomes:
    """The authors' runs from a folder with some of their files. Raises InvalidInput where none of them is there."""
    if not folder.is_dir():
        raise InvalidInput(f"--published {folder} is no folder: expected the results folder of {URL}")
    files = {name: folder / point.file for name, point in POINTS.items()}
    parts = {name: read_runs(path, name) for name, path in files.items() if path.exists()}
    if not parts:
        names = ", ".join(path.name for path in files.values())
        raise InvalidInput(f"--published {folder} holds none of {names}: expected the results folder of {URL}")
    table = {spot: runs for part in parts.values() for spot, runs in part.table.items()}
    return Outcomes(table, tuple(path.name for name, path in files.items() if name not in parts))


TOLERANCE = 1e-6
"""Difference of m [kg] and of l [m] up to which two estimates are one: the paper's are cells of a grid."""


def read_import(file: Path, preset: Preset) -> list[Run]:
    """The runs in the file, each marked as imported from it. Raises InvalidInput for a file that cannot be read."""
    contents = read_runs(file, "" if len(preset.points) > 1 else preset.points[0].name)
    if "" in contents.points:
        raise InvalidInput(f"{file} has no column 'point': expected the points of {preset.name!r} in it")
    return [replace(run, imported=file.name) for runs in contents.table.values() for run in runs.values()]


def taken_up(runs: Iterable[Run], preset: Preset, estimates: Estimates) -> list[Run]:
    """Imported runs with the estimates that this code found.

    Raises InvalidInput for the first run that does not belong to the preset.
    """
    taken = []
    for run in runs:
        if problem := _foreign(run, preset, estimates):
            raise InvalidInput(f"{run.imported}: {run.cell} does not belong to {preset.name!r}: {problem}")
        theta, truth = estimates[run.cell.point, run.cell.n, run.cell.seed], preset.point(run.cell.point).truth
        taken.append(replace(run, theta_hat=theta, id_error=math.dist(theta, truth)))
    return taken


def _foreign(run: Run, preset: Preset, estimates: Estimates) -> str:
    """Why a run is not one of the preset's; empty where it is."""
    point, n, w, seed = run.cell
    known = {p.name: p for p in preset.points}.get(point)
    if known is None:
        return f"expected one of the points {', '.join(p.name for p in preset.points)}"
    if n not in known.budgets or w not in known.widths or seed not in known.seeds:
        return f"expected n in {known.budgets}, w in {known.widths} and a seed in {known.seeds}"
    theta = estimates[point, n, seed]
    if not all(abs(a - b) <= TOLERANCE for a, b in zip(run.theta_hat, theta, strict=True)):
        return f"its theta_hat is {run.theta_hat}, expected {theta} from the rollouts of that seed"
    if not all(map(math.isfinite, (run.std, run.seconds))):
        return f"its return is {run.mean} with sd {run.std}, its seconds {run.seconds}: expected finite numbers"
    return ""
