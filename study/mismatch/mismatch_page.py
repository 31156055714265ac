"""The mismatch experiment, told: figures and page."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from study.mismatch.mismatch_figures import strategy_returns
from study.mismatch.mismatch_findings import MismatchFindings, mismatch_findings
from study.mismatch.mismatch_plan import STRATEGIES, MismatchPlan
from study.mismatch.mismatch_sentences import mismatch_sentences
from study.mismatch.trajectories import telling_trajectories
from study.pipeline.publication import Account
from study.strategies.trial_findings import TrialResults
from study.strategies.trial_page import TABLES, trial_account

PARTS = ("structure", "identification", "training", "tables")
"""Of the gap to the optimum, over as many seeds as there are tables for."""

CAPTIONS = {
    "returns": "Every strategy at every hidden plant: mean return with its 95 % interval over seeds, hollow for few "
    "rollouts, filled for many. All panels have one scale, each about its own optimum; a number at the left edge is a "
    "mean left of the panel.",
    "trajectories": "Where mending gained most, the two agents of the seed whose gain is nearest to the median, from "
    "the same start states. Torques: of the first in full, of the others faint.",
}
"""What stands below a figure, by its name and in the page's order."""


OUTPUTS = (*TABLES, "returns.png", "trajectories.png")


def account(plan: MismatchPlan, results: TrialResults, folder: Path) -> Account:
    """What is told of the results."""
    found = mismatch_findings(plan, results)
    return mismatch_account(found, telling_trajectories(found, results.answers, folder))


def mismatch_account(found: MismatchFindings, motions: Callable[[], Figure] | None = None) -> Account:
    """What is told of the findings; motions: draws the trajectories of two agents."""
    nothing = dict(zip(PARTS, (math.nan, math.nan, math.nan, 0), strict=True))
    drawings = {"returns": partial(strategy_returns, found), "trajectories": motions}
    return trial_account(
        found,
        mismatch_sentences(found),
        {name: (draw, CAPTIONS[name]) for name, draw in drawings.items()},
        "mismatch.html.j2",
        {"strategies": STRATEGIES},
        {condition: vars(split) if split else nothing for condition, split in found.splits.items()},
    )
