"""The screen: a score test of every candidate at once, about one fit of the model that is tested."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.stats import chi2, f

from sysid.diagnosis.candidates import Alternative, candidates
from sysid.identify.gauss_newton import Fit
from sysid.planning.directions import Directions
from sysid.records import Array, extent_of
from sysid.response import Index, stretches

_VISIBLE = 1e-3
"""|z_perp| / |z| below which an effect is absorbed by the parameters that are free already."""

_DRAWS = 4000


@dataclass(frozen=True, eq=False)
class Score:
    """What the screen says of one candidate.

    lm          (z_perp'e)^2 / (s^2 |z_perp|^2), for q magnitudes their joint form: chi-square with q degrees
    p_value     of the largest over the candidate's shapes, robust to coloured residuals
    sizes       expected magnitudes, each from neutral, at the best shape
    sd          their standard deviations
    others      the other ways to try the effect, where they are few
    visible     whether the effect moves the readings beside the fitted parameters at all
    absorbed    whether it moves them, but as the fitted parameters do
    z           (rows, q) z_perp at the best shape
    """

    name: str
    lm: float
    p_value: float
    best: Alternative | None
    sizes: tuple[float, ...]
    sd: tuple[float, ...]
    visible: bool
    z: Array
    others: tuple[Alternative, ...] = ()
    absorbed: bool = False

    def start(self) -> dict[str, float]:
        """Numbers of the effect to begin a fit with, by field."""
        assert self.best is not None
        effect = self.best.at(self.sizes)
        return {k: float(p.value) for k, p in effect.parameters.items()}


def screen(
    fit: Fit, names: Iterable[str] | None = None, directions: Directions | None = None
) -> tuple[dict[str, Score], Directions]:
    """Score tests of all candidates (or those named) that the fitted model may lack."""
    directions = directions or Directions(fit)
    clusters = fit.response.clusters()
    found = candidates(fit.model, extent_of(fit.response.records), names)
    scores = {name: score(directions, alternatives, clusters) for name, alternatives in found.items()}
    return scores, directions


def score(directions: Directions, alternatives: tuple[Alternative, ...], clusters: Index) -> Score:
    """The best of an effect's alternatives."""
    best, units, moved = None, [], False
    for alternative, z, size in directions.each(alternatives):
        test = Test.of(directions, z, size, clusters, alternative.side)
        moved = moved or bool(np.any(size > 0.0))
        if test.rank == 0:
            continue
        if len(alternatives) <= 16:
            units.append(test.basis)
        if best is None or test.lm > best[0].lm:
            best = (test, alternative, z)
    if best is None:
        name = alternatives[0].name
        nothing = np.zeros((directions.e.size, 0))
        return Score(name, 0.0, 1.0, alternatives[0], (), (), False, nothing, absorbed=moved)
    test, alternative, z = best
    p = min(1.0, _tries(units, len(alternatives), test.rank) * test.p_value)
    others = alternatives if 1 < len(alternatives) <= 8 else ()
    return Score(alternative.name, test.lm, p, alternative, test.sizes, test.sd, True, z, others)


@dataclass(frozen=True, eq=False)
class Test:
    """A score test of directions z (rows, q), of which `rank` are visible; `basis` (rows, rank) spans them."""

    lm: float
    p_value: float
    rank: int
    sizes: tuple[float, ...]
    sd: tuple[float, ...]
    basis: Array

    @classmethod
    def of(cls, directions: Directions, z: Array, size: Array, clusters: Index, side: int = 0) -> Test:
        """The test about a fit. lm takes s^2 from the null's residuals; the p-value is that of the Wald form, whose s^2
        is that of the residuals once the effect is out of them, inflated by the ratio of the clustered variance
        to the plain one where that is above 1: what else is missing then counts as coloured noise. `side` is that of
        the effect from neutral on which it can be (0: both).
        """
        e, variance = directions.e, directions.fit.variance
        length = np.linalg.norm(z, axis=0)
        seen = length > _VISIBLE * np.maximum(size, 1e-300)
        unit = z[:, seen] / np.maximum(length[seen], 1e-300)
        q = unit.shape[1]
        if q == 0:
            return cls(0.0, 1.0, 0, (0.0,) * z.shape[1], (np.inf,) * z.shape[1], unit)
        gram, vectors = eigh(unit.T @ unit)
        keep = gram > 1e-6
        basis = unit @ (vectors[:, keep] / np.sqrt(gram[keep]))
        U = basis.T @ e
        rank = int(basis.shape[1])
        lm = float(U @ U) / variance
        rest = e - basis @ U
        after = float(rest @ rest) / max(1, directions.fit.degrees - rank)
        # along the direction of the score, which is what the statistic measures
        towards = U / max(float(np.linalg.norm(U)), 1e-300)
        sums = stretches(((basis @ towards) * rest)[:, None], clusters)
        G = len(sums)
        inflation = max(1.0, float(np.sum(sums**2)) * G / max(1, G - 1) / after)
        wald = float(U @ U) / after / inflation
        coefficient = np.zeros(z.shape[1])
        mixed = vectors[:, keep] / np.sqrt(gram[keep])
        coefficient[seen] = (mixed @ U) / length[seen]
        sd = np.full(z.shape[1], np.inf)
        sd[seen] = np.sqrt(variance * np.sum(mixed**2, axis=1)) / length[seen]
        p = float(f.sf(wald / rank, rank, max(1, G - 1))) if inflation > 1.5 else float(chi2.sf(wald, rank))
        if side and q == 1:
            p = 0.5 * p if side * coefficient[0] > 0.0 else 1.0
            lm = lm if side * coefficient[0] > 0.0 else 0.0
        return cls(lm, p, rank, tuple(coefficient.tolist()), tuple(sd.tolist()), basis)


def _tries(units: list[Array], count: int, rank: int) -> float:
    """How many independent tests the largest of `count` dependent ones is worth, by draws from the null."""
    if count <= 1:
        return 1.0
    if len(units) < count:
        return float(count)
    stacked = np.concatenate(units, axis=1)
    size, vectors = eigh(stacked.T @ stacked)
    draws = np.random.default_rng(0).standard_normal((_DRAWS, len(size))) * np.sqrt(np.maximum(size, 0.0))
    scores = (draws @ vectors.T) ** 2
    edges = np.cumsum([0, *(u.shape[1] for u in units)])[:-1]
    largest = np.max(np.add.reduceat(scores, edges, axis=1), axis=1)
    level = float(np.quantile(largest, 0.95))
    return float(np.clip(0.05 / chi2.sf(level, rank), 1.0, count))


def alikeness(a: Score, b: Score) -> float:
    """cos of the largest angle between the directions of the candidate with fewer and the span of the other's: 1 where
    this log cannot tell them apart, or where one contains the other."""
    Qa, Qb = _spanned(a.z), _spanned(b.z)
    if Qa.shape[1] == 0 or Qb.shape[1] == 0:
        return 0.0
    return min(1.0, float(np.linalg.norm(Qa.T @ Qb, -2)))


def _spanned(z: Array) -> Array:
    """Orthonormal columns that span those of z (rows, q)."""
    U, size, _ = np.linalg.svd(z / np.maximum(np.linalg.norm(z, axis=0), 1e-300), full_matrices=False)
    spanned: Array = U[:, size > 1e-6]
    return spanned
