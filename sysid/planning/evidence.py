"""Evidence: what the readings along a motion, made or planned, tell of effects and parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.linearisation import LinearisedModel, Motion, Samples
from sysid.physics.effects import Effect, OutputEffect
from sysid.physics.model import Model
from sysid.physics.ops import Array


class Normal(NamedTuple):
    """Normal equations of K logs: c (K,) = r'r, g (K, P) = S'r, F (K, P, P) = S'S; F is the Fisher information.

    S are whitened sensitivities, r whitened changes of the readings. Rollouts that are played together add theirs up.
    """

    c: Array
    g: Array
    F: Array

    @classmethod
    def of(cls, S: Array, r: Array) -> Normal:
        """From whitened sensitivities S (K, R, P) and changes r (K, R) of the readings, one log a row."""
        S_t = np.swapaxes(S, -1, -2)
        return cls(np.sum(r * r, axis=-1), (S_t @ r[..., None])[..., 0], S_t @ S)

    def together(self) -> Normal:
        """All logs as one (K = 1)."""
        return Normal(*(np.sum(a, axis=0, keepdims=True) for a in self))

    def plus(self, one: Normal) -> Normal:
        """Each log together with another one."""
        return Normal(*(a + b for a, b in zip(self, one, strict=True)))

    def at(self, k: int) -> Normal:
        return Normal(*(a[k : k + 1] for a in self))

    def _scaled(self) -> tuple[Array, Array]:
        """The norms (K, P) of the sensitivities, and F for sensitivities of norm 1."""
        size = np.sqrt(np.maximum(np.diagonal(self.F, axis1=-2, axis2=-1), 1e-300))
        return size, self.F / (size[..., :, None] * size[..., None, :])

    def unexplained(self) -> Array:
        """c - g' F^-1 g (K,): what is left of r'r once the rival has its best numbers, to first order.

        For a small effect of size a it is a^2 |z_perp|^2 (1 - rho^2), with the cosine rho between the two effects.
        Source: T-optimality, Atkinson and Fedorov, Biometrika 1975.
        """
        size, F = self._scaled()
        g = (self.g / size)[..., None]
        taken = np.swapaxes(g, -1, -2) @ np.linalg.pinv(F, rcond=1e-10, hermitian=True) @ g
        return np.maximum(self.c - taken[..., 0, 0], 0.0)

    def sd(self) -> Array:
        """Standard deviations (K, P) of the parameters; inf where the log does not determine one."""
        size, F = self._scaled()
        value, vector = np.linalg.eigh(F)
        lost = value < 1e-9
        variance = np.sum(vector**2 / np.where(lost, np.inf, value)[..., None, :], axis=-1)
        unknown = np.any((np.abs(vector) > 0.01) & lost[..., None, :], axis=-1)
        return np.where(unknown, np.inf, np.sqrt(variance)) / size


class Sensitivities:
    """What the parameters `names`, and an effect of the model, change in the innovations of a filter along a motion.

    Changes propagate as in the model that made the motion, with the effect; an output effect is left out of that, which
    is an error of second order. The effect's own change is what the model without it fails to do along the motion. The
    filter's first state is vague, since the states at which records begin are not known.
    """

    def __init__(
        self,
        samples: Samples,
        model: Model,
        effect: Effect | None,
        motion: Motion,
        names: Sequence[str],
        disturbances: Disturbances,
    ) -> None:
        self.names, bare = tuple(names), model if effect is None else model.without_effect(effect.name)
        self.without = LinearisedModel(samples, bare, motion)
        dynamic = effect is not None and not isinstance(effect, OutputEffect)
        self.linearised = LinearisedModel(samples, model, motion) if dynamic else self.without
        self.filter = self.linearised.system.filter(disturbances)

    @cached_property
    def Z(self) -> Array:
        """Whitened sensitivities (2 M, P) of the parameters."""
        return self.filter.whiten(*self.linearised.changes(self.names))

    def of(self, effects: Sequence[Effect]) -> Array:
        """Whitened changes (2 M, C) that effects of one kind make, each of its own size."""
        return self.filter.whiten(*self.without.effect_changes(effects, [1.0] * len(effects)))

    def unlike(self, truth: Effect, rival: Effect | None, logs: int = 1) -> Normal:
        """The normal equations of what an effect does beyond a rival, for the rival's numbers and the parameters to
        imitate it. The records are taken as that many logs of equal length."""
        r, S = self.of((truth,)), self.Z
        if rival is not None:
            moves = self.of((rival, *_varied(rival)))
            r, S = r - moves[:, :1], np.concatenate([S, moves[:, 1:] - moves[:, :1]], axis=1)
        return Normal.of(S.reshape(logs, -1, S.shape[1]), r.reshape(logs, -1))

    def precision(self, logs: int = 1) -> Normal:
        """The normal equations of the parameters alone."""
        S = self.Z.reshape(logs, -1, len(self.names))
        return Normal.of(S, np.zeros(S.shape[:2]))


def _varied(effect: Effect) -> Iterator[Effect]:
    """The effect with each of its parameters in turn a little off."""
    for name, p in effect.parameters.items():
        value, step = float(p.value), 1e-3 * p.scale
        yield effect.with_parameters({name: value + step if value + step <= p.bounds[1] else value - step})
