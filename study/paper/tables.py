"""The study's tables as CSV and what made them as JSON, for other programs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from study.paper.findings import PointFindings
from study.paper.presets import Preset
from study.paper.published_runs import RunRow
from study.paper.reference_controllers import CONTROLLERS, Reference
from study.pipeline.tables import write_csv
from study.pipeline.versions import write_record

RATINGS = "ratings.csv"
"""The table of references, seed by seed."""

REFERENCE_COLUMNS = ("m", "l", "controller", "return_mean", "return_sem")


def write_runs(found: Sequence[PointFindings], path: Path) -> None:
    """A `RunRow` a run, sorted by n, w, seed, point by point."""
    rows = [
        (r.cell.n, r.cell.w, r.cell.seed, r.id_error, r.mean, r.std, *r.theta_hat, r.seconds, r.cell.point,
         "" if math.isnan(r.fresh_mean) else r.fresh_mean)
        for point_findings in found
        for r in sorted(point_findings.runs, key=lambda r: r.cell)
    ]  # fmt: skip
    write_csv(path, [f.name for f in fields(RunRow)], rows)


def write_references(found: Sequence[PointFindings], path: Path) -> None:
    """One row a controller, designed at a hidden plant's own (m, l).

    Mean and SEM are over the start states of the preset's reference seeds, the paper's ten, so that these numbers do
    not change with the preset; gaps in the report are paired over the study's own seeds.
    """
    rows = [
        (*truth, controller, *answer.rating(controller, answer.preset.reference_seeds))
        for truth, answer in {answer.point.truth: answer for answer in found}.items()
        for controller in CONTROLLERS
    ]
    write_csv(path, REFERENCE_COLUMNS, rows)


@dataclass(frozen=True)
class Rating:
    """The mean return on the hidden plant (truth_m, truth_l), from a seed's start states, of a controller designed at
    (m, l) on a table of so many angles."""

    controller: str
    m: float
    l: float  # noqa: E741
    truth_m: float
    truth_l: float
    seed: int
    return_mean: float
    grid: int
    episodes: int


def write_ratings(preset: Preset, references: Sequence[Reference], path: Path) -> None:
    """One row a reference controller and seed: what an import of these runs need not compute again."""
    rows = (Rating(r.controller, *r.theta, *r.truth, r.seed, r.mean, preset.grid, preset.episodes) for r in references)
    write_csv(path, [f.name for f in fields(Rating)], map(astuple, rows))


def write_study(found: Sequence[PointFindings], device: str, path: Path) -> None:
    """What the runs depend on: preset, settings, device, versions, and the hours that workers spent on them."""
    preset, runs = found[0].preset, [run for point_findings in found for run in point_findings.runs]
    about = {"runs": len(runs), "imported": sum(bool(run.imported) for run in runs)}
    hours = sum(run.seconds for run in runs) / 3600.0
    write_record(path, preset, device, about, hours, [run.versions for run in runs])
