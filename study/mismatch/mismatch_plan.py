"""The mismatch experiment as it was fixed before any of its agents was trained: plants, strategies, seeds
and contrasts.

Nothing here was tried on a trained agent. Seeds are used for nothing else. This module loads nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from study.strategies.trial_plan import Case, TrialPlan
from study.trials.hidden_plant import ALL_PLANTS, COULOMB, DELAY_LARGE, DELAY_MEDIUM, MAGNET, HiddenPlant

if TYPE_CHECKING:
    from study.strategies.plant import BudgetedPlant
    from study.strategies.strategy import Strategy


@dataclass(frozen=True)
class StrategyLabels:
    """How a strategy is told.

    group        what strategies that belong together share: "nothing" measured, "plain" or "mended" model, "oracle"
    short        it in up to five words; description: in full
    center       the strategy whose model is the centre of what it trains on; "" where no table can be made for that
    """

    group: str
    short: str
    description: str
    center: str = ""


STRATEGIES = {
    "prior": StrategyLabels("nothing", "prior", "no rollouts: trained at the prior", "prior"),
    "breadth": StrategyLabels("nothing", "breadth over m, l and effects",
        "no rollouts: breadth over m, l and one effect of any kind within its plausible range"),
    "grid": StrategyLabels("plain", "grid, m and l", "the paper's grid search for m and l", "grid"),
    "fitted": StrategyLabels("plain", "least squares, m and l", "least squares for m and l", "fitted"),
    "band": StrategyLabels("plain", "least squares, band w = 0.3", "least squares for m and l, band w = 0.3", "fitted"),
    "random_force": StrategyLabels("plain", "least squares, random torques",
        "least squares for m and l, random torques in training", "fitted"),
    "network": StrategyLabels("plain", "least squares, learned torque",
        "least squares for m and l, a learned command filter and residual torque"),
    "all_effects": StrategyLabels("mended", "all effects at once",
        "least squares for m, l and all effects at once"),
    "mended": StrategyLabels("mended", "diagnosed and mended",
        "diagnosed: the missing effect named, added, refitted; where it is unknown, random torques", "mended"),
    "posterior": StrategyLabels("mended", "diagnosed, posterior",
        "diagnosed, parameters drawn from the fit's covariance", "mended"),
    "oracle": StrategyLabels("oracle", "the plant itself", "the hidden plant itself: an oracle"),
}  # fmt: skip
"""Every strategy, in the order in which they are shown; those that spend rollouts are names of `Budget.setup`."""

CONTRASTS = (("mended", "fitted"), ("band", "fitted"), ("mended", "all_effects"), ("mended", "network"),
             ("breadth", "prior"), ("oracle", "mended"))  # fmt: skip
"""Pre-registered differences of return, at every plant and budget; their p-values are one family for Holm."""


@dataclass(frozen=True)
class MismatchPlan(TrialPlan):
    """Everything that the experiment's numbers depend on; all seeds are of every strategy that a contrast names."""

    layout: ClassVar[int] = 5
    kind: ClassVar[str] = "mismatch"
    page: ClassVar[str] = "study.mismatch.mismatch_page"

    @property
    def centers(self) -> tuple[str, ...]:
        return tuple(strategy for strategy in self.strategies if STRATEGIES[strategy].center == strategy)

    def strategy_on(self, plant: HiddenPlant, name: str) -> Strategy:
        """The strategy of that name; one that does not measure knows the plant."""
        from study.mismatch.measured import known_setup
        from study.strategies.identified import Identified, Unmeasured

        if STRATEGIES[name].group in ("plain", "mended"):
            return Identified(name)
        return Unmeasured(lambda situation: known_setup(name, plant))

    def plant_of(self, case: Case) -> BudgetedPlant:
        from study.mismatch.measured import MeasuredPlant

        return MeasuredPlant(self.plant(case.plant), case.n, case.seed, max(self.budgets))

    def seeds_of(self, strategy: str, sensing: str = "encoder", n: int = 0) -> tuple[int, ...]:
        return self.seeds if any(strategy in pair for pair in self.contrasts) else self.seeds[: self.described]


FEW_STRATEGIES = ("prior", "fitted", "band", "mended", "oracle")
_ALL = (
    MismatchPlan("mismatch", ALL_PLANTS, tuple(STRATEGIES), (0, 5, 50), CONTRASTS, (5, 50), tuple(range(3000, 3020)),
                 described=5),
    MismatchPlan("mismatch-shac", (COULOMB, DELAY_MEDIUM, DELAY_LARGE), FEW_STRATEGIES, (0, 5), CONTRASTS, (5,),
                 tuple(range(3000, 3020)), described=10, algorithm="shac", steps=2_048_000, agents=20),
    MismatchPlan("mismatch-quick", (DELAY_LARGE, MAGNET), FEW_STRATEGIES, (0, 5), CONTRASTS, (5,), (1000, 1001, 1002),
                 described=3),
    MismatchPlan("mismatch-smoke", (DELAY_LARGE, MAGNET), tuple(STRATEGIES), (0, 2), CONTRASTS, (2,), (1000, 1001),
                 described=1, hidden=(8, 8), steps=800, random_steps=200, batch=32, agents=4, episodes=4, grid=40),
)  # fmt: skip

MISMATCH_PLANS = {plan.name: plan for plan in _ALL}
