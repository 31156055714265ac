"""An experiment of strategies, told: its tables, and what every page of such an experiment needs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from study.pipeline.publication import Account, Drawing, Section, Table
from study.pipeline.tables import printed
from study.strategies.trial_findings import Outcome, TrialFindings
from study.strategies.trial_plan import Condition

CASES = ("plant", "sensing", "strategy", "n", "seed", "return", "optimum", "best_anew", "observed", "simulated")
"""One case: the mean return of what was deployed, and of its best candidate; steps that were simulated for it."""
OUTCOMES = ("plant", "sensing", "strategy", "n", "seeds", "mean", "low", "high", "median", "gap", "optimum", "rollouts",
            "simulated")  # fmt: skip
"""A condition: returns over seeds with Student's interval and median, and means of the rest."""
CONTRASTED = ("plant", "sensing", "n", "a", "b", "mean", "low", "high", "median", "seeds", "p")
"""A pre-registered contrast a - b; p is Holm's over the family."""
TABLES, FIGURE = ("cases.csv", "outcomes.csv", "contrasts.csv"), "returns.png"


def trial_account(
    found: TrialFindings,
    sentences: Sequence[tuple[str, str]],
    drawing: Drawing,
    template: str,
    shown: Mapping[str, Any],
    columns: Mapping[Condition, Mapping[str, float]] | None = None,
) -> Account:
    """What is told of the findings.

    sentences  pairs of question and answer
    drawing    what draws the figure, and what stands below it
    shown      what the template shows besides the findings
    columns    further ones of the table of outcomes, by condition
    """
    plan = found.plan
    return Account(
        plan=plan,
        sections=[Section(sentences)],
        tables=trial_tables(found, columns or {}),
        drawings={FIGURE: drawing},
        template=template,
        shown={"findings": found, "agents": found.agents, **shown},
        counts={
            "cases": len(plan.cases),
            "agents": found.agents,
            "contrasts": [" - ".join(pair) for pair in plan.contrasts],
        },
        seconds=found.seconds,
        versions=found.versions,
    )


def trial_tables(found: TrialFindings, columns: Mapping[Condition, Mapping[str, float]]) -> dict[str, Table]:
    """TABLES; columns: further ones of outcomes, by condition."""
    cases = [
        (*condition, seed, *(None if math.isnan(value) else value for value in values))
        for condition, own in found.outcomes.items()
        for seed, *values in zip(own.seeds, own.returns, own.optima, own.best, own.observed, own.simulated, strict=True)
    ]
    outcomes = [(*condition, *_outcome(own), *columns.get(condition, {}).values())
                for condition, own in found.outcomes.items()]  # fmt: skip
    contrasts = [[{**vars(c.contrast), **vars(c)}[name] for name in CONTRASTED] for c in found.compared]
    heads = CASES, (*OUTCOMES, *next(iter(columns.values()), {})), CONTRASTED
    together = zip(TABLES, heads, (cases, outcomes, contrasts), strict=True)
    return {name: (head, map(printed, rows)) for name, head, rows in together}


def _outcome(own: Outcome) -> Iterator[float]:
    mean = own.mean
    yield from (mean.seeds, mean.mean, mean.low, mean.high, own.median, own.gap)
    yield from (float(np.mean(values)) for values in (own.optima, own.rollouts, own.simulated))
