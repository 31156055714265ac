"""Finished runs from elsewhere: the runs.csv of another study, or the paper's own summary.csv.

A run is taken up only where it is one of the preset's and its estimate is the one that this code finds from the same
rollouts. A table has no episodes and no learning curves. Reference controllers are run anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from study.paper.finished_runs import Run, read_runs
from study.paper.presets import Estimates, Preset
from sysid import InvalidInput

TOLERANCE = 1e-6
"""Largest difference of m [kg] and of l [m] between an estimate and the imported one."""


def read_import(file: Path, preset: Preset) -> list[Run]:
    """The runs in the file, each marked as imported from it. Raises InvalidInput for a file that cannot be read."""
    found = read_runs(file, "" if len(preset.points) > 1 else preset.points[0].name)
    if "" in found.points:
        raise InvalidInput(f"{file} has no column 'point': expected the points of {preset.name!r} in it")
    return [replace(run, imported=file.name) for runs in found.table.values() for run in runs.values()]


def taken_up(runs: Iterable[Run], preset: Preset, estimates: Estimates) -> list[Run]:
    """Imported runs with the estimates that this code found.

    Raises InvalidInput for the first run that does not belong to the preset.
    """
    found = []
    for run in runs:
        if problem := _foreign(run, preset, estimates):
            raise InvalidInput(f"{run.imported}: {run.cell} does not belong to {preset.name!r}: {problem}")
        theta, truth = estimates[run.cell.point, run.cell.n, run.cell.seed], preset.point(run.cell.point).truth
        found.append(replace(run, theta_hat=theta, id_error=math.dist(theta, truth)))
    return found


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
