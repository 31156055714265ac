"""Directions: how the readings of a log would move, per unit, if an effect were there (first order about a fit)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from sysid.diagnosis.candidates import Alternative
from sysid.effects import Effect, InputEffect, Joint, JointEffect, OutputEffect
from sysid.identify.gauss_newton import Fit, without
from sysid.model import Model
from sysid.ops import Value
from sysid.records import Array
from sysid.response import Response, propagate

_CHUNK = 4_000_000
"""Numbers (float64) that one block of directions may hold."""


@dataclass(frozen=True, eq=False)
class _Push(JointEffect):
    """A small constant torque: what any torque that is held over an interval does, per 1e-3 N m."""

    name: ClassVar[str] = "a push"

    def torque(self, joint: Joint) -> Value:
        """1e-3 N m."""
        return 1e-3


class Directions:
    """Whitened directions z (K R, Q) of a fit's windows, with the windows' starts and the fitted parameters taken out.

    z_perp = (I - P_S0) z,  S0 the sensitivities of the starts and of the parameters of the null model
    """

    def __init__(self, fit: Fit) -> None:
        self.fit, self.model, self.response, self.lin = fit, fit.model, fit.response, fit.solution.lin
        reduced = fit.reduced
        self.starts = reduced.directions
        S = reduced.S.reshape(reduced.e.size, reduced.S.shape[-1])
        S = S / np.maximum(np.linalg.norm(S, axis=0), 1e-300)
        U, size, _ = np.linalg.svd(S, full_matrices=False)
        self.basis: Array = U[:, size > 1e-7]
        self.e: Array = reduced.e.ravel() - self.basis @ (self.basis.T @ reduced.e.ravel())
        x = self.lin.states
        self.theta, self.theta_dot = x[..., 0], x[..., 1]
        self.held = self.lin.drives[self.response.interval]
        self.bias = self._moved(_Push()) / 1e-3

    @cached_property
    def drive(self) -> Array:
        """Mean drive torque of each interval (K, L) [N m]."""
        drive: Array = self.held.mean(axis=-1)
        return drive

    def each(self, alternatives: Sequence[Alternative]) -> Iterator[tuple[Alternative, Array, Array]]:
        """(alternative, z_perp (K R, q), |z| (q,) before anything was taken out), in blocks that fit into memory."""
        width = max(1, _CHUNK // self.e.size)
        waiting: list[Alternative] = []
        for alternative in alternatives:
            waiting.append(alternative)
            if sum(len(a.probes) for a in waiting) >= width:
                yield from self._block(waiting)
                waiting = []
        if waiting:
            yield from self._block(waiting)

    def _block(self, block: Sequence[Alternative]) -> Iterator[tuple[Alternative, Array, Array]]:
        probes = [(e, a) for alternative in block for e, a in zip(alternative.probes, alternative.sizes, strict=True)]
        if all(_only_torque(e) for e, _ in probes):
            torque = np.stack([self.torque_of(e) / a for e, a in probes], axis=-1)
            z, size = self.of_torque(torque)
        else:
            z, size = self.project(np.stack([self.response_to(e) / a for e, a in probes], axis=-1))
        at = 0
        for alternative in block:
            q = len(alternative.probes)
            yield alternative, z[:, at : at + q], size[at : at + q]
            at += q

    def beside(self, torque: Array, names: Sequence[str]) -> float:
        """Wald statistic, chi-square with len(names) degrees, that parameters differ from neutral where torques
        (K, L, Q) of any size may act beside them: (a + da)' C^-1 (a + da), C their block of s^2 ([S Z]'[S Z])^-1.
        """
        S = self.fit.reduced.S.reshape(self.e.size, len(self.fit.names))
        Z = without(self.starts, self._seen(self.bias[..., None] * torque[:, :, None, :])).reshape(self.e.size, -1)
        both = np.concatenate([S, Z], axis=1)
        size = np.maximum(np.linalg.norm(both, axis=0), 1e-300)
        both = both / size
        value, vector = np.linalg.eigh(both.T @ both)
        # what splines and parameters share is given to the splines' ridge, and so to nobody
        inverse = (vector / (np.maximum(value, 0.0) + 1e-9)) @ vector.T
        step = inverse @ (both.T @ self.fit.reduced.e.ravel())
        rest = self.fit.reduced.e.ravel() - both @ step
        variance = float(rest @ rest) / max(1, self.fit.degrees - Z.shape[1])
        at = [self.fit.names.index(n) for n in names]
        neutral = np.array([self.model.parameters[n].neutral or 0.0 for n in names])
        a = (self.fit.solution.p[at] - neutral) * size[at] + step[at]
        return float(a @ np.linalg.pinv(inverse[np.ix_(at, at)]) @ a) / variance

    def of_torque(self, torque: Array) -> tuple[Array, Array]:
        """The same of torques (K, L, Q) [N m] at the joint, each held over an interval."""
        G = self.bias[..., None] * torque[:, :, None, :]
        return self.project(self._seen(G))

    def project(self, z: Array) -> tuple[Array, Array]:
        """Columns (K, R, Q) beside the null model's, flattened, and their sizes before."""
        flat = z.reshape(-1, z.shape[-1])
        size: Array = np.linalg.norm(flat, axis=0)
        z = without(self.starts, z).reshape(-1, z.shape[-1])
        for _ in range(2):
            z = z - self.basis @ (self.basis.T @ z)
        return z, size

    def response_to(self, effect: Effect) -> Array:
        """The change (K, R) of the whitened readings that a small effect makes."""
        if isinstance(effect, OutputEffect):
            states, own = self.lin.states, np.zeros(0)
            probed, base = (
                Response(m, (), self.response.records, self.response.sensor, self.response.windows)
                for m in (self.model.with_effect(effect), self.model)
            )
            z = (probed.readings(own, states) - base.readings(own, states)) * self.response.weight
            flat: Array = z.reshape(len(z), -1)
            return flat
        return self._seen(self._moved(effect)[..., None])[..., 0]

    def torque_of(self, effect: Effect) -> Array:
        """Mean torque (K, L) [N m] of an effect over each interval, along the fitted states."""
        assert isinstance(effect, JointEffect)
        clock, ends = self.response.clock, []
        for side in (slice(None, -1), slice(1, None)):
            joint = self.model.joint(self.theta[:, side], self.theta_dot[:, side], clock[:, side], self.drive)
            ends.append(np.broadcast_to(np.asarray(effect.torque(joint), dtype=float), self.drive.shape))
        return np.asarray(0.5 * (ends[0] + ends[1]))

    def _moved(self, effect: Effect) -> Array:
        """The change (K, L, 2) of the state after one interval that an effect makes."""
        probed, held = self.model.with_effect(effect), self.held
        if isinstance(effect, InputEffect):
            other = Response(probed, (), self.response.records, self.response.sensor, self.response.windows)
            held = other.drives(np.zeros(0))[self.response.interval]
            probed = self.model
        return self._after(probed, held) - self._after(self.model, self.held)

    def _after(self, model: Model, held: Array) -> Array:
        L = self.response.length
        drives = tuple(held[..., j] for j in range(held.shape[-1]))
        after = model.move(self.theta[:, :L], self.theta_dot[:, :L], drives, self.response.clock[:, :L])
        return np.stack(after, axis=-1)

    def _seen(self, G: Array) -> Array:
        """Whitened readings (K, R, Q) of changes G (K, L, 2, Q) of the state after each interval."""
        Z = propagate(self.lin.A, G, initial=False)
        own = np.zeros((Z.shape[-1], len(self.fit.names)))
        z = self.response.reading_slopes(self.fit.solution.p, self.lin.states, Z, own) * self.response.weight[..., None]
        return z.reshape(len(z), -1, z.shape[-1])

    def blocks(self, torques: Array) -> list[Array]:
        """Torque columns cut so that a block of directions stays small."""
        width = max(1, _CHUNK // max(1, self.e.size))
        return [torques[..., i : i + width] for i in range(0, torques.shape[-1], width)]


def _only_torque(effect: Effect) -> bool:
    return isinstance(effect, JointEffect) and bool(effect.inertia() == 0.0)
