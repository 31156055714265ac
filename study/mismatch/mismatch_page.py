"""Publishes the experiment: tables, what made them, and one HTML page that opens without a network, answers first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console

from study.figure_style import save_figure
from study.mismatch.mismatch_figures import ladder_of_strategies, strategy_returns
from study.mismatch.mismatch_findings import MismatchFindings, mismatch_findings
from study.mismatch.mismatch_plan import CONTRASTS, STRATEGIES, Plan
from study.mismatch.mismatch_sentences import mismatch_sentences
from study.mismatch.naming_figure import naming_rates_and_errors
from study.mismatch.naming_results import NAMING_TABLE, NamingResult, naming_table, read_naming
from study.mismatch.trajectories import telling_trajectories
from study.mismatch.trial_setups import FITS
from study.pipeline.database import Database
from study.pipeline.html_page import say, say_files, template
from study.pipeline.tables import printed, write_rows
from study.pipeline.versions import all_versions, write_record
from study.trials.designs import DESIGNS
from study.trials.populations import TRAININGS
from sysid.data.files import write_whole

TRIALS = ("plant", "strategy", "n", "seed", "mean")
"""The mean return of one agent on a hidden plant."""
OUTCOMES = (
    "plant", "strategy", "n", "seeds", "mean", "low", "high", "median", "gap", "structure", "identification",
    "training", "tables",
)  # fmt: skip
"""A strategy at a plant and a budget: returns over seeds, with Student's interval, the gap to the optimum from the same
start states, and its parts over as many seeds as there are tables for."""
CONTRASTED = ("plant", "n", "a", "b", "mean", "low", "high", "median", "seeds", "p")
"""A pre-registered contrast a - b; p is Holm's over the family."""

CAPTIONS = {
    "returns": "Every strategy at every hidden plant: mean return with its 95 % interval over seeds, hollow for few "
    "rollouts, filled for many. All panels have one scale, each about its own optimum; a number at the left edge is a "
    "mean left of the panel.",
    "ladder": "Left: from knowing nothing to knowing everything, at the largest budget. Right: what the gap to the "
    "optimum consists of, with a model that lacks the effect and with the mended one.",
    "trajectories": "Where mending gained most, the two agents of the seed whose gain is nearest to the median, from "
    "the same start states. Torques: of the first in full, of the others faint.",
    "naming": "Above: how often the diagnosis is right, with Wilson's 95 % band: the effect named and no other, or its "
    "class where the log cannot tell; \u201cunknown\u201d or \u201cpartly\u201d where the catalogue lacks it. "
    "Below: the error of m and l in the model without the effect (squares) and in the mended one (dots).",
}
"""What stands below a figure, by its name and in the page's order."""


def publish_mismatch(plan: Plan, results: Database, console: Console) -> None:
    """Write tables, figures and page into the results' folder and say the answers.

    The naming study is told too where its table lies in the folder.
    """
    folder, trained, fits = results.folder, results.all(TRAININGS), results.all(FITS)
    naming_rows = read_naming(folder / NAMING_TABLE)
    with console.status("drawing"):
        found = mismatch_findings(plan, fits, trained, results.all(DESIGNS))
        said = mismatch_sentences(found, naming_rows)
        made_with = [agent.versions for agent in trained]
        write_mismatch_tables(found, folder)
        about = {"trials": len(plan.trials), "agents": len(trained), "contrasts": [f"{a} - {b}" for a, b in CONTRASTS]}
        write_record(folder / "study.json", plan, results.device, about, found.hours, made_with)
        drawings = {
            "returns": lambda: strategy_returns(found),
            "ladder": lambda: ladder_of_strategies(found),
            "trajectories": telling_trajectories(found, fits, folder),
            "naming": (lambda: naming_rates_and_errors(naming_rows)) if naming_rows else None,
        }
        figures = {name: save_figure(draw, folder / f"{name}.png") for name, draw in drawings.items() if draw}
        write_whole(folder / "report.html", mismatch_page(found, said, figures, all_versions(made_with), naming_rows))
    say(console, said)
    say_files(console, folder, figures.values())


def write_mismatch_tables(found: MismatchFindings, folder: Path) -> None:
    """trials.csv, outcomes.csv, contrasts.csv."""
    trials, outcomes = [], []
    for condition, own in found.outcomes.items():
        trials += [(*condition, seed, mean) for seed, mean in zip(own.seeds, own.returns.tolist(), strict=True)]
        mean, split = own.mean, own.split
        parts = (math.nan, math.nan, math.nan, 0)
        if split:
            parts = split.structure, split.identification, split.training, split.seeds
        outcomes.append((*condition, len(own.seeds), mean.mean, mean.low, mean.high, own.median, own.gap, *parts))
    contrasts = [
        (c.plant, c.n, c.a, c.b, c.contrast.mean, c.contrast.low, c.contrast.high, c.median, c.contrast.seeds, c.p)
        for c in found.compared
    ]
    for name, columns, rows in (
        ("trials", TRIALS, trials), ("outcomes", OUTCOMES, outcomes), ("contrasts", CONTRASTED, contrasts)
    ):  # fmt: skip
        write_rows(folder / f"{name}.csv", columns, map(printed, rows))


def mismatch_page(
    findings: MismatchFindings,
    sentences: Sequence[tuple[str, str]],
    figures: Mapping[str, Path],
    versions: Mapping[str, str],
    rows: Sequence[NamingResult] = (),
) -> str:
    """The finished page; figures: PNG files by their names in CAPTIONS; rows: of the naming study, if it is there."""
    return template("mismatch.html.j2").render(
        findings=findings,
        plan=findings.plan,
        sentences=sentences,
        figures=figures,
        captions=CAPTIONS,
        strategies=STRATEGIES,
        named=naming_table(rows) if rows else None,
        versions=versions,
    )
