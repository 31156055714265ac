"""What is fixed beforehand of an experiment whose cases are dialogues of strategies with a hidden plant.

    hidden plant, sensing, n rollouts -> a strategy's dialogue -> agent -> return on the hidden plant

This module loads nothing heavy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple, Self

from study.pipeline.settings import StudySettings
from study.trials.hidden_plant import HiddenPlant

if TYPE_CHECKING:
    from study.strategies.plant import BudgetedPlant
    from study.strategies.strategy import Strategy


class Condition(NamedTuple):
    """A strategy on a hidden plant with a sensing and n rollouts."""

    plant: str
    sensing: str
    strategy: str
    n: int


class Case(NamedTuple):
    """One seed of a condition, from which everything random comes."""

    plant: str
    sensing: str
    strategy: str
    n: int
    seed: int

    @property
    def condition(self) -> Condition:
        return Condition(*self[:4])


@dataclass(frozen=True)
class TrialPlan(StudySettings, ABC):
    """Everything that the numbers of such an experiment depend on.

    contrasts   pairs (a, b): return of a less return of b, with the first sensing at the budgets `contrasted`
    seeds       of what contrasts are about; described: of everything else, the first ones
    sensings    of the plain plant; the other plants have the first one alone
    history     past commands that every agent observes
    agents      trained together in one process on a CPU, at most
    episodes    of every agent on a hidden plant, once trained
    grid        angles of the dynamic programs, at the hidden plants and at every fitted model
    """

    name: str
    plants: tuple[HiddenPlant, ...]
    strategies: tuple[str, ...]
    budgets: tuple[int, ...]
    contrasts: tuple[tuple[str, str], ...]
    contrasted: tuple[int, ...]
    seeds: tuple[int, ...]
    described: int
    _: KW_ONLY
    sensings: tuple[str, ...] = ("encoder",)
    hidden: tuple[int, ...] = (64, 64)
    algorithm: str = "sac"
    steps: int = 30_000
    random_steps: int = 1000
    batch: int = 256
    history: int = 4
    agents: int = 25
    episodes: int = 20
    grid: int = 120
    experiment: ClassVar[str] = "study.strategies.trial_experiment"
    page: ClassVar[str]
    """The module whose `account` tells what came out."""

    def plant(self, name: str) -> HiddenPlant:
        """The hidden plant of that name; raises KeyError for another."""
        return {plant.name: plant for plant in self.plants}[name]

    @abstractmethod
    def strategy_on(self, plant: HiddenPlant, name: str) -> Strategy:
        """What spends the rollouts of a plant."""

    @abstractmethod
    def plant_of(self, case: Case) -> BudgetedPlant:
        """What grants them."""

    @abstractmethod
    def seeds_of(self, strategy: str, sensing: str, n: int) -> tuple[int, ...]:
        """The seeds of a condition."""

    @property
    def of_learners(self) -> Self:
        """The plan of agents whose critics are kept, to go on learning with."""
        return self

    @property
    def centers(self) -> tuple[str, ...]:
        """Strategies on whose models controllers are designed, too."""
        return ()

    @property
    def places(self) -> tuple[tuple[HiddenPlant, str], ...]:
        """The plants with each way of sensing that any strategy can use; more than one where nothing is missing."""
        return tuple(
            (plant, sensing)
            for plant in self.plants
            for sensing in (self.sensings if plant.effect is None else self.sensings[:1])
            if any(self.budgets_of(self.strategy_on(plant, name), sensing) for name in self.strategies)
        )

    def condition(self, plant: HiddenPlant, sensing: str, strategy: str, n: int) -> Condition:
        """That of a strategy with n rollouts, or with none where it spends none."""
        return Condition(plant.name, sensing, strategy, min(n, self.strategy_on(plant, strategy).most))

    def budgets_of(self, strategy: Strategy, sensing: str) -> tuple[int, ...]:
        """Those that it can use."""
        if strategy.needs_angle and sensing != "encoder":
            return ()
        most = min(strategy.most, max(self.contrasted)) if strategy.in_rounds else strategy.most
        return tuple(n for n in self.budgets if strategy.least <= n <= most)

    @property
    def cases(self) -> tuple[Case, ...]:
        """Every number of the experiment; seeds vary slowest, so that what is there after a while is balanced."""
        return tuple(
            Case(plant.name, sensing, strategy, n, seed)
            for seed in self.seeds
            for plant, sensing in self.places
            for strategy in self.strategies
            for n in self.budgets_of(self.strategy_on(plant, strategy), sensing)
            if seed in self.seeds_of(strategy, sensing, n)
        )
