"""The strategies experiment as it was fixed before any of its agents was trained: plants, budgets, seeds, contrasts.

    hidden plant, sensing, n rollouts -> a strategy's dialogue -> agent -> return on the hidden plant

No setting of a strategy was tuned on these plants or seeds: they are the sources' where a pendulum allows them, and
otherwise chosen once. This module loads nothing heavy.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

from study.strategies.catalogue import PLACES, strategy_class
from study.trials.hidden_plant import COULOMB, DELAY_MEDIUM, MAGNET, PLAIN, HiddenPlant, TrainingPlan

BASELINE = "point"
"""What the others are held against."""


class Case(NamedTuple):
    """A strategy on a hidden plant with a sensing and n rollouts; everything random comes from seed."""

    plant: str
    sensing: str
    strategy: str
    n: int
    seed: int


@dataclass(frozen=True)
class StrategiesPlan(TrainingPlan):
    """Everything that the experiment's numbers depend on.

    sensings    of the plain plant; the other plants have the first one alone
    contrasts   pairs (a, b): return of a less return of b, with the first sensing at the budgets `contrasted`
    seeds       of what contrasts are about, and of strategies without rollouts
    in_rounds   of strategies that train agents on the way, the first ones, at no more than the largest of `contrasted`
    described   of everything else, the first ones
    steps       of agents that train in simulation, by `algorithm`; learner_steps: of those that go on learning on the
                plant afterwards, which learn by SAC, since a real plant has no gradient
    """

    sensings: tuple[str, ...]
    strategies: tuple[str, ...]
    budgets: tuple[int, ...]
    contrasts: tuple[tuple[str, str], ...]
    contrasted: tuple[int, ...]
    seeds: tuple[int, ...]
    in_rounds: int
    described: int
    algorithm: str = field(default="shac", kw_only=True)
    steps: int = field(default=2_048_000, kw_only=True)
    learner_steps: int = 25_000
    layout: ClassVar[int] = 1
    kind: ClassVar[str] = "strategies"

    @property
    def of_learners(self) -> StrategiesPlan:
        """The plan of agents whose critics are kept, to go on learning with."""
        return dataclasses.replace(self, algorithm="sac", steps=self.learner_steps)

    @property
    def places(self) -> tuple[tuple[HiddenPlant, str], ...]:
        return tuple(
            (plant, sensing)
            for plant in self.plants
            for sensing in (self.sensings if plant.effect is None else self.sensings[:1])
        )

    def budgets_of(self, strategy: str, sensing: str) -> tuple[int, ...]:
        """Those that it can use. Raises InvalidInput for an unknown strategy."""
        kind = strategy_class(strategy)
        if kind.needs_angle and sensing != "encoder":
            return ()
        most = min(kind.most, max(self.contrasted)) if kind.in_rounds else kind.most
        return tuple(n for n in self.budgets if kind.least <= n <= most)

    def seeds_of(self, strategy: str, sensing: str, n: int) -> tuple[int, ...]:
        """All seeds where a contrast needs them and training allows it, else the first ones."""
        named = n in self.contrasted and sensing == self.sensings[0]
        if strategy_class(strategy).in_rounds:
            return self.seeds[: self.in_rounds if named else self.described]
        return self.seeds if named or n == 0 else self.seeds[: self.described]

    @property
    def cases(self) -> tuple[Case, ...]:
        """Every number of the experiment; seeds vary slowest, so that what is there after a while is balanced."""
        return tuple(
            Case(plant.name, sensing, strategy, n, seed)
            for seed in self.seeds
            for plant, sensing in self.places
            for strategy in self.strategies
            for n in self.budgets_of(strategy, sensing)
            if seed in self.seeds_of(strategy, sensing, n)
        )

    def with_strategies(self, names: Sequence[str]) -> StrategiesPlan:
        """The same plan for these strategies; a user's own are held against the baseline as ours are.

        Raises InvalidInput for an unknown strategy.
        """
        for name in names:
            strategy_class(name)
        own = tuple((name, BASELINE) for name in names if name not in PLACES)
        kept = tuple(pair for pair in (*self.contrasts, *own) if set(pair) <= set(names))
        return dataclasses.replace(self, strategies=tuple(names), contrasts=kept)


CONTRASTS = tuple((other, BASELINE) for other in PLACES if other not in ("prior", BASELINE))
"""Pre-registered: every strategy against the point estimate, which is what the paper's own answer comes to."""

PLANTS = (PLAIN, COULOMB, DELAY_MEDIUM, MAGNET)
EVERY = tuple(PLACES)
_ALL = (
    StrategiesPlan("strategies", PLANTS, ("encoder", "speed"), EVERY, (0, 1, 2, 5, 10, 25, 50), CONTRASTS, (5, 25),
                   tuple(range(4000, 4020)), in_rounds=4, described=2),
    StrategiesPlan("strategies-small", (PLAIN, DELAY_MEDIUM), ("encoder",), EVERY, (0, 5), CONTRASTS, (5,),
                   tuple(range(4100, 4110)), in_rounds=3, described=10),
    StrategiesPlan("strategies-quick", (PLAIN,), ("encoder",), EVERY, (0, 2, 10), CONTRASTS, (10,),
                   (1010, 1011), in_rounds=2, described=2, steps=1_024_000,
                   learner_steps=12_000),
    StrategiesPlan("strategies-smoke", (PLAIN, MAGNET), ("encoder", "speed"), EVERY, (0, 2, 5), CONTRASTS, (5,),
                   (1010, 1011), in_rounds=1, described=1, hidden=(8, 8), steps=4096, learner_steps=600,
                   random_steps=200, batch=32, agents=25, episodes=4, grid=40),
)  # fmt: skip

PLANS = {plan.name: plan for plan in _ALL}
