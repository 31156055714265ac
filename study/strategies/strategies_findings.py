"""What the strategies came to: returns over rollouts and over simulated steps, contrasts, and what a best candidate was
worth when it was evaluated anew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from study.strategies.catalogue import strategy_class
from study.strategies.rounds import CaseRound
from study.strategies.strategies_plan import Case, StrategiesPlan
from study.trials.designs import OPTIMUM, Designed
from study.trials.outcomes import Array, Outcome, Place, PlannedContrast, planned_contrasts
from study.trials.populations import Trained
from sysid import InvalidInput

NEAR = 0.05
"""Within so much of the optimum a strategy has arrived."""


class CaseCondition(NamedTuple):
    """A strategy on a plant with a sensing and so many rollouts."""

    plant: str
    sensing: str
    strategy: str
    n: int


@dataclass(frozen=True, eq=False)
class CaseOutcome(Outcome):
    """What a condition came to, of each of its seeds (S,); the returns are of what was deployed.

    best       of the candidate that had returned most within the budget, evaluated anew; observed: what it had returned
               there. Both nan for strategies that compare no returns.
    simulated  environment steps of its agents and of its own simulations; rollouts: that it spent
    """

    best: Array
    observed: Array
    simulated: Array
    rollouts: Array

    @property
    def anew(self) -> float:
        """Mean return of the best candidates, evaluated anew."""
        return float(np.mean(self.best))

    @property
    def near(self) -> bool:
        """Whether the mean is within NEAR of the optimum's."""
        return float(np.mean(self.returns)) >= (1.0 + NEAR) * float(np.mean(self.optima))


@dataclass(frozen=True, eq=False)
class StrategiesFindings:
    """The experiment's answer; hours: what workers spent."""

    plan: StrategiesPlan
    outcomes: dict[CaseCondition, CaseOutcome]
    hours: float

    def line(self, plant: str, sensing: str, strategy: str) -> dict[int, CaseOutcome]:
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

    def contrast(self, plant: str, n: int, a: str) -> PlannedContrast | None:
        """That of a strategy against its counterpart; None where none was planned."""
        return next((c for c in self.compared if (c.plant, c.n, c.a) == (plant, n, a)), None)

    @cached_property
    def compared(self) -> tuple[PlannedContrast, ...]:
        """The pre-registered contrasts, in the plan's order."""
        return planned_contrasts(self._family())

    def _family(self) -> Iterator[tuple[Place, Outcome, Outcome]]:
        for plant, sensing in self.plan.places:
            for n in self.plan.contrasted if sensing == self.plan.sensings[0] else ():
                for a, b in self.plan.contrasts:
                    one, other = (self.line(plant.name, sensing, own).get(_spent(own, n)) for own in (a, b))
                    if one is not None and other is not None:
                        yield (plant.name, sensing, n, a, b), one, other


def _spent(strategy: str, n: int) -> int:
    """Of n rollouts those that it can make use of."""
    return min(n, strategy_class(strategy).most)


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
        outcomes[condition] = CaseOutcome(
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
