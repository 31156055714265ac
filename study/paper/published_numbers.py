"""What the paper says: cell means, contrasts (Table I is made of them) and claims, each with the place where it stands.

Rizvi and Tomar, "How Should a Simulation-to-Reality Transfer Budget Be Spent?", First Workshop on Sim2Real and
Classical Control, IROS 2026 (submitted). Where the text prints a number it stands here as printed. Means, errors and
medians of cells, and errors of contrasts, are aggregates of the authors' per-run files (results/*.csv at URL), which
are not shipped here; `study.paper.finished_runs` reads them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from study.formatting import number
from study.pipeline.tables import read_table

SOURCE = "Rizvi and Tomar, How Should a Simulation-to-Reality Transfer Budget Be Spent? (2026)"
URL = "https://github.com/YTomar79/sim2real_budget"
SEEDS = tuple(range(10))
"""Of the main sweep (Sec. II-C); its episodes, layers and steps are those of the preset `paper`."""


class Spot(NamedTuple):
    """A cell of the sweep without its seed: operating point, rollouts n, training width w."""

    point: str
    n: int
    w: float

    def __str__(self) -> str:
        point = "" if self.point == "main" else f"{self.point.replace('_', ' ')}, "
        return f"{point}n = {self.n}, w = {self.w:g}"


class CellSummary(NamedTuple):
    """Return of a cell over its seeds."""

    mean: float
    sem: float
    median: float
    seeds: int

    @property
    def with_error(self) -> str:
        """As "−338 ± 9"; one seed has no error."""
        return number(self.mean) + ("" if math.isnan(self.sem) else f" ± {self.sem:.0f}")

    def __str__(self) -> str:
        return f"{self.with_error} ({number(self.median)})"


@dataclass(frozen=True)
class PublishedPoint:
    """An operating point: its name in print, and its file."""

    label: str
    file: str


POINTS = {
    "main": PublishedPoint("Main (2.0, 1.5), 1.0 rad/s", "summary.csv"),
    "small_gap": PublishedPoint("Small gap (1.5, 1.2)", "exp_gap_1.5_1.2.csv"),
    "large_gap": PublishedPoint("Large gap (2.5, 2.0)", "exp_gap_2.5_2.0.csv"),
    "low_noise": PublishedPoint("Low noise, 0.5 rad/s", "exp_noise_0.5.csv"),
    "high_noise": PublishedPoint("High noise, 2.0 rad/s", "exp_noise_2.0.csv"),
    "prior_range": PublishedPoint("Prior range [0.3, 3.0]²", "exp_priorDR.csv"),
}
"""The operating points by the names of the presets, in the order of Table I, then the baseline of Sec. III-A."""


@dataclass(frozen=True)
class PublishedCell:
    """Return of a cell over its seeds: mean, standard error, median; `printed` is its mean where the text has one."""

    point: str
    n: int
    w: float
    mean: float
    sem: float
    median: float
    seeds: int
    printed: float | None
    place: str

    @property
    def spot(self) -> Spot:
        return Spot(self.point, self.n, self.w)

    @property
    def summary(self) -> CellSummary:
        return CellSummary(self.mean, self.sem, self.median, self.seeds)


@dataclass(frozen=True)
class PublishedContrast:
    """Return of cell a minus that of cell b over the same seeds.

    mean and interval [low, high] (95 %, paired bootstrap) are as printed where `printed`, else computed from the files;
    error is the standard error of the paired difference, from the files; significant: what the paper says of it.
    """

    label: str
    a_point: str
    a_n: int
    a_w: float
    b_point: str
    b_n: int
    b_w: float
    mean: float
    low: float
    high: float
    error: float
    seeds: int
    significant: bool
    printed: bool
    place: str

    @property
    def a(self) -> Spot:
        return Spot(self.a_point, self.a_n, self.a_w)

    @property
    def b(self) -> Spot:
        return Spot(self.b_point, self.b_n, self.b_w)


HERE = Path(__file__).parent

CELLS = {cell.spot: cell for cell in read_table(PublishedCell, HERE / "published_cells.csv", "published cells")}
"""Every published cell: those of the main sweep are Fig. 1, the others are in the files."""

DIFFERENCES = tuple(read_table(PublishedContrast, HERE / "published_contrasts.csv", "published contrasts"))
"""Every contrast that the paper calls significant or not."""

BASELINE = Spot("prior_range", 0, 0.5)
"""The prior-range baseline: no data, trained over all that is plausible."""


ID_ERRORS = {
    "main": {0: 1.12, 5: 0.858, 10: 0.845, 25: 0.642, 50: 0.64},
    "small_gap": {0: 0.539, 10: 0.604, 50: 0.408},
    "large_gap": {0: 1.803, 10: 0.842, 50: 0.426},
    "low_noise": {0: 1.118, 5: 0.707, 10: 0.527, 25: 0.492, 50: 0.458},
    "high_noise": {0: 1.118, 5: 1.100, 10: 0.980, 25: 0.833, 50: 0.833},
}
"""Mean ||theta_hat - theta*|| by budget; 1.12 and 0.64 are printed (Sec. III), the rest is of the files."""

QUOTES = {
    "starts": ("each seed uses its own fixed set of evaluation initial conditions", "Sec. II-C"),
    "rate": ("the identification error falls roughly as 1/√n", "Sec. II-B"),
    "bias": (
        "the additive sensor noise, which also enters the one-step predictor's inputs and biases the least-squares fit",
        "Sec. III",
    ),
    "floor": (
        "Identification reaches its floor by about five rollouts at sigma = 0.5, but needs closer to fifty at "
        "sigma = 2.0",
        "Sec. III-B",
    ),
    "plateau": ("every cell from n = 10 upward sits near \N{MINUS SIGN}340", "Sec. III"),
    "monotone": ("moving right (widening the randomization band ...) never improves return", "Sec. III"),
    "undertraining": ("a wide band changes the effective task and may need more than 75 000 steps", "Sec. IV-D"),
}
"""What is claimed beside the table: words and place."""
