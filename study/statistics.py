"""Statistics over matched seeds: the paired bootstrap of the paper, and how far its intervals can be trusted.

    d_s = a_s - b_s,   s over the seeds that both cells share
    interval = the 2.5 % and 97.5 % quantiles of mean(d*), d* drawn from d with replacement, 20,000 times

A seed fixes the measurement, the training streams and the start states of a run, so pairing removes what these share.
Source: paper, Sec. II-C; Efron & Tibshirani, "An Introduction to the Bootstrap" (1993), Ch. 13.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid import InvalidInput

Array = NDArray[np.float64]

MINUS = "\N{MINUS SIGN}"
"""What a printed number is negated with."""


@dataclass(frozen=True)
class Contrast:
    """A mean difference over `seeds` matched seeds with its interval [low, high]."""

    mean: float
    low: float
    high: float
    seeds: int
    level: float = 0.95

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0.0 or self.high < 0.0

    def to_dict(self) -> dict[str, float]:
        """Plain data, ready for JSON."""
        return asdict(self)

    def __str__(self) -> str:
        mean, low, high = (f"{round(x) + 0.0:+.0f}".replace("-", MINUS) for x in (self.mean, self.low, self.high))
        return f"{mean} [{low}, {high}]"


def paired_bootstrap(
    a: ArrayLike, b: ArrayLike, rng: np.random.Generator, resamples: int = 20_000, level: float = 0.95
) -> Contrast:
    """The contrast mean(a - b) of two cells, a (S,) and b (S,) in the same order of seeds.

    Raises InvalidInput for different or empty shapes and for values that are not finite.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if a.ndim != 1 or a.shape != b.shape or a.size == 0:
        raise InvalidInput(f"the cells have shapes {a.shape} and {b.shape}: expected two vectors over the same seeds")
    difference = a - b
    if not np.all(np.isfinite(difference)):
        raise InvalidInput("the cells hold NaN or infinity: expected finite returns")
    low, high = _interval(difference[None], rng, resamples, level)
    return Contrast(float(np.mean(difference)), float(low[0]), float(high[0]), len(difference), level)


def _interval(samples: Array, rng: np.random.Generator, resamples: int, level: float) -> tuple[Array, Array]:
    """Percentile intervals (R,) of the means of samples (R, S); all rows share the draws."""
    seeds = samples.shape[1]
    draws = rng.integers(0, seeds, size=(resamples, seeds))
    counts = np.stack([np.sum(draws == s, axis=1) for s in range(seeds)])
    means = samples @ (counts / seeds)
    low, high = np.quantile(means, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=1)
    return low, high


def bootstrap_coverage(
    seeds: int, rng: np.random.Generator, trials: int = 4000, resamples: int = 1000, level: float = 0.95
) -> float:
    """How often such an interval holds the true mean where the differences are normal; below `level` for few seeds."""
    low, high = _interval(rng.standard_normal((trials, seeds)), rng, resamples, level)
    return float(np.mean((low <= 0.0) & (high >= 0.0)))


def sem(values: ArrayLike) -> float:
    """Standard error of the mean, sd / sqrt(S) with the sample sd (divided by S - 1); nan for a single value."""
    values = np.asarray(values, dtype=float)
    return float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
