"""Elimination: the starts of windows taken out of a linearised least-squares problem, and their steps put back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Linearisation(NamedTuple):
    """Residuals e (K, R) of K windows, and their derivatives S_x (K, R, 2), S_p (K, R, P) with respect to the windows'
    starts and to P parameters."""

    e: Array
    S_x: Array
    S_p: Array


@dataclass(frozen=True, eq=False)
class Reduced:
    """A linearisation with every window's start eliminated: what of e and S_p lies beside the columns of S_x.

    e (K, R), S (K, R, P), directions (K, R, 2) an orthonormal basis Q of S_x = Q R,
    triangle (K, 2, 2) its R
    """

    e: Array
    S: Array
    directions: Array
    triangle: Array

    @property
    def information(self) -> Array:
        """S'S (P, P)."""
        S = self.S.reshape(self.e.size, self.S.shape[-1])
        information: Array = S.T @ S
        return information

    @property
    def gradient(self) -> Array:
        """S'e (P,)."""
        gradient: Array = self.S.reshape(self.e.size, self.S.shape[-1]).T @ self.e.ravel()
        return gradient


def without(directions: Array, columns: Array) -> Array:
    """Columns (K, R, Q) less their part along the orthonormal directions (K, R, 2)."""
    for _ in range(2):  # once more takes out what rounding left
        columns = columns - directions @ (np.swapaxes(directions, -1, -2) @ columns)
    return columns


def reduce(lin: Linearisation) -> Reduced:
    """Eliminate the windows' starts (Schur complement by QR, so that small informations survive)."""
    # a tiny prior keeps R regular where a window does not see its start (speeds alone)
    directions, triangle = np.linalg.qr(lin.S_x)
    both = without(directions, np.concatenate([lin.e[..., None], lin.S_p], axis=-1))
    return Reduced(both[..., 0], both[..., 1:], directions, triangle)


def start_step(lin: Linearisation, reduced: Reduced, dp: Array) -> Array:
    """The step of the starts (K, 2) that goes with dp; at most half a radian and three times that a second."""
    right = np.swapaxes(reduced.directions, -1, -2) @ (lin.e - lin.S_p @ dp)[..., None]
    R = reduced.triangle
    size = np.abs(np.stack([R[:, 0, 0], R[:, 1, 1]], axis=-1))
    known = size > 1e-9
    R = R + np.where(known, 0.0, 1.0)[..., None] * np.eye(2)
    dx = np.where(known, np.linalg.solve(R, right)[..., 0], 0.0)
    return np.clip(dx, [-0.5, -3.0], [0.5, 3.0])
