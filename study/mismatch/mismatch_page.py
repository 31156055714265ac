"""The mismatch experiment, told: answers in words, which decide nothing, figure and page. Single contrasts stand in the
table.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

from study.formatting import percent
from study.mismatch.mismatch_findings import MismatchFindings, mismatch_findings
from study.mismatch.mismatch_plan import STRATEGIES, MismatchPlan
from study.pipeline.publication import Account
from study.strategies.trial_figures import returns_in_rows
from study.strategies.trial_findings import TrialResults, trial_account
from study.trials.rollout_budget import BAND
from sysid.report.figure_style import BLUE, ORANGE


@dataclass(frozen=True)
class Change:
    """What is told of the contrasts of strategy a with b.

    text        with {counted}: how many stand, and their mean; {verdict}: whether they are better
    catalogue   at which plants: whether the catalogue has their effect; None: those without one
    """

    a: str
    b: str
    text: str
    catalogue: tuple[bool | None, ...] = (True, False, None)

    def answer(self, findings: MismatchFindings) -> str:
        """The text; empty where the plan has no such contrasts."""
        plants = {plant.name for plant in findings.plan.plants if plant.in_catalogue in self.catalogue}
        rows = [row for row in findings.compared if (row.a, row.b) == (self.a, self.b) and row.plant in plants]
        if not rows:
            return ""
        better, worse = (sum(row.certain and sign * row.contrast.mean > 0.0 for row in rows) for sign in (1, -1))
        counted = f"{better} of {len(rows)} are better and {worse} worse after Holm's correction"
        if len(rows) > 1:
            counted += f", in the mean {findings.together(rows)} (not pre-registered)"
        else:
            counted += f" ({rows[0].contrast})"
        verdict = "No" if better == 0 else "Yes" if better == len(rows) else "In part"
        return self.text.format(counted=counted, verdict=verdict, band=percent(BAND))


BREADTH = Change(
    "band", "fitted", "{verdict}: with a band of ±{band} around the fitted m and l {counted}.", (True, False)
)
NAMING = Change("mended", "fitted", "Against m and l alone: {counted}.", (True,))
UNKNOWN = Change(
    "mended",
    "fitted",
    "Where the catalogue lacks the effect, a diagnosis that says so trains under random torques of the size that the "
    "log asks for. Against m and l alone: {counted}.",
    (False,),
)
OTHER_USES = (
    Change("mended", "all_effects", "against all effects fitted at once: {counted}"),
    Change("mended", "network", "against a learned residual torque: {counted}"),
)
WITHOUT_ROLLOUTS = Change("breadth", "prior", "Breadth over everything plausible, against the prior: {counted}.")
ORACLE = (
    Change("oracle", "mended", "where the catalogue has the effect, {counted}", (True,)),
    Change("oracle", "mended", "where it lacks it, {counted}", (False,)),
)


def mismatch_sentences(findings: MismatchFindings) -> list[tuple[str, str]]:
    """(question, answer), as far as the plan asked for it."""
    other_uses, oracle = (
        "; ".join(filter(None, (change.answer(findings) for change in group))) for group in (OTHER_USES, ORACLE)
    )
    asked = {
        "Does breadth pay when the simulator lacks an effect?": BREADTH.answer(findings),
        "What is it worth to name the effect?": NAMING.answer(findings),
        "What does an honest “unknown” buy?": UNKNOWN.answer(findings),
        "What else could the rollouts be spent on?": other_uses and f"The diagnosis {other_uses}.",
        "And without any rollout?": WITHOUT_ROLLOUTS.answer(findings),
        "What is left?": oracle and f"Trained on the hidden plant itself, against the diagnosis: {oracle}.",
    }
    return [(question, text) for question, text in asked.items() if text]


MISMATCH_COLOURS = {"nothing": "0.45", "plain": BLUE, "mended": ORANGE, "oracle": "0.1"}
"""Of the groups of strategies (Okabe and Ito)."""

CAPTION = (
    "Every strategy at every hidden plant: mean return with its 95 % interval over seeds, hollow for few rollouts, "
    "filled for many. All panels have one scale, each about its own optimum; a number at the left edge is a mean left "
    "of the panel."
)


def account(plan: MismatchPlan, results: TrialResults) -> Account:
    """What is told of the results."""
    return mismatch_account(mismatch_findings(plan, results))


def mismatch_account(findings: MismatchFindings) -> Account:
    """What is told of the findings."""
    nothing = {"structure": math.nan, "identification": math.nan, "training": math.nan, "tables": 0}
    return trial_account(
        findings,
        mismatch_sentences(findings),
        (partial(returns_in_rows, findings, STRATEGIES.__getitem__, MISMATCH_COLOURS), CAPTION),
        "mismatch.html.j2",
        {"strategies": STRATEGIES},
        {condition: vars(split) if split else nothing for condition, split in findings.splits.items()},
    )
