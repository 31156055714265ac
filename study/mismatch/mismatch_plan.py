"""The mismatch experiment as it was fixed before any of its agents was trained: plants, strategies, seeds
and contrasts.

    hidden plant -> n rollouts -> a strategy -> agent trained on what came out -> return on the hidden plant

Nothing here was tried on a trained agent. Seeds are used for nothing else. This module loads nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, NamedTuple

from study.trials.hidden_plant import ALL_PLANTS, COULOMB, DELAY_LARGE, DELAY_MEDIUM, MAGNET, TrainingPlan


class StrategyKey(StrEnum):
    """The strategies by name."""

    PRIOR = "prior"
    BREADTH = "breadth"
    GRID = "grid"
    FITTED = "fitted"
    BAND = "band"
    RANDOM_FORCE = "random_force"
    NETWORK = "network"
    ALL_EFFECTS = "all_effects"
    MENDED = "mended"
    POSTERIOR = "posterior"
    ORACLE = "oracle"


@dataclass(frozen=True)
class TrialStrategy:
    """A strategy to spend rollouts.

    short, words   it in up to five words, and in full
    group          what strategies that belong together share: "nothing" measured, "plain" or "mended" model, "oracle"
    center         the strategy whose model is the centre of what it trains on; "" where no table can be made for that
    """

    key: StrategyKey
    group: str
    short: str
    words: str
    center: str = ""


_STRATEGIES = (
    TrialStrategy(StrategyKey.PRIOR, "nothing", "prior", "no rollouts: trained at the prior", StrategyKey.PRIOR),
    TrialStrategy(StrategyKey.BREADTH, "nothing", "breadth over m, l and effects",
        "no rollouts: breadth over m, l and one effect of any kind within its plausible range"),
    TrialStrategy(StrategyKey.GRID, "plain", "grid, m and l", "the paper's grid search for m and l", StrategyKey.GRID),
    TrialStrategy(StrategyKey.FITTED, "plain", "least squares, m and l", "least squares for m and l",
        StrategyKey.FITTED),
    TrialStrategy(StrategyKey.BAND, "plain", "least squares, band w = 0.3", "least squares for m and l, band w = 0.3",
        StrategyKey.FITTED),
    TrialStrategy(StrategyKey.RANDOM_FORCE, "plain", "least squares, random torques",
        "least squares for m and l, random torques in training", StrategyKey.FITTED),
    TrialStrategy(StrategyKey.NETWORK, "plain", "least squares, learned torque",
        "least squares for m and l, a learned command filter and residual torque"),
    TrialStrategy(StrategyKey.ALL_EFFECTS, "mended", "all effects at once",
        "least squares for m, l and all effects at once"),
    TrialStrategy(StrategyKey.MENDED, "mended", "diagnosed and mended",
        "diagnosed: the missing effect named, added, refitted; where it is unknown, random torques",
        StrategyKey.MENDED),
    TrialStrategy(StrategyKey.POSTERIOR, "mended", "diagnosed, posterior",
        "diagnosed, parameters drawn from the fit's covariance", StrategyKey.MENDED),
    TrialStrategy(StrategyKey.ORACLE, "oracle", "the plant itself", "the hidden plant itself: an oracle"),
)  # fmt: skip

STRATEGIES: dict[str, TrialStrategy] = {strategy.key: strategy for strategy in _STRATEGIES}
"""Every strategy, in the order in which they are shown."""

LADDER = (StrategyKey.PRIOR, StrategyKey.FITTED, StrategyKey.MENDED, StrategyKey.ORACLE)
"""The ladder, from knowing nothing to knowing everything."""

FREE = tuple(key for key, strategy in STRATEGIES.items() if strategy.group in ("nothing", "oracle"))
"""Strategies that spend no rollouts."""

SHARED = tuple(key for key, strategy in STRATEGIES.items() if strategy.group == "nothing")
"""Strategies that know nothing of the plant: their agents are the same on all plants."""

CONTRASTS = (
    (StrategyKey.MENDED, StrategyKey.FITTED),
    (StrategyKey.BAND, StrategyKey.FITTED),
    (StrategyKey.MENDED, StrategyKey.ALL_EFFECTS),
    (StrategyKey.MENDED, StrategyKey.NETWORK),
    (StrategyKey.BREADTH, StrategyKey.PRIOR),
    (StrategyKey.ORACLE, StrategyKey.MENDED),
)
"""Pre-registered differences of return, at every plant and budget; their p-values are one family for Holm."""


class TrialKey(NamedTuple):
    """One number: on a hidden plant, a strategy spends n rollouts; everything random comes from seed."""

    plant: str
    strategy: str
    n: int
    seed: int


@dataclass(frozen=True)
class Plan(TrainingPlan):
    """Everything that the experiment's numbers depend on.

    seeds   of every strategy that a contrast names; described: of the others, the first ones
    band    half the relative width of the band about the fit
    length  steps of a rollout
    sd      of the angle [rad] and of the speed [rad/s] as read
    """

    strategies: tuple[str, ...]
    budgets: tuple[int, ...]
    seeds: tuple[int, ...]
    described: int
    band: float = 0.3
    length: int = 200
    sd: tuple[float, float] = (0.01, 1.0)
    layout: ClassVar[int] = 2
    kind: ClassVar[str] = "mismatch"

    def seeds_of(self, strategy: str) -> tuple[int, ...]:
        """All seeds where a contrast names the strategy, else the first ones."""
        contrasted = any(strategy in pair for pair in CONTRASTS)
        return self.seeds if contrasted else self.seeds[: self.described]

    @property
    def trials(self) -> tuple[TrialKey, ...]:
        """Every number of the experiment. Seeds vary slowest, so that what is there after a while is balanced."""
        return tuple(
            TrialKey(plant.name, strategy, n, seed)
            for seed in self.seeds
            for plant in self.plants
            for strategy in self.strategies
            if seed in self.seeds_of(strategy)
            for n in ((0,) if strategy in FREE else self.budgets)
        )


QUICK_STRATEGIES = tuple(StrategyKey[name] for name in ("PRIOR", "FITTED", "BAND", "MENDED", "ORACLE"))

_ALL = (
    Plan("mismatch", ALL_PLANTS, tuple(STRATEGIES), (5, 50), tuple(range(3000, 3020)), described=5),
    Plan("mismatch-shac", (COULOMB, DELAY_MEDIUM, DELAY_LARGE), QUICK_STRATEGIES, (5,), tuple(range(3000, 3020)),
         described=10, algorithm="shac", steps=2_048_000, agents=20),
    Plan("mismatch-quick", (DELAY_LARGE, MAGNET), QUICK_STRATEGIES, (5,), (1000, 1001, 1002), described=3),
    Plan("mismatch-smoke", (DELAY_LARGE, MAGNET), tuple(STRATEGIES), (2,), (1000, 1001), described=1, hidden=(8, 8),
         steps=800, random_steps=200, batch=32, agents=4, episodes=4, grid=40),
)  # fmt: skip

PLANS = {plan.name: plan for plan in _ALL}
