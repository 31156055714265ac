"""The strategies experiment, told: figures and page."""

from __future__ import annotations

from functools import partial

from study.pipeline.publication import Account
from study.strategies.catalogue import strategy_class
from study.strategies.strategies_figures import returns_of_strategies
from study.strategies.strategies_findings import strategies_findings, strategies_sentences
from study.strategies.strategies_plan import StrategiesPlan
from study.strategies.trial_findings import TrialResults
from study.strategies.trial_page import trial_account

CAPTION = (
    "Mean return for the real rollouts that were spent, strategies of a group together, with its 95 % interval where "
    "there are three seeds. Hollow: of strategies that compare returns, their best candidate so far, evaluated anew "
    "outside the budget. Grey: the point estimate and what spends nothing. Red: the optimum. Arrows are outside the "
    "panel."
)


def account(plan: StrategiesPlan, results: TrialResults) -> Account:
    """What is told of the results."""
    found = strategies_findings(plan, results)
    return trial_account(
        found,
        strategies_sentences(found),
        (partial(returns_of_strategies, found), CAPTION),
        "strategies.html.j2",
        {"strategies": {name: strategy_class(name) for name in plan.strategies}},
    )
