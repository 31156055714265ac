"""Publishes the experiment: tables, what made them, and the answers in words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from study.mismatch import naming
from study.mismatch import naming_results as named
from study.mismatch.figures.drawing import draw
from study.mismatch.findings import Answer, answer
from study.mismatch.mismatch_page import page
from study.mismatch.mismatch_results import MismatchResults
from study.mismatch.plan import CONTRASTS, Plan
from study.mismatch.sentences import sentences
from study.pipeline import csv_table as rows
from study.pipeline.record import write_record
from study.pipeline.versions import all_versions
from sysid.data.files import write_whole


@dataclass(frozen=True)
class OutcomeRow:
    """A way at a plant and a budget: returns over seeds, with Student's interval, the gap to the optimum from the
    same start states, and its parts over as many seeds as there are tables for."""

    plant: str
    way: str
    n: int
    seeds: int
    mean: float
    low: float
    high: float
    median: float
    gap: float
    structure: float
    identification: float
    training: float
    tables: int


@dataclass(frozen=True)
class ContrastRow:
    """A pre-registered contrast a - b; p is Holm's over the family."""

    plant: str
    n: int
    a: str
    b: str
    mean: float
    low: float
    high: float
    median: float
    seeds: int
    p: float


@dataclass(frozen=True)
class TrialRow:
    """The mean return of one agent on a hidden plant."""

    plant: str
    way: str
    n: int
    seed: int
    mean: float


def publish_mismatch(plan: Plan, results: MismatchResults, console: Console) -> Answer:
    """Write tables, figures and page into the results' folder and say the answers; returns them.

    The naming study is told too where its table lies in the folder.
    """
    folder, trained, fits = results.folder, results.trainings(), results.fits()
    rows_named = named.read(folder / named.TABLE)
    with console.status("drawing"):
        found = answer(plan, fits, trained, results.designs())
        said = sentences(found, rows_named)
        made_with = [agent.versions for agent in trained]
        write_tables(found, folder)
        about = {"trials": len(plan.trials), "agents": len(trained), "contrasts": [f"{a} - {b}" for a, b in CONTRASTS]}
        write_record(folder / "study.json", plan, results.device, about, found.hours, made_with)
        figures = draw(found, fits, folder)
        if rows_named:
            figures["naming"] = naming.draw(rows_named, folder)
        write_whole(folder / "report.html", page(found, said, figures, all_versions(made_with), rows_named))
    for question, text in said:
        console.print(f"[bold]{question}[/]\n{escape(text)}\n")
    console.print(f"report   {folder / 'report.html'}", soft_wrap=True)
    console.print(f"figures  {', '.join(map(str, figures.values()))}", soft_wrap=True)
    return found


def write_tables(found: Answer, folder: Path) -> None:
    """trials.csv, outcomes.csv, contrasts.csv."""
    trials, outcomes = [], []
    for spot, own in found.outcomes.items():
        trials += [TrialRow(*spot, seed, float(mean)) for seed, mean in zip(own.seeds, own.returns, strict=True)]
        mean, split = own.mean, own.split
        parts = (split.structure, split.identification, split.training) if split else (float("nan"),) * 3
        stands = split.seeds if split else 0
        outcomes.append(
            OutcomeRow(*spot, len(own.seeds), mean.mean, mean.low, mean.high, own.median, own.gap, *parts, stands)
        )
    contrasts = [
        ContrastRow(
            c.plant, c.n, c.a, c.b, c.contrast.mean, c.contrast.low, c.contrast.high, c.median, c.contrast.seeds, c.p
        )
        for c in found.compared
    ]
    rows.write(TrialRow, folder / "trials.csv", trials)
    rows.write(OutcomeRow, folder / "outcomes.csv", outcomes)
    rows.write(ContrastRow, folder / "contrasts.csv", contrasts)
