"""Score tests: what every effect of the catalogue promises at one fit, before any is fitted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from sysid.estimation.prediction_error import Fit
from sysid.physics.candidates import Alternative, candidates
from sysid.physics.effects import CATALOGUE, Effect
from sysid.physics.ops import Array

VISIBLE = 1e-3
"""|z_perp| / |z| below which an effect is absorbed by the parameters that are free already."""
SEPARATE = 1e-6
"""Share of the largest squared length below which a direction of an effect's magnitudes is none."""


@dataclass(frozen=True, eq=False)
class Score:
    """What the fit says of an effect that the model lacks.

        LM = (z_perp'e)^2 / |z_perp|^2,   z whitened by the filter, z_perp its part beside the free parameters'

    lm         expected decrease of the deviance, the best over the effect's shapes
    shapes     how many shapes were tried
    sizes, sd  expected magnitudes from neutral and their standard deviations
    z          (2 M, q) z_perp at the best shape
    visible    whether it moves the readings beside the free parameters at all; absorbed: only as those do
    """

    name: str
    lm: float
    shapes: int
    best: Alternative
    sizes: tuple[float, ...]
    sd: tuple[float, ...]
    z: Array
    visible: bool
    absorbed: bool

    @property
    def numbers(self) -> int:
        """How many parameters the effect brings."""
        return len(self.best.neutral.parameters)

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns (2 M, q) of what it can do to the innovations."""
        return np.linalg.qr(self.z)[0]


def scores(fit: Fit, names: Iterable[str] | None = None) -> dict[str, Score]:
    """Score tests of all effects that the fitted model may lack, or of those named.

    What brakes as the actuator's damping does is none of them where that is free.
    """
    found, braked = candidates(fit.model, partial(fit.samples.extent, fit.model), names), fit.model.damping in fit.names
    tested = (score(fit, own) for name, own in found.items() if not (braked and CATALOGUE[name].brakes))
    return {score.name: score for score in tested if score is not None}


def score(fit: Fit, alternatives: Sequence[Alternative]) -> Score | None:
    """The score test of an effect by its best alternative; None where the model runs away with it."""
    effects = [probe for alternative in alternatives for probe in alternative.probes]
    sizes = [size for alternative in alternatives for size in alternative.sizes]
    owners = [k for k, alternative in enumerate(alternatives) for _ in alternative.probes]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        G, R = fit.linearised.effect_changes(effects, sizes)
    if not (np.all(np.isfinite(G)) and np.all(np.isfinite(R))):
        return None
    rows = np.ascontiguousarray(fit.filter.whiten(G, R).T)
    length = np.linalg.norm(rows, axis=1)
    for _ in range(2):
        rows = rows - (rows @ fit.basis) @ fit.basis.T
    best: Score | None = None
    for k, alternative in enumerate(alternatives):
        own = np.array([i for i, owner in enumerate(owners) if owner == k], dtype=int)
        score = _tested(fit.e, alternative, rows[own].T, length[own], len(alternatives))
        if best is None or score.lm > best.lm:
            best = score
    return best


def _tested(e: Array, alternative: Alternative, z: Array, length: Array, shapes: int) -> Score:
    """The test of one way to have the effect; a size on the wrong side of its bound explains nothing."""
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
        if alternative.side and sizes[0] * alternative.side < 0.0:
            lm = 0.0
    visible = bool(np.any(seen))
    absorbed = not visible and bool(np.any(length > 1e-6))
    return Score(
        alternative.name, lm, shapes, alternative, tuple(sizes.tolist()), tuple(sd.tolist()), z, visible, absorbed
    )


def alikeness(a: Score, b: Score) -> float:
    """The smallest cosine between the spaces that two effects move the innovations in; 0 for unequal dimensions."""
    if not a.visible or not b.visible or a.z.shape != b.z.shape:
        return 0.0
    return float(np.linalg.svd(a.basis.T @ b.basis, compute_uv=False)[-1])


def price(effect: str | Effect, each: float, shapes: int = 1) -> float:
    """Decrease of the deviance that an effect, or that of a name, has to bring: for its numbers, its rarity and the
    shapes tried."""
    own = CATALOGUE[effect]() if isinstance(effect, str) else effect
    return each * len(own.parameters) + 2.0 * own.rarity + 2.0 * math.log(shapes)
