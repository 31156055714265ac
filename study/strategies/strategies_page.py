"""Publishes the strategies experiment: tables, figure, and one HTML page that opens without a network."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console

from study.figure_style import save_figure
from study.pipeline.database import Database
from study.pipeline.html_page import say, say_files, template
from study.pipeline.tables import printed, write_rows
from study.pipeline.versions import all_versions, write_record
from study.strategies.catalogue import strategy_class
from study.strategies.rounds import STEPS
from study.strategies.strategies_figures import returns_of_strategies, simulated_steps
from study.strategies.strategies_findings import StrategiesFindings, strategies_findings
from study.strategies.strategies_plan import StrategiesPlan
from study.strategies.strategies_sentences import strategies_sentences
from study.trials.designs import DESIGNS
from study.trials.populations import TRAININGS
from sysid.data.files import write_whole

CASES = ("plant", "sensing", "strategy", "n", "seed", "return", "optimum", "best_anew", "observed", "simulated")
"""One case: the mean return of what was deployed, and of its best candidate; steps that were simulated for it."""
OUTCOMES = ("plant", "sensing", "strategy", "n", "seeds", "mean", "low", "high", "optimum", "rollouts", "simulated")
"""A condition: returns over seeds with Student's interval, and means of the rest."""
CONTRASTED = ("plant", "sensing", "n", "a", "b", "mean", "low", "high", "seeds", "p")
"""A pre-registered contrast a - b; p is Holm's over the family."""

FIGURES = {
    "returns": (returns_of_strategies, "Mean return for the real rollouts that were spent, strategies of a group "
        "together, with its 95 % interval where there are three seeds. Hollow: of strategies that compare returns, "
        "their best candidate so far, evaluated anew outside the budget. Grey: the point estimate and what spends "
        "nothing. Red: the optimum. Arrows are outside the panel."),
    "simulated": (simulated_steps, "The same means over the steps that were simulated for them, trainings on the way "
        "included, at the largest budget of the contrasts."),
}  # fmt: skip
"""Of the page, by name: what draws it, and what stands below."""


def publish_strategies(plan: StrategiesPlan, results: Database, console: Console) -> None:
    """Write tables, figure and page into the results' folder and say the answers."""
    folder, trained = results.folder, results.all(TRAININGS)
    with console.status("drawing"):
        found = strategies_findings(plan, results.all(STEPS), trained, results.all(DESIGNS))
        said, made_with = strategies_sentences(found), [agent.versions for agent in trained]
        write_strategies_tables(found, folder)
        about = {"cases": len(plan.cases), "agents": len(trained), "contrasts": [" - ".join(c) for c in plan.contrasts]}
        write_record(folder / "study.json", plan, results.device, about, found.hours, made_with)
        figures = {
            name: save_figure(partial(draw, found), folder / f"{name}.png") for name, (draw, _) in FIGURES.items()
        }
        page = template("strategies.html.j2").render(
            findings=found, plan=plan, sentences=said, agents=len(trained),
            figures={path: FIGURES[name][1] for name, path in figures.items()},
            strategies={name: strategy_class(name) for name in plan.strategies}, versions=all_versions(made_with),
        )  # fmt: skip
        write_whole(folder / "report.html", page)
    say(console, said)
    say_files(console, folder, figures.values())


def write_strategies_tables(found: StrategiesFindings, folder: Path) -> None:
    """cases.csv, outcomes.csv, contrasts.csv."""
    cases, outcomes = [], []
    for condition, own in found.outcomes.items():
        columns = (own.returns, own.optima, own.best, own.observed, own.simulated)
        for seed, *values in zip(own.seeds, *(column.tolist() for column in columns), strict=True):
            cases.append((*condition, seed, *(None if np.isnan(value) else value for value in values)))
        mean, rest = own.mean, (own.optima, own.rollouts, own.simulated)
        outcomes.append((*condition, mean.seeds, mean.mean, mean.low, mean.high, *(float(np.mean(r)) for r in rest)))
    contrasts = [
        (c.plant, c.sensing, c.n, c.a, c.b, c.contrast.mean, c.contrast.low, c.contrast.high, c.contrast.seeds, c.p)
        for c in found.compared
    ]
    for name, columns, rows in (
        ("cases", CASES, cases), ("outcomes", OUTCOMES, outcomes), ("contrasts", CONTRASTED, contrasts)
    ):  # fmt: skip
        write_rows(folder / f"{name}.csv", columns, map(printed, rows))
