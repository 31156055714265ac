"""What the strategies came to: returns over rollouts and over simulated steps, contrasts, and what a best candidate was
worth when it was evaluated anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from study.mismatch.experiment import OPTIMUM
from study.mismatch.mismatch_results import Designed, Trained
from study.statistics import Contrast, holm, paired_t, sem, student
from study.strategies.catalogue import strategy_class
from study.strategies.plan import Case, StrategiesPlan
from study.strategies.strategies_results import CaseRound
from sysid import InvalidInput

Array = NDArray[np.float64]

NEAR = 0.05
"""Within so much of the optimum a strategy has arrived."""


class CaseCondition(NamedTuple):
    """A strategy on a plant with a sensing and so many rollouts."""

    plant: str
    sensing: str
    strategy: str
    n: int


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a condition came to, of each of its seeds (S,).

    returns    of what was deployed; optima from the same start states
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
        """The mean return with Student's interval over seeds."""
        return student(float(np.mean(self.returns)), sem(self.returns), len(self.returns))

    @property
    def anew(self) -> float:
        """Mean return of the best candidates, evaluated anew."""
        return float(np.mean(self.best))

    @property
    def near(self) -> bool:
        """Whether the mean is within NEAR of the optimum's."""
        return float(np.mean(self.returns)) >= (1.0 + NEAR) * float(np.mean(self.optima))


@dataclass(frozen=True)
class StrategyContrast:
    """A pre-registered contrast J(a) - J(b) with n rollouts; p: Holm's over the whole family."""

    plant: str
    sensing: str
    n: int
    a: str
    b: str
    contrast: Contrast
    p: float

    @property
    def certain(self) -> bool:
        """Whether it stands after Holm."""
        return self.p < 0.05


@dataclass(frozen=True, eq=False)
class StrategiesFindings:
    """The experiment's answer; hours: what workers spent."""

    plan: StrategiesPlan
    outcomes: dict[CaseCondition, Outcome]
    hours: float

    def line(self, plant: str, sensing: str, strategy: str) -> dict[int, Outcome]:
        """A strategy's outcomes by budget."""
        return {c.n: o for c, o in self.outcomes.items() if c[:3] == (plant, sensing, strategy)}

    def arrived(self, plant: str, sensing: str, strategy: str) -> int | None:
        """The smallest budget from which on it stays within NEAR of the optimum; None where it does not get there."""
        found = None
        for n, outcome in sorted(self.line(plant, sensing, strategy).items(), reverse=True):
            if not outcome.near:
                break
            found = n
        return found

    def optimum(self, plant: str) -> float:
        """Mean return of the near-optimal policy over the plan's seeds."""
        own = [o for c, o in self.outcomes.items() if c.plant == plant]
        return float(np.mean(max(own, key=lambda o: len(o.seeds)).optima))

    def contrast(self, plant: str, n: int, a: str) -> StrategyContrast | None:
        """That of a strategy against its counterpart; None where none was planned."""
        return next((c for c in self.compared if (c.plant, c.n, c.a) == (plant, n, a)), None)

    @cached_property
    def compared(self) -> tuple[StrategyContrast, ...]:
        """The pre-registered contrasts, in the plan's order."""
        found = []
        for plant, sensing in self.plan.places:
            for n in self.plan.contrasted if sensing == self.plan.sensings[0] else ():
                for a, b in self.plan.contrasts:
                    sides = [self.line(plant.name, sensing, own).get(_spent(own, n)) for own in (a, b)]
                    if sides[0] is not None and sides[1] is not None:
                        found.append((plant.name, sensing, n, a, b, _paired(*sides)))  # type: ignore[arg-type]
        adjusted = holm({k: row[-1].p for k, row in enumerate(found)})
        return tuple(StrategyContrast(*row, adjusted[k]) for k, row in enumerate(found))


def _spent(strategy: str, n: int) -> int:
    """Of n rollouts those that it can make use of."""
    return min(n, strategy_class(strategy).most)


def _paired(one: Outcome, other: Outcome) -> Contrast:
    shared = sorted(set(one.seeds) & set(other.seeds))
    return paired_t(*(o.returns[[o.seeds.index(s) for s in shared]] for o in (one, other)))


def strategies_findings(
    plan: StrategiesPlan, steps: Sequence[CaseRound], trained: Sequence[Trained], designs: Sequence[Designed]
) -> StrategiesFindings:
    """The answer from the results; raises InvalidInput where some are missing."""
    answers = {step.case: step.payload["answer"] for step in steps if "answer" in step.payload}
    agents = {agent.key: agent for agent in trained}
    optima = {(d.plant, d.seed): float(np.mean(d.returns)) for d in designs if d.model == OPTIMUM}
    missing = [case for case in plan.cases if case not in answers or answers[case]["deployed"] not in agents]
    if missing or any((case.plant, case.seed) not in optima for case in plan.cases):
        raise InvalidInput(f"{len(missing)} of {len(plan.cases)} cases are not done: expected a finished experiment")

    def worth(key: str | None, plant: str) -> float:
        return float("nan") if key is None else float(np.mean(agents[key].returns[plant]))

    cases: dict[CaseCondition, list[Case]] = {}
    for case in plan.cases:
        cases.setdefault(CaseCondition(*case[:4]), []).append(case)
    outcomes = {}
    for condition, own in cases.items():
        given = [answers[case] for case in own]
        outcomes[condition] = Outcome(
            seeds=tuple(case.seed for case in own),
            returns=np.array([worth(a["deployed"], condition.plant) for a in given]),
            optima=np.array([optima[condition.plant, case.seed] for case in own]),
            best=np.array([worth(a["best"], condition.plant) for a in given]),
            observed=np.array([np.nan if a["observed"] is None else a["observed"] for a in given]),
            simulated=np.array([float(a["simulated"]) for a in given]),
            rollouts=np.array([float(a["rollouts"]) for a in given]),
        )
    seconds = sum(own.seconds for table in (steps, trained, designs) for own in table)  # type: ignore[attr-defined]
    return StrategiesFindings(plan, outcomes, seconds / 3600.0)
