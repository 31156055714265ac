"""The strategies experiment as it was fixed before any of its agents was trained: plants, budgets, seeds, contrasts.

No setting of a strategy was tuned on these plants or seeds: they are the sources' where a pendulum allows them, and
otherwise chosen once; each strategy's docstring tells what was changed. This module loads nothing heavy.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Self

from study.strategies.catalogue import PLACES, strategy_called
from study.strategies.trial_plan import Case, TrialPlan
from study.trials.hidden_plant import COULOMB, DELAY_MEDIUM, MAGNET, PLAIN, HiddenPlant

if TYPE_CHECKING:
    from study.strategies.plant import BudgetedPlant
    from study.strategies.strategy import Strategy

REFERENCE = "point"
"""What the others are held against."""


@dataclass(frozen=True)
class StrategiesPlan(TrialPlan):
    """Everything that the experiment's numbers depend on.

    seeds       of what contrasts are about, and of strategies without rollouts
    in_rounds   of strategies that train agents on the way, the first seeds, at no more than the largest of `contrasted`
    steps       of agents that train in simulation, by `algorithm`; learner_steps: of those that go on learning on the
                plant afterwards, which learn by SAC, since a real plant has no gradient
    """

    in_rounds: int
    algorithm: str = field(default="shac", kw_only=True)
    steps: int = field(default=2_048_000, kw_only=True)
    learner_steps: int = 25_000
    layout: ClassVar[int] = 4
    kind: ClassVar[str] = "strategies"
    page: ClassVar[str] = "study.strategies.strategies_page"

    @property
    def of_learners(self) -> Self:
        return dataclasses.replace(self, algorithm="sac", steps=self.learner_steps)

    @property
    def arguments(self) -> str:
        """With the strategies, where some were chosen."""
        all_of_them = self.name in STRATEGIES_PLANS and self.strategies == STRATEGIES_PLANS[self.name].strategies
        return super().arguments + ("" if all_of_them else f" --strategies {','.join(self.strategies)}")

    def strategy_on(self, plant: HiddenPlant, name: str) -> Strategy:
        return strategy_called(name)

    def plant_of(self, case: Case) -> BudgetedPlant:
        from study.strategies.plant import BudgetedPlant
        from study.trials.ground_truth import ground_truth

        return BudgetedPlant(ground_truth(self.plant(case.plant)), case.sensing, case.n, case.seed)

    def seeds_of(self, strategy: str, sensing: str, n: int) -> tuple[int, ...]:
        """All seeds where a contrast needs them and training allows it, else the first ones."""
        named = n in self.contrasted and sensing == self.sensings[0]
        if strategy_called(strategy).in_rounds:
            return self.seeds[: self.in_rounds if named else self.described]
        return self.seeds if named or n == 0 else self.seeds[: self.described]

    def with_strategies(self, names: Sequence[str]) -> StrategiesPlan:
        """The same plan for these strategies; a user's own are held against the baseline as ours are.

        Raises InvalidInput for an unknown strategy, and for one that is named twice.
        """
        for name in names:
            strategy_called(name)
            if names.count(name) > 1:
                from sysid import InvalidInput

                raise InvalidInput(f"strategy {name!r} was given {names.count(name)} times: expected each once")
        own_contrasts = tuple((name, REFERENCE) for name in names if name not in PLACES)
        kept = tuple(pair for pair in (*self.contrasts, *own_contrasts) if set(pair) <= set(names))
        return dataclasses.replace(self, strategies=tuple(names), contrasts=kept)


AGAINST_POINT = tuple((other, REFERENCE) for other in PLACES if other not in ("prior", REFERENCE))
"""Pre-registered: every strategy against the point estimate, which is what the paper's own answer comes to."""

PLANTS = (PLAIN, COULOMB, DELAY_MEDIUM, MAGNET)
EVERY = tuple(PLACES)
_ALL = (
    StrategiesPlan("strategies", PLANTS, EVERY, (0, 1, 2, 5, 10, 25, 50), AGAINST_POINT, (5, 25),
                   tuple(range(4000, 4020)), described=2, in_rounds=4, sensings=("encoder", "speed")),
    StrategiesPlan("strategies-small", (PLAIN, DELAY_MEDIUM), EVERY, (0, 5), AGAINST_POINT, (5,),
                   tuple(range(4100, 4110)), described=10, in_rounds=3),
    StrategiesPlan("strategies-quick", (PLAIN,), EVERY, (0, 2, 10), AGAINST_POINT, (10,), (1010, 1011), described=2,
                   in_rounds=2, steps=1_024_000, learner_steps=12_000),
    StrategiesPlan("strategies-smoke", (PLAIN, MAGNET), EVERY, (0, 2, 5), AGAINST_POINT, (5,), (1010, 1011),
                   described=1, in_rounds=1, sensings=("encoder", "speed"), hidden=(8, 8), steps=4096,
                   learner_steps=600, random_steps=200, batch=32, agents=25, episodes=4, grid=40),
)  # fmt: skip

STRATEGIES_PLANS = {plan.name: plan for plan in _ALL}
