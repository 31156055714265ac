"""What the experiment found: returns of every strategy at every plant and budget, contrasts, and parts of a gap."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from study.mismatch.mismatch_plan import STRATEGIES, MismatchPlan
from study.mismatch.naming import names
from study.statistics import Contrast, paired_t
from study.strategies.designs import OPTIMUM, PLAIN_ROD
from study.strategies.trial_findings import PlannedContrast, TrialFindings, TrialResults, cases_of, trial_findings
from study.strategies.trial_plan import Case, Condition
from study.trials.hidden_plant import HiddenPlant
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
    """The answer from the results of a finished experiment."""
    findings, answers, designed = trial_findings(plan, results), results.answers, results.designed
    payloads = {step.case: step.payload["setups"][answers[step.case]["deployed"]] for step in results.rounds}
    setups = {case: training_setup_of(payload) for case, payload in payloads.items()}
    splits = {
        condition: _split(plan.plant(condition.plant), cases, findings.outcomes[condition].returns, setups, designed)
        for condition, cases in cases_of(plan).items()
    }
    verdicts: dict[tuple[str, int], Counter[Verdict]] = {}
    for case, said in payloads.items():
        if case.strategy == "mended":
            verdict = Verdict(said["verdict"], tuple(said["steps"]), said["believed"])
            verdicts.setdefault((case.plant, case.n), Counter())[verdict] += 1
    return MismatchFindings(**vars(findings), splits=splits, verdicts=verdicts)


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
