"""The report of a sweep: tables for other programs, one HTML page that opens without a network and begins with the
answer in words, and the same in a terminal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial
from operator import attrgetter
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from study.paper import published_numbers as paper
from study.paper.agreement import MARGIN
from study.paper.finished_runs import RUNS, Outcomes, write_runs
from study.paper.identification_scatter import scatter
from study.paper.presets import Point, Preset
from study.paper.reference_controllers import (
    CONTROLLERS,
    LQR,
    OPTIMAL,
    RATINGS,
    REFERENCES,
    SWING_UP,
    Rating,
    Reference,
    fresh_optimum,
)
from study.paper.reproduction import REPRODUCTION_CAPTIONS, Reproduction, reproduce
from study.paper.sweep_figures import save_all
from study.paper.sweep_findings import PointFindings
from study.pipeline.database import Database
from study.pipeline.html_page import say, say_files, template
from study.pipeline.tables import write_rows
from study.pipeline.versions import all_versions, write_record
from sysid.data.files import write_whole

REFERENCE_COLUMNS = ("m", "l", "controller", "return_mean", "return_sem")


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
    write_rows(path, REFERENCE_COLUMNS, rows)


def write_ratings(references: Sequence[Reference], path: Path) -> None:
    """A `Rating` a reference controller and seed: what an import of these runs need not compute again."""
    columns = [f.name for f in fields(Rating)]
    write_rows(path, columns, (attrgetter(*columns)(reference) for reference in references))


def write_study(found: Sequence[PointFindings], device: str, path: Path) -> None:
    """What the runs depend on: preset, settings, device, versions, and the hours that workers spent on them."""
    preset, runs = found[0].preset, [run for point_findings in found for run in point_findings.runs]
    about = {"runs": len(runs), "imported": sum(bool(run.imported) for run in runs)}
    hours = sum(run.seconds for run in runs) / 3600.0
    write_record(path, preset, device, about, hours, [run.versions for run in runs])


CONTROLLER_LABELS = {OPTIMAL: "optimal (dynamic programming)", LQR: "LQR alone", SWING_UP: "energy swing-up, then LQR"}

POINT_CAPTIONS = {
    "heatmap": "Mean return on the hidden plant ± standard error over seeds. The best cell is outlined; the brightest "
    "colour is the optimum.",
    "pareto": "The best width at every budget, between training without data and training on the most data.",
    "gap": "Diamonds: the controller that is optimal for the estimate, run on the hidden plant. From the red line to a "
    "diamond is what identification cost; from the diamond to a dot is what training and width cost.",
    "curves": "Returns of training episodes in the simulators agents train on, averaged over seeds and ten episodes.",
}


def publish_sweep(
    preset: Preset, results: Database, console: Console, theirs: Outcomes | None = None
) -> list[PointFindings]:
    """Write tables, figures and report into the folder and say the answers on the console, point by point.

    theirs: the authors' runs, which ours are paired with.
    """
    folder = results.folder
    with console.status("drawing"):
        references = results.all(REFERENCES)
        runs = results.all(RUNS)
        found = [PointFindings(preset, point, runs, references) for point in preset.points]
        write_runs((run for answer in found for run in answer.runs), folder / "runs.csv")
        write_references(found, folder / "references.csv")
        write_ratings(references, folder / RATINGS)
        write_study(found, results.device, folder / "study.json")
        drawn = [save_all(answer, folder) for answer in found]
        identified, optimum = None, None
        if preset.episodes == paper.EPISODES:  # else evaluations are not as published
            identified = scatter(np.random.default_rng(0))
            optimum = partial(fresh_optimum, preset, paper.POINTS["main"].truth)
        reproduction = reproduce(found, folder, theirs, identified, optimum)
        write_sweep_report(found, drawn, folder / "report.html", reproduction)
    for answer in found:
        console.print()
        if len(found) > 1:
            console.print(f"[bold underline]{title(answer.point)}[/]\n")
        say(console, answer.sentences())
        console.print(f"[dim]{escape(answer.caveat())}[/]\n")
    say(console, reproduction.sentences())
    say_files(console, folder, [path for files in [*drawn, reproduction.figures] for path in files.values()])
    return found


def title(point: Point) -> str:
    """An operating point in a line."""
    m, l = point.truth  # noqa: E741
    band = "" if point.randomization == "band" else ", trained over the prior range"
    return (
        f"{point.name.replace('_', ' ')}: m = {m:g} kg, l = {l:g} m, speed read to {point.sigma:g} rad/s, "
        f"identified by {point.identifier.replace('_', ' ')}{band}"
    )


def write_sweep_report(
    found: Sequence[PointFindings], drawn: Sequence[Mapping[str, Path]], path: Path, reproduction: Reproduction
) -> None:
    """Write the self-contained report: a section a point, with the figures of these files (one mapping a point), and
    one that holds all of them against the publication."""
    preset, runs = found[0].preset, [run for answer in found for run in answer.runs]
    references = {(r.key, r.seed): r for answer in found for r in answer.references}
    made = [*runs, *references.values()]
    origins = (run.imported + ", a table, which does not say how they were trained" * (not run.returns) for run in runs)
    content = template("sweep.html.j2").render(
        plan=preset,
        preset=preset,
        parts=list(zip(found, drawn, strict=True)),
        captions=POINT_CAPTIONS,
        controllers=CONTROLLER_LABELS,
        id_errors=paper.ID_ERRORS,
        settings={name: value for name, value in preset.to_dict().items() if name != "points"},
        sac=next((run.settings["sac"] for run in runs if "sac" in run.settings), {}),
        versions=list(all_versions(item.versions for item in made).items()),
        seconds=sum(item.seconds for item in made),
        imported=Counter(filter(None, origins)),
        reproduction=reproduction,
        reproduction_captions=REPRODUCTION_CAPTIONS,
        paper=paper,
        margin=MARGIN,
    )
    write_whole(path, content)
