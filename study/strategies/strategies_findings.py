"""What the strategies came to, over real rollouts and over simulated steps, and who arrives at the optimum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.strategies.strategies_plan import StrategiesPlan
from study.strategies.trial_findings import Outcome, PlannedContrast, TrialFindings, TrialResults, trial_findings

NEAR = 0.05
"""Within so much of the optimum a strategy has arrived."""


@dataclass(frozen=True, eq=False)
class StrategiesFindings(TrialFindings):
    """The experiment's answer."""

    plan: StrategiesPlan

    def line(self, plant: str, sensing: str, strategy: str) -> dict[int, Outcome]:
        """A strategy's outcomes by budget."""
        return {c.n: o for c, o in self.outcomes.items() if c[:3] == (plant, sensing, strategy)}

    def arrived(self, plant: str, sensing: str, strategy: str) -> int | None:
        """The smallest budget from which on it stays within NEAR of the optimum; None where it does not get there."""
        found = None
        for n, outcome in sorted(self.line(plant, sensing, strategy).items(), reverse=True):
            if float(np.mean(outcome.returns)) < (1.0 + NEAR) * float(np.mean(outcome.optima)):
                break
            found = n
        return found

    def contrast(self, plant: str, n: int, a: str) -> PlannedContrast | None:
        """That of a strategy against its counterpart; None where none was planned."""
        return next((c for c in self.compared if (c.plant, c.n, c.a) == (plant, n, a)), None)


def strategies_findings(plan: StrategiesPlan, results: TrialResults) -> StrategiesFindings:
    """The answer from the results; raises InvalidInput where some are missing."""
    return StrategiesFindings(**vars(trial_findings(plan, results)))
