"""Residuals: what refitted windows leave of the readings, and how it would look if a torque acted beyond the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from sysid.comparison.held_out import Refit
from sysid.effects import Joint, JointEffect
from sysid.identify.gauss_newton import without
from sysid.model import Model
from sysid.ops import Value
from sysid.parameters import parameter
from sysid.records import Array
from sysid.response import propagate

_BLOCK = 4_000_000
"""Numbers (float64) that directions are worked out for at a time."""


@dataclass(frozen=True, eq=False)
class _Push(JointEffect):
    """A constant torque [N m], whatever else the model has."""

    tau: Value = parameter(0.0, unit="N m", neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        """tau."""
        return self.tau


def _on(near: Refit, fit: Refit) -> Array:
    """The states (K, L+1, 2) of windows `near`, at the instants of those of `fit`; finite."""
    paths = [np.zeros((len(r) + 1, 2)) for r in fit.response.records]
    for refitted in (fit, near):
        for w, states in zip(refitted.response.windows, refitted.lin.states, strict=True):
            own = states[w.shared : w.count + 1]
            paths[w.record][w.begin + w.shared : w.begin + w.count + 1] = np.where(np.isfinite(own), own, 0.0)
    found = np.zeros_like(fit.lin.states)
    for i, w in enumerate(fit.response.windows):
        own = paths[w.record][w.begin : w.begin + w.count + 1]
        found[i, : len(own)], found[i, len(own) :] = own, own[-1]
    return found


@dataclass(frozen=True, eq=False)
class Explained:
    """Least squares of residuals e on directions z (rows, Q): coefficients and their sd (Q,), what they explain.

    sum is the decrease of the sum of squares, rank the number of independent directions, p_value that of the F test.
    """

    coefficient: Array
    sd: Array
    sum: float
    p_value: float
    rank: int


class Residuals:
    """Residuals e (rows,) of refitted windows and the intervals (K, L) that they come from.

    theta (its place), theta_dot, time (K, L) at the middle of each interval; scored (K, L): whether it is in the scored
    part of a window. theta and theta_dot are those of shorter windows (`near`), which stay nearer to the readings.
    Windows `without` are left out.
    """

    def __init__(self, fit: Refit, near: Refit, without: Sequence[int] = ()) -> None:
        response, L = fit.response, fit.response.length
        # where the model ran away nothing linear can be said
        steady = np.all(np.isfinite(fit.lin.e), axis=1)
        steady[list(without)] = False
        self.fit, self.response = fit, response
        self.e: Array = np.where(steady[:, None], fit.lin.e, 0.0).ravel()
        self.degrees = max(1, int(np.sum(response.weight[steady] > 0.0)) - 2 * int(np.sum(steady)))
        read = np.asarray(response.weight.any(axis=1)) & steady[:, None]
        self.scored = read[:, 1:] | read[:, :-1]
        self.states = np.where(steady[:, None, None], fit.lin.states, 0.0)
        self.A = np.where(steady[:, None, None, None], fit.lin.A, 0.0)
        along = _on(near, fit)
        middle = 0.5 * (along[:, :L] + along[:, 1:])
        self.theta, self.theta_dot = response.model.plant.place(middle[..., 0]), middle[..., 1]
        self.time = response.time[:, :L] + 0.5 * response.model.dt
        self.push = self._push() * steady[:, None, None]

    @property
    def excess(self) -> float:
        """Sum of squares beyond what noise leaves."""
        return max(0.0, float(self.e @ self.e) - self.degrees)

    def share(self, explained: float, rank: int) -> float:
        """Of the excess, what goes with `explained` beyond what as many numbers explain of noise."""
        chance = 3.0 * math.sqrt(2.0 * self.degrees)
        return min(1.0, max(0.0, explained - rank) / max(self.excess, chance))

    def command(self, lag: int = 0) -> Array:
        """The command (K, L) [N m] of `lag` samples before each interval; 0 before a record, its last one after."""
        found = np.zeros(self.theta.shape)
        for i, w in enumerate(self.response.windows):
            record = self.response.records[w.record]
            u = record.commands
            k = len(record.past) + w.begin + np.arange(self.response.length) - lag
            found[i] = np.where(k >= 0, u[np.clip(k, 0, len(u) - 1)], 0.0)
        return found

    def seen(self, torque: Array) -> Array:
        """Directions z (rows, Q) in which torques (K, L, Q) [N m] at the joint move the readings, beside the windows'
        states; all torques act over the whole windows, their lead included."""
        Q = torque.shape[-1]
        z = np.empty((len(self.e), Q))
        width = max(1, _BLOCK // len(self.e))
        for i in range(0, Q, width):
            block = slice(i, i + width)
            Z = propagate(self.A, self.push[..., None] * torque[:, :, None, block], initial=False)
            slopes = self.response.reading_slopes(np.zeros(0), self.states, Z, np.zeros((Z.shape[-1], 0)))
            slopes = (slopes * self.response.weight[..., None]).reshape(len(Z), -1, Z.shape[-1])
            z[:, block] = self.beside_starts(slopes)
        return z

    def beside_starts(self, slopes: Array) -> Array:
        """Whitened columns (K, R, Q), less what other starts of the windows could produce, as z (rows, Q)."""
        return without(self.fit.basis, slopes).reshape(len(self.e), -1)

    def _push(self) -> Array:
        """Derivative (K, L, 2) of the state after an interval with respect to a torque held over it."""
        size = 1e-4
        held = self.fit.lin.drives[self.response.interval]
        after = [self._after(self.response.model.with_effect(_Push(tau=tau)), held) for tau in (size, -size)]
        return (after[0] - after[1]) / (2.0 * size)

    def _after(self, model: Model, held: Array) -> Array:
        L = self.response.length
        drives = tuple(held[..., j] for j in range(held.shape[-1]))
        after = model.move(self.states[:, :L, 0], self.states[:, :L, 1], drives, self.response.clock[:, :L])
        return np.stack(after, axis=-1)

    def explain(self, z: Array) -> Explained:
        """e regressed on directions z (rows, Q)."""
        length = np.linalg.norm(z, axis=0)
        size = np.maximum(length, 1e-300)
        gram, vectors = np.linalg.eigh((z / size).T @ (z / size))
        keep = gram > 1e-7
        mixed = vectors[:, keep] / np.sqrt(gram[keep])
        basis = (z / size) @ mixed
        U = basis.T @ self.e
        rank, total, explained = int(np.sum(keep)), float(self.e @ self.e), float(U @ U)
        left = max(1, self.degrees - rank)
        variance = max(total - explained, 1e-300) / left
        # whole windows vary by more than their readings where residuals are coloured: something else is missing too
        rest = (self.e - basis @ U).reshape(len(self.fit.starts), -1)
        scores = np.einsum("kr,krq->kq", rest, basis.reshape(*rest.shape, -1)) @ mixed.T
        sd = np.sqrt(np.maximum(variance * np.sum(mixed**2, axis=1), np.sum(scores**2, axis=0))) / size
        return Explained(
            coefficient=(mixed @ U) / size,
            sd=np.where(length > 0.0, sd, np.inf),
            sum=explained,
            p_value=float(fdtrc(rank, left, explained / rank / variance)) if rank else 1.0,
            rank=rank,
        )
