"""Presets: what a study measures, trains and compares, as frozen plain data.

    preset = operating points (which plants, how measured, how identified)  x  one set of training settings

This module loads nothing heavy, so that `python -m study.main --help` answers at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from study.pipeline.settings import StudySettings, partition

Theta = tuple[float, float]
"""(m [kg], l [m])."""
Estimates = Mapping[tuple[str, int, int], Theta]
"""theta_hat by (point, n, seed)."""


class Cell(NamedTuple):
    """One run: at an operating point, n rollouts are measured, the training band has relative width w, everything
    random comes from seed."""

    point: str
    n: int
    w: float
    seed: int

    def __str__(self) -> str:
        return f"{self.point}, n = {self.n}, w = {self.w:g}, seed {self.seed}"


@dataclass(frozen=True)
class Point:
    """An operating point: a hidden plant and how it is measured and identified, with its grid of runs.

    budgets        n, rollouts measured on the hidden plant; 0 trains at the prior
    widths         w, relative half-width of the training band
    truth          the hidden plant's (m [kg], l [m]); prior: what an engineer would assume without data
    sigma          sd of a speed reading [rad/s]
    identifier     "grid" (the paper's), "least_squares" or "unscented"
    randomization  "band" of width w around the estimate, or "prior_range": all that is plausible, and w is only a label
    """

    name: str
    budgets: tuple[int, ...]
    widths: tuple[float, ...]
    seeds: tuple[int, ...]
    truth: Theta = (2.0, 1.5)
    prior: Theta = (1.0, 1.0)
    sigma: float = 1.0
    identifier: str = "grid"
    randomization: str = "band"

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Its runs. Widths vary slowest, so that what trains together has one width, or few."""
        return tuple(Cell(self.name, n, w, seed) for w in self.widths for seed in self.seeds for n in self.budgets)


@dataclass(frozen=True)
class Preset(StudySettings):
    """Operating points, and everything else that the numbers of their runs depend on.

    hidden       layer sizes of actor and critics
    steps        environment steps an agent trains
    population   agents trained together in one process on a CPU
    episodes     evaluation episodes a run, from either kind of start states
    reference_seeds  whose start states rate the references, beside the study's own seeds: the paper's ten
    grid         angles, and speeds but for one, of the dynamic programs, at the truths and at every estimate
    companion    the preset whose results stand beside these, in the sibling folder of that name
    """

    name: str
    points: tuple[Point, ...]
    hidden: tuple[int, ...]
    steps: int
    population: int
    batch: int = 256
    random_steps: int = 1000
    episodes: int = 20
    reference_seeds: tuple[int, ...] = tuple(range(10))
    grid: int = 450
    resamples: int = 20_000
    companion: str | None = None
    layout: ClassVar[int] = 5
    experiment: ClassVar[str] = "study.paper.sweep"

    @property
    def cells(self) -> tuple[Cell, ...]:
        return tuple(cell for point in self.points for cell in point.cells)

    def populations(self, device: str = "cpu") -> tuple[tuple[Cell, ...], ...]:
        """The runs that train together: consecutive cells, `population` at a time."""
        return tuple(partition(self.cells, self.population, device))

    def point(self, name: str) -> Point:
        """The operating point of that name; raises KeyError for another."""
        return {point.name: point for point in self.points}[name]

    def figure_file(self, point: str, name: str) -> str:
        """The file of a figure: NAME.png, and NAME_POINT.png where there are several points."""
        return f"{name}.png" if len(self.points) == 1 else f"{name}_{point}.png"

    @property
    def seeds(self) -> tuple[int, ...]:
        """Every seed that some point uses."""
        return tuple(sorted({seed for point in self.points for seed in point.seeds}))


FIVE, TEN = tuple(range(5)), tuple(range(10))
PAPER_BUDGETS, PAPER_WIDTHS = (0, 5, 10, 25, 50), (0.0, 0.1, 0.2, 0.3, 0.5)
"""The paper's."""

ROBUSTNESS_POINTS = (
    Point("small_gap", (0, 10, 50), (0.0, 0.2, 0.5), FIVE, truth=(1.5, 1.2)),
    Point("large_gap", (0, 10, 50), (0.0, 0.2, 0.5), FIVE, truth=(2.5, 2.0)),
    Point("low_noise", PAPER_BUDGETS, (0.0, 0.5), FIVE, sigma=0.5),
    Point("high_noise", PAPER_BUDGETS, (0.0, 0.5), FIVE, sigma=2.0),
    Point("prior_range", (0,), (0.5,), TEN, randomization="prior_range"),
)
"""The paper's Table I but for its main row, and the prior-range baseline of its text."""

COUNTS = (1, 2, 5, 10, 25, 50)
IDENTIFIERS = (
    Point("prior", (0,), (0.0, 0.2), FIVE),
    Point("grid", COUNTS, (0.0, 0.2), FIVE),
    Point("least_squares", COUNTS, (0.0, 0.2), FIVE, identifier="least_squares"),
    Point("unscented", COUNTS, (0.0, 0.2), FIVE, identifier="unscented"),
)

SMALL_NETWORK, LARGE_NETWORK = (64, 64), (256, 256)

_ALL = (
    Preset("quick", (Point("main", (0, 5, 50), (0.0, 0.5), (0, 1, 2)),), SMALL_NETWORK, 30_000, 9),
    Preset("paper", (Point("main", PAPER_BUDGETS, PAPER_WIDTHS, TEN),), LARGE_NETWORK, 75_000, 5, grid=600),
    Preset("paper-small", (Point("main", PAPER_BUDGETS, PAPER_WIDTHS, TEN),), SMALL_NETWORK, 75_000, 25),
    Preset("robustness", ROBUSTNESS_POINTS, LARGE_NETWORK, 75_000, 5, companion="paper"),
    Preset("robustness-small", ROBUSTNESS_POINTS, SMALL_NETWORK, 75_000, 25, companion="paper-small"),
    Preset("identifiers", IDENTIFIERS, SMALL_NETWORK, 30_000, 25),
    Preset("longer", (Point("main", (50,), (0.5,), TEN),), LARGE_NETWORK, 150_000, 2, companion="paper"),
    Preset("longer-small", (Point("main", (50,), (0.5,), TEN),), SMALL_NETWORK, 150_000, 5, companion="paper-small"),
    Preset("smoke", (Point("main", (0, 2), (0.0,), (0, 1)),), hidden=(8, 8), steps=1200, population=2, batch=32,
           random_steps=200, episodes=5, grid=100),
)  # fmt: skip

PAPER_PRESETS = {preset.name: preset for preset in _ALL}
QUICK, PAPER, SMOKE = PAPER_PRESETS["quick"], PAPER_PRESETS["paper"], PAPER_PRESETS["smoke"]
