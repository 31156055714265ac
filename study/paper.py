"""Numbers published in the paper that this study repeats, each with the place where it stands.

Rizvi and Tomar, "How Should a Simulation-to-Reality Transfer Budget Be Spent?", First Workshop on Sim2Real and
Classical Control, IROS 2026 (submitted). Facts, quoted as they were printed; the authors' per-run results are at
https://github.com/YTomar79/sim2real_budget and are not shipped here.
"""

from __future__ import annotations

from dataclasses import dataclass

SOURCE = "Rizvi and Tomar, How Should a Simulation-to-Reality Transfer Budget Be Spent? (2026)"
TRUTH, EPISODES, SEEDS = (2.0, 1.5), 20, tuple(range(10))
"""The hidden plant and the start states (Sec. II)."""

BEST = -337.0
"""Mean return of the best cell, n = 50 and w = 0 (Table I); "short of an optimally controlled pendulum" (Sec. IV-D)."""

URL = "https://github.com/YTomar79/sim2real_budget"


@dataclass(frozen=True)
class PublishedMean:
    """Mean return of a cell over ten seeds."""

    n: int
    w: float
    mean: float
    place: str


@dataclass(frozen=True)
class PublishedContrast:
    """Mean return of cell a = (n, w) minus that of cell b, with its 95 % interval where one was printed."""

    a: tuple[int, float]
    b: tuple[int, float]
    mean: float
    interval: tuple[float, float] | None
    place: str


MEANS = (
    PublishedMean(0, 0.0, -771.0, "Sec. III-A"),
    PublishedMean(0, 0.2, -717.0, "Sec. III, Fig. 1 text"),
    PublishedMean(0, 0.5, -764.0, "Sec. III-A"),
    PublishedMean(5, 0.0, -420.0, "Sec. III, 'about'"),
    PublishedMean(10, 0.0, -344.0, "Sec. III"),
    PublishedMean(50, 0.0, -337.0, "Table I"),
)

CONTRASTS = (
    PublishedContrast((10, 0.0), (0, 0.0), 427.0, (407.0, 448.0), "Sec. III"),
    PublishedContrast((0, 0.2), (0, 0.0), 54.0, (-4.0, 114.0), "Sec. III"),
    PublishedContrast((0, 0.0), (0, 0.5), -7.0, (-34.0, 19.0), "Sec. III"),
    PublishedContrast((50, 0.0), (0, 0.0), 434.0, None, "Table I, Δbud"),
    PublishedContrast((50, 0.0), (50, 0.5), 179.0, None, "Table I, Δwide"),
)

ID_ERROR = {0: 1.12, 50: 0.64}
"""Mean ||theta_hat - theta*|| by budget (Sec. III)."""
