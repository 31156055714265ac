"""Finished runs from elsewhere: the results.sqlite of another study, or a runs.csv, also the paper's own summary.csv.

A run is taken up only where it is one of the preset's and its estimate is the one that this code finds from the same
rollouts. A table has no episodes and no learning curves. Reference controllers are run anew.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from study.paper.finished_runs import RUNS, Run, read_runs
from study.paper.presets import Estimates, Point, Preset
from study.paper.runs import measured
from study.pipeline.database import META, check_tables, readable
from study.pipeline.population_task import sac_settings
from sysid import InvalidInput
from sysid.data.files import check_input, named

LARGEST_IMPORT = 1 << 32
"""Bytes of a results.sqlite."""
TOLERANCE = 1e-6
"""Largest difference of m [kg] and of l [m] between an estimate and the imported one."""


def import_runs(file: Path, preset: Preset, estimates: Estimates) -> list[Run]:
    """The runs in the file, each marked as imported from it, with the estimates that this code found.

    Raises InvalidInput for a file that cannot be read, and for the first run that does not belong to the preset.
    """
    runs = []
    for run in _database(file) if is_database(file) else _table(file, preset):
        if problem := _foreign(run, preset, estimates):
            raise InvalidInput(f"{file}: {run.cell} does not belong to {preset.name!r}: {problem}")
        theta, truth = estimates[run.cell.point, run.cell.n, run.cell.seed], preset.point(run.cell.point).truth
        runs.append(replace(run, theta_hat=theta, id_error=math.dist(theta, truth), imported=file.name))
    return runs


def is_database(file: Path) -> bool:
    """Whether it is SQLite's, by its first bytes; raises InvalidInput for a file that cannot be read."""
    check_input(file, "a results.sqlite or a runs.csv", LARGEST_IMPORT)
    with named(file, "read"), file.open("rb") as opened:
        return opened.read(16) == b"SQLite format 3\0"


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
    if not all(map(math.isfinite, (run.mean, run.std, run.seconds))):
        return f"its return is {run.mean} with sd {run.std}, its seconds {run.seconds}: expected finite numbers"
    if run.returns and len(run.returns) != preset.episodes:
        return f"it has {len(run.returns)} episodes, expected {preset.episodes}"
    return "; ".join(_changed(run.settings, preset, known))


def _changed(settings: Mapping[str, Any], preset: Preset, point: Point) -> Iterator[str]:
    """What a database says of a run's making that is not the preset's; a table says nothing."""
    sac = {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(sac_settings(preset)).items()}
    for expected, found in ((sac, settings.get("sac", {})), (measured(point), settings)):
        for name, value in expected.items():
            if found.get(name, value) != value:
                yield f"{name} = {found[name]}, expected {value}"


def _database(file: Path) -> list[Run]:
    """The runs of a results.sqlite."""
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True, timeout=3.0)) as db:
            found = dict(db.execute("SELECT key, value FROM meta"))
            if found.get("format") != str(Preset.layout):
                raise InvalidInput(f"--import {file}: it has format {found.get('format')}, expected {Preset.layout}")
            check_tables(db, META + RUNS.schema, file)
            rows = db.execute(f"SELECT * FROM runs ORDER BY {RUNS.key}").fetchall()
    except sqlite3.Error as error:
        raise InvalidInput(f"--import {file}: not the results of a study ({error})") from None
    with readable(file):
        return list(map(RUNS.value, rows))


def _table(file: Path, preset: Preset) -> list[Run]:
    """The runs of a CSV file."""
    found = read_runs(file, "" if len(preset.points) > 1 else preset.points[0].name)
    if "" in found.points:
        raise InvalidInput(f"{file} has no column 'point': expected the points of {preset.name!r} in it")
    return [run for runs in found.table.values() for run in runs.values()]
