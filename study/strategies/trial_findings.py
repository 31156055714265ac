"""What the cases of an experiment came to: returns over seeds, and the contrasts that were fixed beforehand; and how
that is told, in tables and what every page of such an experiment needs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from study.pipeline.database import Database
from study.pipeline.publication import Account, AnswerSection, Drawing, Table
from study.pipeline.settings import all_versions
from study.pipeline.tables import printed
from study.statistics import Contrast, holm, paired_t
from study.strategies.designs import DESIGNS, OPTIMUM, Designed
from study.strategies.finished_cases import IMPORTED
from study.strategies.populations import TRAININGS, Trained
from study.strategies.session import STEPS, CaseRound
from study.strategies.trial_plan import Case, Condition, TrialPlan
from sysid.physics.ops import Array

NEAR = 0.05
"""Within so much of the optimum a strategy has arrived."""


class TrialResults(NamedTuple):
    """What a results folder holds: rounds of the cases, trained agents, and designs."""

    rounds: Sequence[CaseRound]
    trained: Sequence[Trained]
    designs: Sequence[Designed]

    @classmethod
    def of(cls, results: Database) -> TrialResults:
        return cls(results.all(STEPS), results.all(TRAININGS), results.all(DESIGNS))

    @property
    def answers(self) -> dict[Case, dict[str, Any]]:
        """What each finished case gave back."""
        return {step.case: step.payload["answer"] for step in self.rounds if "answer" in step.payload}

    @property
    def designed(self) -> dict[tuple[str, str, int], float]:
        """Mean returns of the designs by plant, model and seed."""
        return {(design.plant, design.model, design.seed): float(np.mean(design.returns)) for design in self.designs}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a condition came to, of each of its seeds (S,).

    returns    of what was deployed, each a mean over the seed's start states; optima: from the same start states
    best       of the candidate that had returned most within the budget, evaluated anew; observed: what it had returned
               there. Both nan for strategies that compare no returns.
    simulated  environment steps of its agents and of its own simulations; rollouts: that it spent
    """

    seeds: tuple[int, ...]
    returns: Array
    optima: Array
    best: Array
    observed: Array
    simulated: Array
    rollouts: Array

    @property
    def mean(self) -> Contrast:
        """The mean with Student's interval over seeds."""
        return paired_t(self.returns)

    @property
    def median(self) -> float:
        """Single failed trainings do not move it."""
        return float(np.median(self.returns))

    @property
    def gap(self) -> float:
        """J(optimum) - J(agent) from the same start states."""
        return float(np.mean(self.optima - self.returns))

    @property
    def anew(self) -> float:
        """Mean return of the best candidates, evaluated anew."""
        return float(np.mean(self.best))

    @property
    def shortfall(self) -> Contrast:
        """By what share of the optimum's mean return the mean falls short of it, with Student's interval: what can be
        held against other seeds and other plants."""
        return paired_t((self.optima - self.returns) / abs(float(np.mean(self.optima))))

    def less(self, other: Outcome) -> Array:
        """The differences (S,) over the seeds that both have."""
        shared = sorted(set(self.seeds) & set(other.seeds))
        one, two = (outcome.returns[[outcome.seeds.index(seed) for seed in shared]] for outcome in (self, other))
        return np.asarray(one - two)


@dataclass(frozen=True)
class PlannedContrast:
    """A pre-registered contrast: J(a) - J(b) at a plant, with n rollouts, over matched seeds.

    median: of the differences; p: Holm's over the whole family
    """

    plant: str
    sensing: str
    n: int
    a: str
    b: str
    contrast: Contrast
    median: float
    p: float

    @property
    def certain(self) -> bool:
        """Whether it stands after Holm."""
        return self.p < 0.05


@dataclass(frozen=True, eq=False)
class TrialFindings:
    """An experiment's answer.

    compared   the pre-registered contrasts, in the plan's order
    agents     how many were trained; seconds: what workers spent, versions: of what trained them
    imported   cases that were taken up from elsewhere, whose agents are not among these
    """

    plan: Any
    outcomes: dict[Condition, Outcome]
    compared: tuple[PlannedContrast, ...]
    agents: int
    seconds: float
    versions: dict[str, str]
    imported: int = field(default=0, kw_only=True)

    def optimum(self, plant: str) -> float:
        """Mean return of the near-optimal policy over the plan's seeds."""
        outcomes = [o for c, o in self.outcomes.items() if c.plant == plant]
        return float(np.mean(max(outcomes, key=lambda o: len(o.seeds)).optima))

    @property
    def several(self) -> bool:
        """Whether there are several budgets, so that strategies have lines over them."""
        return len({condition.n for condition in self.outcomes} - {0}) > 1

    def line(self, plant: str, sensing: str, strategy: str) -> dict[int, Outcome]:
        """A strategy's outcomes by budget."""
        return {c.n: o for c, o in self.outcomes.items() if c[:3] == (plant, sensing, strategy)}

    def arrived(self, plant: str, sensing: str, strategy: str) -> int | None:
        """The smallest budget from which on it stays within NEAR of the optimum, among those with the most seeds; None
        where it does not get there."""
        line, budget = self.line(plant, sensing, strategy), None
        most = max((len(outcome.seeds) for outcome in line.values()), default=0)
        for n, outcome in sorted(line.items(), reverse=True):
            if len(outcome.seeds) == most:
                if outcome.shortfall.mean > NEAR:
                    break
                budget = n
        return budget

    def contrast(self, plant: str, n: int, a: str) -> PlannedContrast | None:
        """That of a strategy against its counterpart; None where none was planned."""
        return next((c for c in self.compared if (c.plant, c.n, c.a) == (plant, n, a)), None)


def trial_findings(plan: TrialPlan, results: TrialResults) -> TrialFindings:
    """The answer from the results of a finished experiment."""
    answers, agents = results.answers, {agent.key: agent for agent in results.trained}
    optima = {(plant, seed): mean for (plant, model, seed), mean in results.designed.items() if model == OPTIMUM}

    def worth(key: str | None, plant: str) -> float:
        return float("nan") if key is None else float(np.mean(agents[key].returns[plant]))

    outcomes = {}
    for condition, cases in cases_of(plan).items():
        given = [answers[case] for case in cases]
        outcomes[condition] = Outcome(
            seeds=tuple(case.seed for case in cases),
            returns=np.array([worth(a["deployed"], condition.plant) for a in given]),
            optima=np.array([optima[condition.plant, case.seed] for case in cases]),
            best=np.array([worth(a["best"], condition.plant) for a in given]),
            observed=np.array([np.nan if a["observed"] is None else a["observed"] for a in given]),
            simulated=np.array([float(a["simulated"]) for a in given]),
            rollouts=np.array([float(a["rollouts"]) for a in given]),
        )
    seconds = sum(row.seconds for table in results for row in table)
    made_with = all_versions(agent.versions for agent in results.trained)
    imported = sum("imported" in answers[case] for case in plan.cases)
    trained = sum(not key.startswith(IMPORTED) for key in agents)
    compared = planned_contrasts(plan, outcomes)
    return TrialFindings(plan, outcomes, compared, trained, seconds, made_with, imported=imported)


def cases_of(plan: TrialPlan) -> dict[Condition, list[Case]]:
    """The cases of every condition, in the plan's order."""
    cases: dict[Condition, list[Case]] = {}
    for case in plan.cases:
        cases.setdefault(case.condition, []).append(case)
    return cases


def planned_contrasts(plan: TrialPlan, outcomes: Mapping[Condition, Outcome]) -> tuple[PlannedContrast, ...]:
    """The plan's contrasts, as far as there are both strategies; without any rollout they stand once."""
    differences = {}
    for plant, sensing in plan.places:
        for n in plan.contrasted if sensing == plan.sensings[0] else ():
            for a, b in plan.contrasts:
                sides = [plan.condition(plant, sensing, strategy, n) for strategy in (a, b)]
                if all(side in outcomes for side in sides):
                    place = plant.name, sensing, max(side.n for side in sides), a, b
                    differences[place] = outcomes[sides[0]].less(outcomes[sides[1]])
    contrasts = {place: paired_t(d) for place, d in differences.items()}
    adjusted = holm({place: contrast.p for place, contrast in contrasts.items()})
    return tuple(
        PlannedContrast(*place, contrast, float(np.median(differences[place])), adjusted[place])
        for place, contrast in contrasts.items()
    )


CASES = ("plant", "sensing", "strategy", "n", "seed", "mean", "optimum", "best_anew", "observed", "simulated")
"""One case: the mean return of what was deployed, and of its best candidate; steps that were simulated for it."""
OUTCOMES = ("plant", "sensing", "strategy", "n", "seeds", "mean", "low", "high", "median", "gap", "optimum", "rollouts",
            "simulated")  # fmt: skip
"""A condition: returns over seeds with Student's interval and median, and means of the rest."""
CONTRASTED = ("plant", "sensing", "n", "a", "b", "mean", "low", "high", "median", "seeds", "p")
"""A pre-registered contrast a - b; p is Holm's over the family."""
TABLES, FIGURE = ("cases.csv", "outcomes.csv", "contrasts.csv"), "returns.png"


def trial_account(
    findings: TrialFindings,
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
    plan = findings.plan
    return Account(
        plan=plan,
        sections=[AnswerSection(sentences)],
        tables=trial_tables(findings, columns or {}),
        drawings={FIGURE: drawing},
        template=template,
        shown={"findings": findings, "agents": findings.agents, **shown},
        counts={
            "cases": len(plan.cases),
            "agents": findings.agents,
            **({"imported": findings.imported} if findings.imported else {}),
            "contrasts": [" - ".join(pair) for pair in plan.contrasts],
        },
        seconds=findings.seconds,
        versions=findings.versions,
    )


def trial_tables(findings: TrialFindings, columns: Mapping[Condition, Mapping[str, float]]) -> dict[str, Table]:
    """TABLES; columns: further ones of outcomes, by condition."""
    cases = [
        (*condition, seed, *(None if math.isnan(value) else value for value in values))
        for condition, o in findings.outcomes.items()
        for seed, *values in zip(o.seeds, o.returns, o.optima, o.best, o.observed, o.simulated, strict=True)
    ]
    outcomes = [(*condition, *_outcome(outcome), *columns.get(condition, {}).values())
                for condition, outcome in findings.outcomes.items()]  # fmt: skip
    contrasts = [[{**vars(c.contrast), **vars(c)}[name] for name in CONTRASTED] for c in findings.compared]
    heads = CASES, (*OUTCOMES, *next(iter(columns.values()), {})), CONTRASTED
    together = zip(TABLES, heads, (cases, outcomes, contrasts), strict=True)
    return {name: (head, map(printed, rows)) for name, head, rows in together}


def _outcome(outcome: Outcome) -> Iterator[float]:
    mean = outcome.mean
    yield from (mean.seeds, mean.mean, mean.low, mean.high, outcome.median, outcome.gap)
    yield from (float(np.mean(values)) for values in (outcome.optima, outcome.rollouts, outcome.simulated))
