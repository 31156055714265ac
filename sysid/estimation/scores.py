"""Score tests: by how much each effect of the catalogue would lower the deviance, before any is fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from sysid.estimation.prediction_error import Fit
from sysid.physics.candidates import Candidate, candidates
from sysid.physics.effects import CATALOGUE, Effect
from sysid.physics.ops import Array

VISIBLE = 1e-3
"""|z_perp| / |z| below which the parameters that are free already absorb an effect."""
SEPARATE = 1e-6
"""Squared length below which a direction in the space of an effect's magnitudes (each of unit length) counts as 0."""


@dataclass(frozen=True, eq=False)
class Score:
    """The score test of one effect that the model lacks.

        LM = (z_perp'e)^2 / |z_perp|^2

    z is the effect's sensitivity, whitened by the filter; z_perp is what the free parameters cannot absorb of it.

    lm         expected decrease of the deviance, at the best of the effect's shapes
    shapes     number of shapes that were tried
    sizes, sd  expected magnitudes, counted from neutral, and their standard deviations
    z          z_perp (2 M, q) at the best shape
    visible    whether z_perp is not 0; absorbed: whether z_perp is 0 although z is not
    """

    name: str
    lm: float
    shapes: int
    best: Candidate
    sizes: tuple[float, ...]
    sd: tuple[float, ...]
    z: Array
    visible: bool
    absorbed: bool

    @property
    def numbers(self) -> int:
        """The number of parameters that the effect brings."""
        return len(self.best.neutral.parameters)

    def merit(self, each: float) -> float:
        """The decrease of the deviance that is expected beyond the effect's `price`."""
        return self.lm - price(self.name, each, self.shapes)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns (2 M, q) that span how the effect can change the innovations."""
        return np.linalg.qr(self.z)[0]


def scores(fit: Fit, names: Iterable[str] | None = None) -> dict[str, Score]:
    """Score tests of all effects that the fitted model may lack, or of those in `names`.

    Where the actuator's damping is free, effects that brake as it does are left out.
    """
    by_effect, braked = (
        candidates(fit.model, partial(fit.samples.extent, fit.model), names),
        fit.model.damping in fit.names,
    )
    tested = (score(fit, tried) for name, tried in by_effect.items() if not (braked and CATALOGUE[name].brakes))
    return {score.name: score for score in tested if score is not None}


def score(fit: Fit, tried: Sequence[Candidate]) -> Score | None:
    """The score test of an effect at its best candidate; None if the model runs away with the effect."""
    effects = [probe for candidate in tried for probe in candidate.probes]
    sizes = [size for candidate in tried for size in candidate.sizes]
    owners = [k for k, candidate in enumerate(tried) for _ in candidate.probes]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        G, R = fit.linearised.effect_changes(effects, sizes)
    if not (np.all(np.isfinite(G)) and np.all(np.isfinite(R))):
        return None
    rows = np.ascontiguousarray(fit.filter.whiten(G, R).T)
    length = np.linalg.norm(rows, axis=1)
    for _ in range(2):
        rows = rows - (rows @ fit.basis) @ fit.basis.T
    best: Score | None = None
    for k, candidate in enumerate(tried):
        indices = np.array([i for i, owner in enumerate(owners) if owner == k], dtype=int)
        score = _tested(fit.e, candidate, rows[indices].T, length[indices], len(tried))
        if best is None or score.lm > best.lm:
            best = score
    return best


def _tested(e: Array, candidate: Candidate, z: Array, length: Array, shapes: int) -> Score:
    """The score test of one candidate; a size on the wrong side of its bound explains nothing (lm = 0)."""
    beside = np.linalg.norm(z, axis=0)
    seen = (beside > VISIBLE * length) & (length > 1e-6)
    q = z.shape[1]
    sizes, sd, lm = np.zeros(q), np.full(q, math.inf), 0.0
    if np.any(seen):
        unit = z[:, seen] / beside[seen]
        size, V = np.linalg.eigh(unit.T @ unit)
        V = V[:, size > SEPARATE] / np.sqrt(size[size > SEPARATE])
        along = V.T @ (unit.T @ e)
        lm = float(along @ along)
        sizes[seen] = V @ along / beside[seen]
        sd[seen] = np.sqrt(np.sum(V**2, axis=1)) / beside[seen]
        if candidate.side and sizes[0] * candidate.side < 0.0:
            lm = 0.0
    visible = bool(np.any(seen))
    absorbed = not visible and bool(np.any(length > 1e-6))
    return Score(candidate.name, lm, shapes, candidate, tuple(sizes.tolist()), tuple(sd.tolist()), z, visible, absorbed)


def collinearity(a: Score, b: Score) -> float:
    """The smallest cosine between the spaces in which two effects change the innovations; 0 for unequal dimensions."""
    if not a.visible or not b.visible or a.z.shape != b.z.shape:
        return 0.0
    return float(np.linalg.svd(a.basis.T @ b.basis, compute_uv=False)[-1])


def price(effect: str | Effect, each: float, shapes: int = 1) -> float:
    """The decrease of the deviance that an effect has to bring: `each` for each of its numbers, and more for its rarity
    and for the choice among shapes."""
    instance = CATALOGUE[effect]() if isinstance(effect, str) else effect
    return each * len(instance.parameters) + 2.0 * instance.rarity + 2.0 * math.log(shapes)
