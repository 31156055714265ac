"""The strategies experiment, told: figures and page."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from study.pipeline.publication import Account
from study.strategies.catalogue import strategy_class
from study.strategies.strategies_figures import returns_of_strategies, simulated_steps
from study.strategies.strategies_findings import strategies_findings, strategies_sentences
from study.strategies.strategies_plan import StrategiesPlan
from study.strategies.trial_findings import TrialResults
from study.strategies.trial_page import TABLES, trial_account

CAPTIONS = {
    "returns": "Mean return for the real rollouts that were spent, strategies of a group together, with its 95 % "
    "interval where there are three seeds. Hollow: of strategies that compare returns, their best candidate so far, "
    "evaluated anew outside the budget. Grey: the point estimate and what spends nothing. Red: the optimum. Arrows are "
    "outside the panel.",
    "simulated": "The same means over the steps that were simulated for them, trainings on the way included, at the "
    "largest budget of the contrasts.",
}
OUTPUTS = (*TABLES, "returns.png", "simulated.png")


def account(plan: StrategiesPlan, results: TrialResults, folder: Path) -> Account:
    """What is told of the results."""
    found = strategies_findings(plan, results)
    return trial_account(
        found,
        strategies_sentences(found),
        {
            "returns": (partial(returns_of_strategies, found), CAPTIONS["returns"]),
            "simulated": (partial(simulated_steps, found), CAPTIONS["simulated"]),
        },
        "strategies.html.j2",
        {"strategies": {name: strategy_class(name) for name in plan.strategies}},
    )
