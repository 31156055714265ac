"""The mismatch experiment as it was fixed before any of its agents was trained: plants, ways, seeds and contrasts.

    hidden plant -> n rollouts -> a way to spend them -> agent trained on what came out -> return on the hidden plant

Sizes of the hidden effects are those that dynamic programming chose (`sizes`, `effect_cost`): nothing here was tried on
a trained agent. Seeds are used for nothing else. This module loads nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from study.pipeline.settings import Fingerprinted

FORMAT = 1
"""Version of the results folder: raised whenever stored numbers change their meaning."""


@dataclass(frozen=True)
class Way:
    """A way to spend rollouts.

    short, words   it in up to five words, and in full
    group          what ways that belong together share: "nothing" measured, "plain" or "mended" model, "oracle"
    center         the way whose model is the centre of what it trains on; "" where no table can be made for that
    """

    key: str
    group: str
    short: str
    words: str
    center: str = ""


_WAYS = (
    Way("z", "nothing", "prior", "no rollouts: trained at the prior", "z"),
    Way("e", "nothing", "breadth over m, l and effects",
        "no rollouts: breadth over m, l and one effect of any kind within its plausible range"),
    Way("a", "plain", "grid, m and l", "the paper's grid search for m and l", "a"),
    Way("b", "plain", "least squares, m and l", "least squares for m and l", "b"),
    Way("b+", "plain", "least squares, band w = 0.3", "least squares for m and l, band w = 0.3", "b"),
    Way("g", "plain", "least squares, random torques", "least squares for m and l, random torques in training", "b"),
    Way("i", "plain", "least squares, learned torque",
        "least squares for m and l, a learned command filter and residual torque"),
    Way("d", "mended", "all effects at once", "least squares for m, l and all effects at once"),
    Way("c", "mended", "diagnosed and mended",
        "diagnosed: the missing effect named, added, refitted; where it is unknown, as g", "c"),
    Way("f", "mended", "diagnosed, posterior", "diagnosed, parameters drawn from the fit's covariance", "c"),
    Way("h", "oracle", "the plant itself", "the hidden plant itself: an oracle"),
)  # fmt: skip

WAYS = {way.key: way for way in _WAYS}
"""Every way, in the order in which they are shown."""

FREE = tuple(key for key, way in WAYS.items() if way.group in ("nothing", "oracle"))
"""Ways that spend no rollouts."""

SHARED = tuple(key for key, way in WAYS.items() if way.group == "nothing")
"""Ways that know nothing of the plant: their agents are the same on all plants."""

CONTRASTS = (("c", "b"), ("b+", "b"), ("c", "d"), ("c", "i"), ("e", "z"), ("h", "c"))
"""Pre-registered differences of return, at every plant and budget; their p-values are one family for Holm."""


class Trial(NamedTuple):
    """One number: on a hidden plant, a way spends n rollouts; everything random comes from seed."""

    plant: str
    way: str
    n: int
    seed: int


@dataclass(frozen=True)
class HiddenPlant:
    """A machine with one effect, of the catalogue or outside it; None: the plain rod.

    numbers   the effect's parameters (name, value)
    percent   what it costs an optimal policy not to know it, in percent of the return, by the programs of
              `effect_cost`; a record: nothing is computed from it
    """

    name: str
    effect: str | None = None
    numbers: tuple[tuple[str, float], ...] = ()
    percent: float = 0.0


@dataclass(frozen=True)
class Plan(Fingerprinted):
    """Everything that the experiment's numbers depend on.

    contrasted  seeds of every way that a contrast names; described: of the others, the first ones
    history     past commands that every agent observes
    sd          of the angle [rad] and of the speed [rad/s] as read
    agents      trained together in one process on a CPU, at most
    grid        angles of the dynamic programs, at the hidden plants and at every fitted model
    """

    name: str
    plants: tuple[HiddenPlant, ...]
    ways: tuple[str, ...]
    budgets: tuple[int, ...]
    seeds: tuple[int, ...]
    described: int
    hidden: tuple[int, ...] = (64, 64)
    steps: int = 30_000
    random_steps: int = 1000
    batch: int = 256
    history: int = 4
    band: float = 0.3
    length: int = 200
    sd: tuple[float, float] = (0.01, 1.0)
    agents: int = 25
    episodes: int = 20
    grid: int = 120
    layout: ClassVar[int] = FORMAT

    def seeds_of(self, way: str) -> tuple[int, ...]:
        """All seeds where a contrast names the way, else the first ones."""
        contrasted = any(way in pair for pair in CONTRASTS)
        return self.seeds if contrasted else self.seeds[: self.described]

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Every number of the experiment. Seeds vary slowest, so that what is there after a while is balanced."""
        return tuple(
            Trial(plant.name, way, n, seed)
            for seed in self.seeds
            for plant in self.plants
            for way in self.ways
            if seed in self.seeds_of(way)
            for n in ((0,) if way in FREE else self.budgets)
        )

    def plant(self, name: str) -> HiddenPlant:
        """The hidden plant of that name; raises KeyError for another."""
        return {plant.name: plant for plant in self.plants}[name]


PLAIN = HiddenPlant("plain")
COULOMB = HiddenPlant("coulomb", "coulomb", (("tau_c", 1.5),), 3.9)
DELAY_MEDIUM = HiddenPlant("delay_medium", "delay", (("T", 0.126),), 9.9)
DELAY_LARGE = HiddenPlant("delay_large", "delay", (("T", 0.155),), 30.0)
MAGNET = HiddenPlant("magnet", "magnet", (("k", 1.25),), 29.1)
SLEW = HiddenPlant("slew", "slew_limit", (("rate", 8.5),), 28.4)

ALL_PLANTS = (PLAIN, COULOMB, DELAY_MEDIUM, DELAY_LARGE, MAGNET, SLEW)

_ALL = (
    Plan("mismatch", ALL_PLANTS, tuple(WAYS), (5, 50), tuple(range(3000, 3020)), described=5),
    Plan("mismatch-quick", (DELAY_LARGE, MAGNET), ("z", "b", "b+", "c", "h"), (5,), (1000, 1001, 1002), described=3),
    Plan(
        "mismatch-smoke",
        (DELAY_LARGE, MAGNET),
        tuple(WAYS),
        (2,),
        (1000, 1001),
        described=1,
        hidden=(8, 8),
        steps=800,
        random_steps=200,
        batch=32,
        agents=4,
        episodes=4,
        grid=40,
    ),
)

PLANS = {plan.name: plan for plan in _ALL}
