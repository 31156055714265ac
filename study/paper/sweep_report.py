"""The report: one HTML file that opens without a network, the answer in words first; and the same in a terminal."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape

from study.paper import published_numbers as paper
from study.paper import tables
from study.paper.figures.operating_point import save_all
from study.paper.findings import PointFindings, findings_by_point
from study.paper.identification_scatter import scatter
from study.paper.presets import Point, Preset
from study.paper.published_runs import Outcomes
from study.paper.reference_controllers import LQR, OPTIMAL, SWING_UP, fresh_optimum
from study.paper.reproduction import Reproduction, reproduce
from study.paper.reproduction_page import section
from study.paper.runs import Run
from study.paper.sweep_results import REFERENCES, RUNS, SweepResults
from study.pipeline.html_page import embedded, template, unbroken
from study.pipeline.progress import duration
from study.pipeline.versions import all_versions
from study.statistics import Contrast, holm, paired_t
from sysid.data.files import write_whole

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
    preset: Preset, results: SweepResults, console: Console, theirs: Outcomes | None = None
) -> list[PointFindings]:
    """Write tables, figures and report into the folder and say the answers on the console, point by point.

    theirs: the authors' runs, which ours are paired with.
    """
    folder = results.folder
    with console.status("drawing"):
        references = results.all(REFERENCES)
        found = findings_by_point(preset, results.all(RUNS), references)
        tables.write_runs(found, folder / "runs.csv")
        tables.write_references(found, folder / "references.csv")
        tables.write_ratings(preset, references, folder / tables.RATINGS)
        tables.write_study(found, results.device, folder / "study.json")
        drawn = [save_all(answer, folder) for answer in found]
        identified = scatter(np.random.default_rng(0)) if preset.episodes == paper.EPISODES else None
        reproduction = reproduce(found, folder, theirs, identified, _fresh_optimum(preset))
        write_report(found, drawn, folder / "report.html", reproduction)
    for answer in found:
        console.print()
        if len(found) > 1:
            console.print(f"[bold underline]{title(answer.point)}[/]\n")
        for question, text in answer.sentences():
            console.print(f"[bold]{question}[/]\n{escape(text)}\n", soft_wrap=False)
        console.print(f"[dim]{escape(answer.caveat())}[/]\n")
    for question, text in reproduction.sentences():
        console.print(f"[bold]{question}[/]\n{escape(text)}\n", soft_wrap=False)
    console.print(f"report   {folder / 'report.html'}", soft_wrap=True)
    files = [str(path) for files in [*drawn, reproduction.figures] for path in files.values()]
    console.print(f"figures  {', '.join(files)}", soft_wrap=True)
    return found


def _fresh_optimum(preset: Preset) -> Callable[[Sequence[int]], float] | None:
    """At the paper's main plant, of such seeds; None where evaluations are not as published."""
    if preset.episodes != paper.EPISODES:
        return None
    return lambda seeds: fresh_optimum(preset, paper.POINTS["main"].truth, seeds)


def title(point: Point) -> str:
    """An operating point in a line."""
    m, l = point.truth  # noqa: E741
    band = "" if point.randomization == "band" else ", trained over the prior range"
    return (
        f"{point.name.replace('_', ' ')}: m = {m:g} kg, l = {l:g} m, "
        f"speed read to {point.sigma:g} rad/s, "
        f"identified by {point.identifier.replace('_', ' ')}{band}"
    )


def write_report(
    found: Sequence[PointFindings], drawn: Sequence[Mapping[str, Path]], path: Path, reproduction: Reproduction
) -> None:
    """Write the self-contained report: a section a point, with the figures of these files (one mapping a point), and
    one that holds all of them against the publication."""
    content = _content(found, drawn) | {"publication": section(reproduction, found[0].preset)}
    write_whole(path, template("report.html.j2").render(content))


def _content(found: Sequence[PointFindings], drawn: Sequence[Mapping[str, Path]]) -> dict[str, Any]:
    preset = found[0].preset
    runs = [run for answer in found for run in answer.runs]
    references = {(r.controller, r.theta, r.truth, r.seed): r for answer in found for r in answer.references}
    settings = preset.to_dict()
    del settings["points"]
    return {
        "preset": preset,
        "parts": [_part(answer, files) for answer, files in zip(found, drawn, strict=True)],
        "settings": settings,
        "sac": next((run.settings["sac"] for run in runs if "sac" in run.settings), {}),
        "versions": list(all_versions(item.versions for item in [*runs, *references.values()]).items()),
        "worker_time": duration(sum(item.seconds for item in [*runs, *references.values()])),
        "imported": Counter(_origin(run) for run in runs if run.imported),
    }


def _part(answer: PointFindings, drawn: Mapping[str, Path]) -> dict[str, Any]:
    """What the section of an operating point shows."""
    seeds = answer.point.seeds
    return {
        "answer": answer,
        "point": answer.point,
        "sentences": [(question, unbroken(text)) for question, text in answer.sentences()],
        "images": [(name, embedded(file), POINT_CAPTIONS[name]) for name, file in drawn.items()],
        "budget_rows": _budgets(answer),
        "cell_rows": [_cell_row(answer, key) for key in answer.cells],
        "contrasts": _contrasts(answer),
        "controllers": [
            (CONTROLLER_LABELS[c], mean, sem, here)
            for (c, mean, sem), (_, here, _) in zip(answer.controllers(), answer.controllers(seeds), strict=True)
        ],
    }


def _origin(run: Run) -> str:
    return run.imported + (", a table, which does not say how they were trained" if run.summary else "")


def _budgets(answer: PointFindings) -> list[tuple[int, float, float | None]]:
    """(n, our mean identification error, the paper's of the same operating point)."""
    printed = paper.ID_ERRORS.get(answer.point.name, {})
    return [(n, answer.id_error(n), printed.get(n)) for n in answer.point.budgets]


def _cell_row(answer: PointFindings, key: tuple[int, float]) -> dict[str, Any]:
    gap = answer.gap(key)
    return {
        "n": key[0],
        "w": key[1],
        "mean": answer.mean(key),
        "sem": answer.sem(key),
        "median": float(np.median(answer.returns(key))),
        "best": key == answer.best,
        "gap": gap.total,
        "percent": 100.0 * gap.total.mean / abs(answer.optimum),
        "identification": gap.identification,
        "training": gap.training,
    }


def _contrasts(answer: PointFindings) -> list[tuple[str, Contrast, Contrast, float]]:
    """Every step of the budget at the least width, and every width against the least: the paired bootstrap, Student's t
    and its p after Holm's correction over the table."""
    budgets, widths = answer.point.budgets, answer.point.widths
    steps = {
        f"n = {a} → {b}, w = {widths[0]:g}": ((b, widths[0]), (a, widths[0]))
        for a, b in [*itertools.pairwise(budgets), (budgets[0], budgets[-1])]
        if a != b
    }
    wider = {f"w = {widths[0]:g} → {w:g}, n = {n}": ((n, w), (n, widths[0])) for n in budgets for w in widths[1:]}
    pairs = {**steps, **wider}
    found = {label: paired_t(answer.returns(a), answer.returns(b)) for label, (a, b) in pairs.items()}
    adjusted = holm({label: t.p for label, t in found.items()})
    return [(label, answer.contrast(*pairs[label]), t, adjusted[label]) for label, t in found.items()]
