"""What trials come to: returns over seeds, and contrasts that were fixed before any agent was trained."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.statistics import Contrast, holm, paired_t, sem, student

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a condition came to: returns (S,) of its seeds, each a mean over the seed's start states, and optima (S,)
    from the same start states."""

    seeds: tuple[int, ...]
    returns: Array
    optima: Array

    @property
    def mean(self) -> Contrast:
        """The mean with Student's interval over seeds."""
        return student(float(np.mean(self.returns)), sem(self.returns), len(self.returns))

    @property
    def median(self) -> float:
        """Single failed trainings do not move it."""
        return float(np.median(self.returns))

    @property
    def gap(self) -> float:
        """J(optimum) - J(agent) from the same start states."""
        return float(np.mean(self.optima - self.returns))

    def less(self, other: Outcome) -> Array:
        """The differences (S,) over the seeds that both have."""
        shared = sorted(set(self.seeds) & set(other.seeds))
        one, two = (own.returns[[own.seeds.index(seed) for seed in shared]] for own in (self, other))
        return np.asarray(one - two)


@dataclass(frozen=True)
class PlannedContrast:
    """A pre-registered contrast: J(a) - J(b) at a plant, with n rollouts, over matched seeds.

    median: of the differences; p: Holm's over the whole family
    """

    plant: str
    sensing: str
    n: int
    a: str
    b: str
    contrast: Contrast
    median: float
    p: float

    @property
    def certain(self) -> bool:
        """Whether it stands after Holm."""
        return self.p < 0.05


Place = tuple[str, str, int, str, str]
"""Plant, sensing, n, a and b of a contrast."""


def planned_contrasts(family: Iterable[tuple[Place, Outcome, Outcome]]) -> tuple[PlannedContrast, ...]:
    """The contrasts of a family, in its order."""
    differences = {place: one.less(other) for place, one, other in family}
    found = {place: paired_t(d, np.zeros_like(d)) for place, d in differences.items()}
    adjusted = holm({place: contrast.p for place, contrast in found.items()})
    return tuple(
        PlannedContrast(*place, contrast, float(np.median(differences[place])), adjusted[place])
        for place, contrast in found.items()
    )
