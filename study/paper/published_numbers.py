"""What the paper says: cell means, contrasts, its robustness table and its claims, each with the place where it stands.

Rizvi and Tomar, "How Should a Simulation-to-Reality Transfer Budget Be Spent?", First Workshop on Sim2Real and
Classical Control, IROS 2026 (submitted). Where the text prints a number it stands here as printed. Means, errors and
medians of cells, and errors of contrasts, are aggregates of the authors' per-run files (results/*.csv at URL), which
are not shipped here; `study.paper.published_runs` reads them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

SOURCE = "Rizvi and Tomar, How Should a Simulation-to-Reality Transfer Budget Be Spent? (2026)"
URL = "https://github.com/YTomar79/sim2real_budget"
EPISODES, SEEDS, HIDDEN, STEPS = 20, tuple(range(10)), (256, 256), 75_000
"""Evaluation episodes a run, seeds of the main sweep, layer sizes and training steps (Sec. II-C and the code)."""


class Spot(NamedTuple):
    """A cell of the sweep without its seed: operating point, rollouts n, training width w."""

    point: str
    n: int
    w: float


@dataclass(frozen=True)
class PublishedPoint:
    """An operating point: its name in print, the hidden plant (m [kg], l [m]), the speed noise [rad/s], its file."""

    label: str
    truth: tuple[float, float]
    sigma: float
    file: str


POINTS = {
    "main": PublishedPoint("Main (2.0, 1.5), 1.0 rad/s", (2.0, 1.5), 1.0, "summary.csv"),
    "small_gap": PublishedPoint("Small gap (1.5, 1.2)", (1.5, 1.2), 1.0, "exp_gap_1.5_1.2.csv"),
    "large_gap": PublishedPoint("Large gap (2.5, 2.0)", (2.5, 2.0), 1.0, "exp_gap_2.5_2.0.csv"),
    "low_noise": PublishedPoint("Low noise, 0.5 rad/s", (2.0, 1.5), 0.5, "exp_noise_0.5.csv"),
    "high_noise": PublishedPoint("High noise, 2.0 rad/s", (2.0, 1.5), 2.0, "exp_noise_2.0.csv"),
    "prior_range": PublishedPoint("Prior range [0.3, 3.0]²", (2.0, 1.5), 1.0, "exp_priorDR.csv"),
}
"""The operating points by the names of the presets, in the order of Table I, then the baseline of Sec. III-A."""


@dataclass(frozen=True)
class PublishedCell:
    """Return of a cell over its seeds: mean, standard error, median; `printed` is its mean where the text has one."""

    spot: Spot
    mean: float
    sem: float
    median: float
    seeds: int
    printed: float | None = None
    place: str = "Fig. 1"


PRINTED = {
    Spot("main", 0, 0.0): (-771.0, "Sec. III-A"),
    Spot("main", 0, 0.2): (-717.0, "Sec. III"),
    Spot("main", 0, 0.5): (-764.0, "Sec. III-A"),
    Spot("main", 5, 0.0): (-420.0, "Sec. III, 'about'"),
    Spot("main", 10, 0.0): (-344.0, "Sec. III"),
    Spot("main", 50, 0.0): (-337.0, "Table I"),
    Spot("small_gap", 50, 0.0): (-226.0, "Table I"),
    Spot("large_gap", 50, 0.0): (-573.0, "Table I"),
    Spot("low_noise", 50, 0.0): (-341.0, "Table I"),
    Spot("high_noise", 50, 0.0): (-357.0, "Table I"),
    Spot("prior_range", 0, 0.5): (-749.0, "Sec. III-A"),
}
"""Mean returns that the text prints."""

# n, w, then mean, SEM and median of the return over the seeds; the main sweep is Fig. 1, the others are in the files
_TABLE = {
    "main": """
         0 0.0 -770.8 12.0 -768.7    0 0.1 -754.3 16.1 -751.1    0 0.2 -716.9 29.9 -741.9    0 0.3 -732.0 16.0 -724.8
         0 0.5 -763.7 10.1 -775.1    5 0.0 -422.0 44.8 -351.5    5 0.1 -473.1 54.8 -361.3    5 0.2 -457.0 46.1 -387.2
         5 0.3 -475.2 47.9 -414.8    5 0.5 -620.3 42.0 -624.7   10 0.0 -344.0  5.6 -342.0   10 0.1 -348.2  6.9 -343.6
        10 0.2 -371.5 16.7 -356.3   10 0.3 -391.5 29.4 -353.1   10 0.5 -509.5 36.6 -520.1   25 0.0 -338.4  2.6 -335.9
        25 0.1 -351.0  8.6 -336.2   25 0.2 -356.5 11.1 -340.8   25 0.3 -402.3 30.7 -357.1   25 0.5 -514.8 36.9 -487.3
        50 0.0 -336.6  3.6 -335.4   50 0.1 -337.1  4.2 -335.8   50 0.2 -355.8 11.6 -340.8   50 0.3 -360.4 11.1 -356.6
        50 0.5 -515.7 45.1 -494.8""",
    "small_gap": """
         0 0.0 -254.7  4.8 -252.0    0 0.2 -324.6 39.7 -306.3    0 0.5 -337.6 30.1 -376.2   10 0.0 -230.9  6.7 -221.7
        10 0.2 -240.6 13.8 -226.5   10 0.5 -349.9 92.3 -253.3   50 0.0 -226.0  3.3 -225.9   50 0.2 -226.2  3.3 -225.8
        50 0.5 -265.4 27.4 -245.8""",
    "large_gap": """
         0 0.0 -950.4 11.9 -955.7    0 0.2 -909.2  9.8 -908.8    0 0.5 -884.0 12.8 -880.1   10 0.0 -764.8 44.4 -807.1
        10 0.2 -819.8 29.0 -796.4   10 0.5 -830.4 13.7 -831.9   50 0.0 -573.0 28.2 -550.6   50 0.2 -608.2 32.7 -587.1
        50 0.5 -808.0 16.5 -822.7""",
    "low_noise": """
         0 0.0 -769.4 11.8 -773.5    0 0.5 -765.1 18.7 -790.3    5 0.0 -341.4  3.9 -341.4    5 0.5 -638.4 35.7 -664.2
        10 0.0 -341.5  3.9 -341.3   10 0.5 -535.7 46.3 -529.7   25 0.0 -340.4  4.6 -341.3   25 0.5 -632.1 50.0 -643.2
        50 0.0 -340.5  4.6 -341.8   50 0.5 -563.6 33.0 -574.2""",
    "high_noise": """
         0 0.0 -769.4 11.8 -773.5    0 0.5 -765.1 18.7 -790.3    5 0.0 -675.8 93.5 -773.4    5 0.5 -808.1 35.3 -836.6
        10 0.0 -447.8 99.0 -355.2   10 0.5 -734.8 67.5 -697.0   25 0.0 -510.4 90.1 -446.2   25 0.5 -656.9 82.3 -707.8
        50 0.0 -356.9 15.9 -341.6   50 0.5 -463.0 55.3 -391.4""",
    "prior_range": "0 0.5 -749.2 17.5 -747.9",
}


def _cells() -> dict[Spot, PublishedCell]:
    table = {}
    for point, text in _TABLE.items():
        numbers = [float(word) for word in text.split()]
        for n, w, mean, error, median in zip(*(numbers[k::5] for k in range(5)), strict=True):
            spot = Spot(point, int(n), w)
            printed, place = PRINTED.get(spot, (None, "Fig. 1" if point == "main" else POINTS[point].file))
            seeds = 10 if point in ("main", "prior_range") else 5
            table[spot] = PublishedCell(spot, mean, error, median, seeds, printed, place)
    return table


CELLS = _cells()
"""Every published cell."""


@dataclass(frozen=True)
class PublishedContrast:
    """Return of cell a minus that of cell b over the same seeds.

    mean and interval (95 %, paired bootstrap) are as printed where `printed`, else computed from the files; error is
    the standard error of the paired difference, from the files; significant: what the paper says of it.
    """

    label: str
    a: Spot
    b: Spot
    mean: float
    interval: tuple[float, float]
    error: float
    seeds: int
    significant: bool
    printed: bool
    place: str


def _main(a: tuple[int, float], b: tuple[int, float]) -> tuple[Spot, Spot]:
    return Spot("main", *a), Spot("main", *b)


def _contrast(
    label: str,
    spots: tuple[Spot, Spot],
    mean: float,
    interval: tuple[float, float],
    error: float,
    place: str,
    *,
    significant: bool = True,
    printed: bool = False,
) -> PublishedContrast:
    five = spots[0].point not in ("main", "prior_range")
    return PublishedContrast(label, *spots, mean, interval, error, 5 if five else 10, significant, printed, place)


def _robustness(
    point: str, *numbers: tuple[float, tuple[float, float], float]
) -> tuple[PublishedContrast, PublishedContrast]:
    """Delta-budget and delta-wide of a row of Table I."""
    name, best = POINTS[point].label.partition(" (")[0].partition(",")[0].lower(), Spot(point, 50, 0.0)
    budget, wide = numbers
    return (
        _contrast(f"{name}: n = 0 → 50, w = 0", (best, Spot(point, 0, 0.0)), *budget, "Table I, Δbud"),
        _contrast(f"{name}: w = 0.5 → 0, n = 50", (best, Spot(point, 50, 0.5)), *wide, "Table I, Δwide"),
    )


BASELINE = Spot("prior_range", 0, 0.5)
"""The prior-range baseline: no data, trained over all that is plausible."""

DIFFERENCES = (
    _contrast("n = 0 → 10, w = 0", _main((10, 0.0), (0, 0.0)), 427.0, (407.0, 448.0), 11.0, "Sec. III", printed=True),
    _contrast("n = 0 → 50, w = 0", _main((50, 0.0), (0, 0.0)), 434.0, (415.0, 458.0), 11.8, "Table I, Δbud"),
    _contrast("w = 0.5 → 0, n = 5", _main((5, 0.0), (5, 0.5)), 198.0, (61.0, 296.0), 64.2, "Sec. III, 165-198"),
    _contrast("w = 0.5 → 0, n = 10", _main((10, 0.0), (10, 0.5)), 165.5, (101.0, 232.0), 35.1, "Sec. III, 165-198"),
    _contrast("w = 0.5 → 0, n = 25", _main((25, 0.0), (25, 0.5)), 176.4, (113.0, 250.0), 37.1, "Sec. III, 165-198"),
    _contrast("w = 0.5 → 0, n = 50", _main((50, 0.0), (50, 0.5)), 179.0, (104.0, 262.0), 42.9, "Table I, Δwide"),
    _contrast("w = 0.5 → 0, n = 0", _main((0, 0.0), (0, 0.5)), -7.0, (-34.0, 19.0), 14.6, "Sec. III",
              significant=False, printed=True),
    _contrast("w = 0 → 0.2, n = 0", _main((0, 0.2), (0, 0.0)), 54.0, (-4.0, 114.0), 31.7, "Sec. III",
              significant=False, printed=True),
    _contrast("w = 0.2 → 0, n = 5", _main((5, 0.0), (5, 0.2)), 35.0, (11.0, 64.0), 14.3, "Sec. III, 18-35"),
    _contrast("w = 0.2 → 0, n = 10", _main((10, 0.0), (10, 0.2)), 27.5, (5.0, 56.0), 13.8, "Sec. III, 18-35"),
    _contrast("w = 0.2 → 0, n = 25", _main((25, 0.0), (25, 0.2)), 18.1, (3.0, 36.0), 8.8, "Sec. III, 18-35"),
    _contrast("w = 0.2 → 0, n = 50", _main((50, 0.0), (50, 0.2)), 19.2, (5.0, 38.0), 9.0, "Sec. III, 18-35"),
    _contrast("prior range, not w = 0.5, n = 0", (BASELINE, Spot("main", 0, 0.5)), 15.0, (-17.0, 46.0), 17.0,
              "Sec. III-A", significant=False, printed=True),
    _contrast("prior range, not w = 0, n = 0", (BASELINE, Spot("main", 0, 0.0)), 21.6, (-18.0, 61.0), 21.5,
              "Sec. III-A", significant=False),
    _contrast("prior range, not n = 50, w = 0", (BASELINE, Spot("main", 50, 0.0)), -413.0, (-442.0, -385.0), 15.4,
              "Sec. III-A", printed=True),
    *_robustness("small_gap", (29.0, (23.0, 38.0), 4.7), (39.0, (9.0, 94.0), 27.3)),
    _contrast("small gap: w = 0 → 0.5, n = 0", (Spot("small_gap", 0, 0.5), Spot("small_gap", 0, 0.0)),
              -83.0, (-142.0, -23.0), 34.5, "Sec. III-B"),
    *_robustness("large_gap", (377.0, (321.0, 413.0), 27.8), (235.0, (151.0, 299.0), 43.2)),
    _contrast("large gap: w = 0 → 0.5, n = 0", (Spot("large_gap", 0, 0.5), Spot("large_gap", 0, 0.0)),
              66.4, (43.0, 89.0), 13.4, "Sec. III-B"),
    *_robustness("low_noise", (429.0, (412.0, 444.0), 9.1), (223.0, (168.0, 282.0), 32.3)),
    *_robustness("high_noise", (413.0, (368.0, 440.0), 22.2), (106.0, (37.0, 220.0), 56.6)),
)  # fmt: skip
"""Every contrast that the paper calls significant or not. `printed` says that its interval is in the text."""


@dataclass(frozen=True)
class RobustnessRow:
    """A row of Table I as printed: best mean, delta-budget, delta-wide, w* at n = 0; bold: the interval excludes 0."""

    point: str
    best: float
    budget: float
    wide: float
    width_at_zero: str
    bold: tuple[bool, bool, bool]


ROBUSTNESS = (
    RobustnessRow("main", -337.0, 434.0, 179.0, "0", (True, True, False)),
    RobustnessRow("small_gap", -226.0, 29.0, 39.0, "0", (True, True, False)),
    RobustnessRow("large_gap", -573.0, 377.0, 235.0, "> 0", (True, True, True)),
    RobustnessRow("low_noise", -341.0, 429.0, 223.0, "0", (True, True, False)),
    RobustnessRow("high_noise", -357.0, 413.0, 106.0, "0", (True, True, False)),
)
"""Table I; w* is 0 unless a wider band was significantly better (the text has w* = 0.2 at the main point)."""

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
