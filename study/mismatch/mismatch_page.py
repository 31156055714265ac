"""The mismatch experiment, told: figure and page."""

from __future__ import annotations

import math
from functools import partial

from study.mismatch.mismatch_findings import MismatchFindings, mismatch_findings, mismatch_sentences
from study.mismatch.mismatch_plan import STRATEGIES, MismatchPlan
from study.pipeline.publication import Account
from study.strategies.trial_figures import returns_in_rows
from study.strategies.trial_findings import TrialResults, trial_account

INKS = {"nothing": "0.45", "plain": "#0072B2", "mended": "#D55E00", "oracle": "0.1"}
"""Of the groups of strategies (Okabe and Ito)."""

PARTS = ("structure", "identification", "training", "tables")
"""Of the gap to the optimum, over as many seeds as there are tables for."""

CAPTION = (
    "Every strategy at every hidden plant: mean return with its 95 % interval over seeds, hollow for few rollouts, "
    "filled for many. All panels have one scale, each about its own optimum; a number at the left edge is a mean left "
    "of the panel."
)


def account(plan: MismatchPlan, results: TrialResults) -> Account:
    """What is told of the results."""
    return mismatch_account(mismatch_findings(plan, results))


def mismatch_account(found: MismatchFindings) -> Account:
    """What is told of the findings."""
    nothing = dict(zip(PARTS, (math.nan, math.nan, math.nan, 0), strict=True))
    return trial_account(
        found,
        mismatch_sentences(found),
        (partial(returns_in_rows, found, STRATEGIES.__getitem__, INKS), CAPTION),
        "mismatch.html.j2",
        {"strategies": STRATEGIES},
        {condition: vars(split) if split else nothing for condition, split in found.splits.items()},
    )
