"""What the experiment found: returns of every strategy at every plant and budget, contrasts, and parts of a gap; and
the answers in words, which decide nothing. Single contrasts stand in the table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from study.formatting import percent
from study.mismatch.mismatch_plan import STRATEGIES, MismatchPlan
from study.mismatch.naming import names
from study.statistics import Contrast, paired_t
from study.strategies.designs import OPTIMUM, PLAIN_ROD
from study.strategies.trial_findings import PlannedContrast, TrialFindings, TrialResults, cases_of, trial_findings
from study.strategies.trial_plan import Case, Condition
from study.trials.hidden_plant import HiddenPlant
from study.trials.rollout_budget import BAND
from study.trials.training_setup import TrainingSetup, training_setup_of
from sysid.physics.ops import Array


class Verdict(NamedTuple):
    """What a diagnosis said: the verdict, the effects that it added, and whether they were believed."""

    verdict: str
    named: tuple[str, ...] = ()
    believed: bool = True

    def __str__(self) -> str:
        text = self.verdict + (f": {' + '.join(self.named)}" if self.named else "")
        return text if self.believed or not self.named else f"{text}, not believed"


@dataclass(frozen=True)
class Split:
    """Where the gap to the optimum comes from, in return: means over the seeds for whose models a table stands. The
    three parts add up to the gap of these seeds."""

    structure: float
    identification: float
    training: float
    tables: int


@dataclass(frozen=True, eq=False)
class MismatchFindings(TrialFindings):
    """The experiment's answer.

    splits     parts of the gap by condition; None where no table stands for what was trained on
    verdicts   of the diagnoses by (plant, n): how often each
    """

    plan: MismatchPlan
    splits: dict[Condition, Split | None]
    verdicts: dict[tuple[str, int], Counter[Verdict]]

    def condition(self, plant: str, strategy: str, n: int) -> Condition:
        """With n rollouts where the strategy spends any."""
        return self.plan.condition(self.plan.plant(plant), "encoder", strategy, n)

    def together(self, rows: Sequence[PlannedContrast]) -> Contrast:
        """The mean of some of the plan's contrasts: paired over seeds, each seed's differences averaged first. It was
        not pre-registered."""
        sides = (
            [self.outcomes[self.condition(row.plant, strategy, row.n)].returns for row in rows]
            for strategy in (rows[0].a, rows[0].b)
        )
        return paired_t(*(np.mean(side, axis=0) for side in sides))


def mismatch_findings(plan: MismatchPlan, results: TrialResults) -> MismatchFindings:
    """The answer from the results; raises InvalidInput where some are missing."""
    found, answers, designed = trial_findings(plan, results), results.answers, results.designed
    payloads = {own.case: own.payload["setups"][answers[own.case]["deployed"]] for own in results.rounds}
    setups = {case: training_setup_of(payload) for case, payload in payloads.items()}
    splits = {
        condition: _split(plan.plant(condition.plant), cases, found.outcomes[condition].returns, setups, designed)
        for condition, cases in cases_of(plan).items()
    }
    verdicts: dict[tuple[str, int], Counter[Verdict]] = {}
    for case, said in payloads.items():
        if case.strategy == "mended":
            verdict = Verdict(said["verdict"], tuple(said["steps"]), said["about"].get("believed", True))
            verdicts.setdefault((case.plant, case.n), Counter())[verdict] += 1
    return MismatchFindings(**vars(found), splits=splits, verdicts=verdicts)


def _split(
    plant: HiddenPlant,
    cases: Sequence[Case],
    returns: Array,
    setups: Mapping[Case, TrainingSetup],
    designed: Mapping[tuple[str, str, int], float],
) -> Split | None:
    """The mean parts over the seeds for whose models a table stands; None where none does."""
    strategy = cases[0].strategy
    rows = []
    for case, reached in zip(cases, returns, strict=True):
        seed, optimum = case.seed, designed[plant.name, OPTIMUM, case.seed]
        if strategy == "oracle":
            rows.append((0.0, 0.0, optimum - reached))
            continue
        if not STRATEGIES[strategy].center:
            return None
        setup = setups[case._replace(strategy=STRATEGIES[strategy].center)]
        fitted = designed.get((plant.name, setup.model_key, seed))
        if fitted is None:
            continue
        lacks = plant.effect is not None and not names(plant, [e.name for e in setup.model.effects])
        allowed = designed[plant.name, PLAIN_ROD, seed] if lacks else optimum
        rows.append((optimum - allowed, allowed - fitted, fitted - reached))
    return Split(*np.mean(rows, axis=0).tolist(), len(rows)) if rows else None


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

    def told(self, findings: MismatchFindings) -> str:
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
RIVALS = (
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
    rivals, oracle = ("; ".join(filter(None, (own.told(findings) for own in group))) for group in (RIVALS, ORACLE))
    asked = {
        "Does breadth pay when the simulator lacks an effect?": BREADTH.told(findings),
        "What is it worth to name the effect?": NAMING.told(findings),
        "What does an honest “unknown” buy?": UNKNOWN.told(findings),
        "What else could the rollouts be spent on?": rivals and f"The diagnosis {rivals}.",
        "And without any rollout?": WITHOUT_ROLLOUTS.told(findings),
        "What is left?": oracle and f"Trained on the hidden plant itself, against the diagnosis: {oracle}.",
    }
    return [(question, text) for question, text in asked.items() if text]
