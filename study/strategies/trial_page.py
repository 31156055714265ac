"""Publishes an experiment of strategies: tables, figures, and one HTML page that opens without a network."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from study.figure_style import save_figure
from study.pipeline.database import Database
from study.pipeline.html_page import say, say_files, template
from study.pipeline.tables import printed, write_rows
from study.pipeline.versions import all_versions, write_record
from study.strategies.trial_findings import TrialFindings, TrialResults
from study.strategies.trial_plan import Condition, TrialPlan
from sysid.data.files import write_whole

CASES = ("plant", "sensing", "strategy", "n", "seed", "return", "optimum", "best_anew", "observed", "simulated")
"""One case: the mean return of what was deployed, and of its best candidate; steps that were simulated for it."""
OUTCOMES = ("plant", "sensing", "strategy", "n", "seeds", "mean", "low", "high", "median", "gap", "optimum", "rollouts",
            "simulated")  # fmt: skip
"""A condition: returns over seeds with Student's interval and median, and means of the rest."""
CONTRASTED = ("plant", "sensing", "n", "a", "b", "mean", "low", "high", "median", "seeds", "p")
"""A pre-registered contrast a - b; p is Holm's over the family."""
TABLES = ("cases.csv", "outcomes.csv", "contrasts.csv")


@dataclass(frozen=True)
class Account:
    """What is told of an experiment.

    sentences  pairs of question and answer
    drawings   what draws a figure, None where there is none to be drawn, and what stands below it, by name
    template   of the page; about: what it shows besides
    columns    further ones of the table of outcomes, by condition
    """

    found: TrialFindings
    sentences: Sequence[tuple[str, str]]
    drawings: Mapping[str, tuple[Callable[[], Figure] | None, str]]
    template: str
    about: Mapping[str, Any]
    columns: Mapping[Condition, Mapping[str, float]] = field(default_factory=dict)

    def page(self, figures: Mapping[Path, str], agents: int, versions: Mapping[str, str]) -> str:
        """The finished page; figures: what stands below each PNG file."""
        given = {"findings": self.found, "plan": self.found.plan, "sentences": self.sentences, "figures": figures}
        return template(self.template).render(**given, agents=agents, versions=versions, **self.about)


def publish_trials(plan: TrialPlan, results: Database, console: Console) -> None:
    """Write tables, figures and page into the results' folder and say the answers."""
    folder, found = results.folder, TrialResults.of(results)
    with console.status("drawing"):
        told: Account = importlib.import_module(plan.page).account(plan, found, folder)
        write_trial_tables(told, folder)
        agents, made_with = len(found.trained), [agent.versions for agent in found.trained]
        about = {"cases": len(plan.cases), "agents": agents, "contrasts": [" - ".join(c) for c in plan.contrasts]}
        write_record(folder / "study.json", plan, results.device, about, told.found.hours, made_with)
        figures = {
            save_figure(draw, folder / f"{name}.png"): caption
            for name, (draw, caption) in told.drawings.items()
            if draw is not None
        }
        write_whole(folder / "report.html", told.page(figures, agents, all_versions(made_with)))
    say(console, told.sentences)
    say_files(console, folder, figures)


def write_trial_tables(told: Account, folder: Path) -> None:
    """Write TABLES."""
    found, more = told.found, next(iter(told.columns.values()), {})
    contrasts = [{**vars(own), **vars(own.contrast), "p": own.p} for own in found.compared]
    outcomes = [{**row, **told.columns.get(condition, {})} for condition, row in _outcomes(found)]
    columns = CASES, (*OUTCOMES, *more), CONTRASTED
    for name, head, rows in zip(TABLES, columns, (list(_cases(found)), outcomes, contrasts), strict=True):
        write_rows(folder / name, head, (printed(row[column] for column in head) for row in rows))


def _cases(found: TrialFindings) -> Iterator[dict[str, Any]]:
    for condition, own in found.outcomes.items():
        values = own.returns, own.optima, own.best, own.observed, own.simulated
        for k, seed in enumerate(own.seeds):
            row = (*condition, seed, *(None if np.isnan(column[k]) else float(column[k]) for column in values))
            yield dict(zip(CASES, row, strict=True))


def _outcomes(found: TrialFindings) -> Iterator[tuple[Condition, dict[str, Any]]]:
    for condition, own in found.outcomes.items():
        mean, rest = own.mean, (own.optima, own.rollouts, own.simulated)
        row = (
            *condition,
            mean.seeds,
            mean.mean,
            mean.low,
            mean.high,
            own.median,
            own.gap,
            *(float(np.mean(own)) for own in rest),
        )
        yield condition, dict(zip(OUTCOMES, row, strict=True))
