"""Statistics over matched seeds: the paired bootstrap of the paper, and what stands up to t and Holm.

    d_s = a_s - b_s,   s over the seeds that both cells share
    bootstrap   the 2.5 % and 97.5 % quantiles of mean(d*), d* drawn from d with replacement, 20,000 times
    paired t    mean(d) +- t sem(d),   t the 97.5 % quantile of Student's t with S - 1 degrees of freedom
    Welch       mean(a) - mean(b) +- t sqrt(sem(a)^2 + sem(b)^2), for cells that share nothing
    Holm        p-values of a family, raised for how many were looked at

A seed fixes the measurement, the training streams and the start states of a run, so pairing removes what these share.
Sources: paper, Sec. II-C; Efron & Tibshirani, "An Introduction to the Bootstrap" (1993), Ch. 13; Welch, Biometrika 34
(1947) 28.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtr, stdtrit

from study.formatting import bracketed, interval, number, signed
from sysid import InvalidInput
from sysid.physics.ops import Array

DRAWN_AT_ONCE = 1_000_000
"""Numbers that a bootstrap holds at a time, 8 bytes each."""


@dataclass(frozen=True)
class Contrast:
    """A mean difference over `seeds` matched seeds with its interval [low, high].

    p: how often chance alone would give one as far from zero, where the method knows; nan for a bootstrap.
    """

    mean: float
    low: float
    high: float
    seeds: int
    p: float = math.nan

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0.0 or self.high < 0.0

    @property
    def interval(self) -> str:
        """The interval alone, of a change."""
        return interval(self.low, self.high, write=signed)

    @property
    def level(self) -> str:
        """As a level is read, without a plus sign; the number alone where one seed says nothing of its interval."""
        return bracketed(self.mean, self.low, self.high) if math.isfinite(self.low) else number(self.mean)

    def __str__(self) -> str:
        return bracketed(self.mean, self.low, self.high, write=signed)


def paired_bootstrap(
    a: ArrayLike, b: ArrayLike, rng: np.random.Generator | None = None, resamples: int = 20_000
) -> Contrast:
    """The contrast mean(a - b) of two cells, a (S,) and b (S,) in the same order of seeds; one seed says nothing.

    rng: by default a fresh one of seed 0, so that a contrast does not depend on which others are made. Raises
    InvalidInput for different or empty shapes and for values that are not finite.
    """
    difference = _difference(a, b)
    mean, seeds = float(np.mean(difference)), len(difference)
    if seeds == 1:
        return Contrast(mean, -math.inf, math.inf, seeds)
    low, high = _interval(difference, np.random.default_rng(0) if rng is None else rng, resamples)
    return Contrast(mean, float(low), float(high), seeds)


def paired_t(a: ArrayLike, b: ArrayLike | None = None, level: float = 0.95) -> Contrast:
    """The same contrast with Student's interval and p; without b, a are the differences. Raises
    InvalidInput as `paired_bootstrap` does."""
    difference = _difference(a, b)
    return student(float(np.mean(difference)), sem(difference), len(difference), level=level)


def student(mean: float, error: float, seeds: int, dof: float | None = None, level: float = 0.95) -> Contrast:
    """The contrast of a mean whose standard error is `error`, with S - 1 degrees of freedom unless told.

    One seed says nothing: its interval is everything.
    """
    dof = seeds - 1 if dof is None else dof
    if not dof > 0.0 or math.isnan(error):
        return Contrast(mean, -math.inf, math.inf, seeds, 1.0)
    reach = float(stdtrit(dof, 0.5 + 0.5 * level)) * error
    if error == 0.0:
        return Contrast(mean, mean, mean, seeds, float(mean == 0.0))
    return Contrast(mean, mean - reach, mean + reach, seeds, 2.0 * float(stdtr(dof, -abs(mean) / error)))


def welch(a: tuple[float, float, int], b: tuple[float, float, int], level: float = 0.95) -> Contrast:
    """The contrast of two cells (mean, sem, seeds) that share nothing; `seeds` is the smaller number."""
    variances = a[1] ** 2, b[1] ** 2
    total = sum(variances)
    weight = sum(v**2 / (s - 1) for v, (_, _, s) in zip(variances, (a, b), strict=True) if s > 1)
    seeds = min(a[2], b[2])
    dof = total**2 / weight if weight > 0.0 else float(seeds - 1)
    return student(a[0] - b[0], math.sqrt(total), seeds, dof, level)


def _difference(a: ArrayLike, b: ArrayLike | None) -> Array:
    a = np.asarray(a, dtype=float)
    b = np.zeros_like(a) if b is None else np.asarray(b, dtype=float)
    if a.ndim != 1 or a.shape != b.shape or a.size == 0:
        raise InvalidInput(f"the cells have shapes {a.shape} and {b.shape}: expected two vectors over the same seeds")
    if not np.all(np.isfinite(a - b)):
        raise InvalidInput("the cells hold NaN or infinity: expected finite returns")
    return a - b


def _interval(samples: Array, rng: np.random.Generator, resamples: int) -> tuple[Array, Array]:
    """Percentile intervals (...,) of the means of samples (..., S), which share the draws."""
    from scipy.stats import bootstrap  # loads for most of a second, in every worker

    batch = max(1, DRAWN_AT_ONCE // samples.size)  # the draws do not depend on it
    options = {"n_resamples": resamples, "method": "percentile", "random_state": rng, "batch": batch}
    return bootstrap((samples,), np.mean, axis=-1, **options).confidence_interval


def bootstrap_coverage(seeds: int, rng: np.random.Generator) -> float:
    """How often such an interval holds the true mean where the differences are normal; below 95 % for few seeds."""
    low, high = _interval(rng.standard_normal((4000, seeds)), rng, 1000)
    return float(np.mean((low <= 0.0) & (high >= 0.0)))


def sem(values: ArrayLike) -> float:
    """Standard error of the mean, sd / sqrt(S) with the sample sd (divided by S - 1); nan for a single value."""
    values = np.asarray(values, dtype=float)
    return float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan


Hypothesis = TypeVar("Hypothesis", bound=Hashable)


def holm(p_values: Mapping[Hypothesis, float]) -> dict[Hypothesis, float]:
    """A family's p-values, each raised so that what stays below alpha may be believed of all of them at once.

        p_(k), k-th smallest of K, times K - k + 1, made monotone

    Holm, "A Simple Sequentially Rejective Multiple Test Procedure", Scand. J. Statist. 6 (1979) 65.
    """
    adjusted, floor = {}, 0.0
    for rank, key in enumerate(sorted(p_values, key=lambda key: p_values[key])):
        floor = max(floor, min(1.0, (len(p_values) - rank) * p_values[key]))
        adjusted[key] = floor
    return adjusted
