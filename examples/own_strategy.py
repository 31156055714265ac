"""A user's own strategy to spend rollouts, beside ours.

    python examples/own_strategy.py                                                    tries it, in a minute or two
    python -m study.main --preset strategies-quick --strategies point,examples/own_strategy.py:TestedBand --out mine

A strategy is a generator: it asks for rollouts and for agents, is answered, and returns what the last agent trains on.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import ClassVar

from policies.environments.randomization import Band
from study.strategies.strategy import Choice, Dialogue, Play, Situation, Strategy, Train, TrainingSetup, Try
from sysid import fit


@dataclass(frozen=True)
class TestedBand(Strategy):
    """Identifies with all rollouts but two; with these it asks the plant which is better, the estimate or a band."""

    w: float = 0.2
    short: ClassVar[str] = "tested band"
    group: ClassVar[str] = "compared"
    in_rounds: ClassVar[bool] = True
    least: ClassVar[int] = 3

    def spend(self, situation: Situation) -> Dialogue:
        """Play, fit, train two agents, try each once, and keep the better one."""
        records = yield Play(situation.budget - 2)
        estimate = fit(situation.prior, records, situation.sensor, situation.names)
        center = {name: estimate.values[name] for name in situation.names}
        agents = yield Train(tuple(TrainingSetup(estimate.model, Band(center, w)) for w in (0.0, self.w)))
        returns = []
        for agent in agents:
            returns.append((yield Try(agent)).mean)
        best = agents[returns.index(max(returns))]
        return Choice(best, best, max(returns))


def main() -> int:
    """Run it with agents so small that the numbers mean nothing."""
    from study.main import main as study

    chosen = f"point,{__file__}:TestedBand"
    return study(["--preset", "strategies-smoke", "--strategies", chosen, "--out", "results/own_strategy"])


if __name__ == "__main__":
    sys.exit(main())
