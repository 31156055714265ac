"""Finished cases of other folders of the same experiment, taken up from the `cases.csv` that these published.

    take_up(Path("study/results/strategies/cases.csv"), plan, results)

So an experiment of many strategies can be run in parts, each by `--strategies` in a folder of its own, on other
machines or on other days. Of an agent that was trained elsewhere its mean return is known, and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from study.pipeline.database import Database
from study.pipeline.tables import read_table
from study.strategies.populations import TRAININGS, Trained
from study.strategies.session import STEPS, CaseRound
from study.strategies.trial_plan import Case, TrialPlan
from sysid import InvalidInput

IMPORTED = "imported-"
"""What keys of agents begin with that were trained elsewhere."""


@dataclass(frozen=True)
class FinishedCase:
    """What counts of a row of `cases.csv`; see `trial_findings.CASES`. The optimum is computed anew."""

    plant: str
    sensing: str
    strategy: str
    n: int
    seed: int
    mean: float
    simulated: float
    best_anew: float | None = None
    observed: float | None = None

    @property
    def case(self) -> Case:
        return Case(self.plant, self.sensing, self.strategy, self.n, self.seed)

    @property
    def key(self) -> str:
        """What its agent is stored under."""
        return IMPORTED + "-".join(map(str, self.case))

    @property
    def agents(self) -> list[Trained]:
        """That which was deployed, and the best candidate where returns were compared."""
        means = {self.key: self.mean} | ({} if self.best_anew is None else {f"{self.key}-best": self.best_anew})
        return [Trained(key, {self.plant: (mean,)}, {}, 0.0) for key, mean in means.items()]

    def last_round(self, source: str) -> CaseRound:
        """The case as if its first round had ended it."""
        answer = {
            "deployed": self.key,
            "best": None if self.best_anew is None else f"{self.key}-best",
            "observed": self.observed,
            "rollouts": self.n,
            "simulated": self.simulated,
            "imported": source,
        }
        return CaseRound(self.case, 0, {"setups": {}, "learn": None, "answer": answer}, 0.0)


def take_up(file: Path, plan: TrialPlan, results: Database) -> None:
    """Put the plan's cases that a file has into the results, where these lack them.

    Raises InvalidInput for a file that is no table of cases, or that has one that is not of the plan.
    """
    rows, cases = read_table(FinishedCase, file, "finished cases"), set(plan.cases)
    for row in rows:
        if row.case not in cases:
            case = ", ".join(map(str, row.case))
            raise InvalidInput(f"{file} has the case {case}: expected cases of {plan.name!r} ({plan.arguments})")
    results.add(TRAININGS, [agent for row in rows for agent in row.agents])
    results.add(STEPS, [row.last_round(file.name) for row in rows])
