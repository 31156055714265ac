"""A torque learned from rollouts on top of a fitted model: what one does who will not ask for the missing effect.

    min  1/2 |e(p, starts)|^2 + decay/2 |p - p_0|^2        over the weights p and the starts of windows of a second

from strong to weak decay, each from where the last one ended. Some rollouts are held out: they choose the decay, or
nothing where no decay lowers their error. Then all rollouts are learned from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from study.trials.residual_network import CommandFilter, ResidualNetwork, untrained
from sysid import InvalidInput, Model, Record, Sensor, State
from sysid.estimation.held_out import held_out_error
from sysid.estimation.output_error import Response, propagate
from sysid.estimation.windows import cut
from sysid.physics.ops import Array

HELD_OUT = 0.2
"""Share of the rollouts, at least one, that choose the decay."""

WINDOW = 1.0
"""Seconds that the model is simulated for before it is put right."""

DECAYS = tuple(10.0**k for k in (3, 2, 1, 0, -1, -2, -3))
"""Of the network's weights, in units of the whitened residuals; the taps, which are few, decay by a hundredth of it."""

ROUNDS = 6
"""Steps of Levenberg and Marquardt at a decay."""

NEGLIGIBLE = 0.5
"""A decrease of the objective that ends a decay's rounds."""

FAILED_DECAYS = 2
"""Decays that may fail to lower the held-out error before the search ends."""


@dataclass(frozen=True, eq=False)
class NetworkFit:
    """A model with a command filter and a learned torque, or the one that came where neither helped.

    before, after   error on the held-out rollouts, in units of the sensor's noise, before these were learned from, too
    decay           that was chosen; None where the model is the one that came
    """

    model: Model
    before: float
    after: float
    decay: float | None


def fit_network(model: Model, records: Sequence[Record], sensor: Sensor, rng: np.random.Generator) -> NetworkFit:
    """Learn what the records show beyond a model whose own numbers stay.

    Raises InvalidInput for fewer than two records, or those that do not fit the model.
    """
    if len(records) < 2:
        raise InvalidInput(f"{len(records)} records to learn from: expected at least two, one is held out")
    count = max(1, round(HELD_OUT * len(records)))
    held, seen = records[:count], records[count:]
    before = held_out_error(model, held, sensor, WINDOW).ratio
    weights = Weights.untrained(model, rng)
    chosen, least, failed = 0, before, 0
    for k, p in enumerate(_path(weights, seen, sensor, DECAYS), 1):
        after = held_out_error(weights.model(p), held, sensor, WINDOW).ratio
        failed = 0 if after < least else failed + 1
        if after < least:
            chosen, least = k, after
        elif failed == FAILED_DECAYS:
            break
    if not chosen:
        return NetworkFit(model, before, before, None)
    *_, p = _path(weights, records, sensor, DECAYS[:chosen])
    return NetworkFit(weights.model(p), before, least, DECAYS[chosen - 1])


@dataclass(frozen=True, eq=False)
class Weights:
    """The numbers of both effects on top of a model as one vector: first (P,) before learning, like the effects that
    they came from; stiffness (P,) of each against decay."""

    base: Model
    first: Array
    stiffness: Array
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def untrained(cls, base: Model, rng: np.random.Generator) -> Weights:
        """Of a filter that changes nothing and a network that says 0."""
        taps = CommandFilter().taps
        numbers = [taps, *(number for layer in untrained(rng) for number in layer)]
        first = np.concatenate([np.ravel(number) for number in numbers])
        stiffness = np.where(np.arange(len(first)) < len(taps), 0.01, 1.0)
        return cls(base, first, stiffness, tuple(np.shape(number) for number in numbers))

    @property
    def taps(self) -> int:
        return self.shapes[0][0]

    def model(self, p: Any) -> Model:
        """The model with numbers p (P,), or (M, P): of each of M pendulums."""
        parts, at = [], 0
        for shape in self.shapes:
            size = int(np.prod(shape))
            parts.append(p[..., at : at + size].reshape(*p.shape[:-1], *shape))
            at += size
        taps, *numbers = parts
        layers = tuple(zip(numbers[::2], numbers[1::2], strict=True))
        learned = CommandFilter(taps=taps), ResidualNetwork(layers=layers, drive_max=self.base.u_max)
        return replace(self.base, effects=(*self.base.effects, *learned))


class WindowSensitivities(NamedTuple):
    """Residuals e (K, R) of K windows, and their derivatives S_x (K, R, 2), S_p (K, R, P) with respect to the windows'
    starts and to the weights."""

    e: Array
    S_x: Array
    S_p: Array


class Windows:
    """Windows of records: whitened residuals of the model with given weights, and their derivatives by torch."""

    def __init__(self, weights: Weights, records: Sequence[Record], sensor: Sensor) -> None:
        self.weights = weights
        self.response = Response(weights.base, records, sensor, cut(records, WINDOW))
        past = [[np.concatenate([np.zeros(i), r.u])[: len(r)] for i in range(weights.taps)] for r in records]
        commands = np.concatenate([*(np.transpose(own) for own in past), np.zeros((1, weights.taps))])
        self.commands: Array = commands[self.response.interval]  # (K, L, taps), the latest first

    def residual(self, p: Array, starts: Array) -> tuple[Array, Array]:
        """e (K, R) and the states (K, L+1, 2) that it belongs to."""
        states = self._states(self.weights.model(p), starts)
        e = (self.response.y - np.swapaxes(states, 1, 2)) * self.response.weight
        return e.reshape(len(starts), -1), states

    def linearise(self, p: Array, starts: Array) -> WindowSensitivities:
        """Residuals and derivatives at weights p (P,) and starts (K, 2)."""
        e, states = self.residual(p, starts)
        A, G = self._slopes(p, states)
        Z = propagate(A, G)
        S = (np.swapaxes(Z, 1, 2) * self.response.weight[..., None]).reshape(*e.shape, Z.shape[-1])
        return WindowSensitivities(e, S[..., :2], S[..., 2:])

    def _states(self, model: Model, starts: Array) -> Array:
        K, L, _ = self.commands.shape
        states = np.empty((K, L + 1, 2))
        states[:, 0] = starts
        for k in range(L):
            u, *past = self.commands[:, k].T
            now = State(states[:, k, 0], states[:, k, 1], (tuple(past),))
            after = model.advance(now, u, self.response.time[:, k])
            states[:, k + 1, 0], states[:, k + 1, 1] = after.theta, after.theta_dot
        return states

    def _slopes(self, p: Array, states: Array) -> tuple[Array, Array]:
        """One-step derivatives A (K, L, 2, 2) to the state and G (K, L, 2, P) to the weights."""
        import torch

        K, L, _ = self.commands.shape
        x = torch.from_numpy(states[:, :L].reshape(K * L, 2)).requires_grad_()
        own = torch.from_numpy(p).expand(K * L, -1).clone().requires_grad_()
        u, *past = torch.from_numpy(self.commands.reshape(K * L, -1)).unbind(-1)
        t = torch.from_numpy(self.response.time[:, :L].reshape(-1))
        after = self.weights.model(own).advance(State(x[:, 0], x[:, 1], (tuple(past),)), u, t)
        A, G = np.empty((K * L, 2, 2)), np.empty((K * L, 2, len(p)))
        for row, value in enumerate((after.theta, after.theta_dot)):
            slopes = torch.autograd.grad(value.sum(), (x, own), retain_graph=row == 0)
            A[:, row], G[:, row] = (slope.numpy() for slope in slopes)
        return A.reshape(K, L, 2, 2), G.reshape(K, L, 2, -1)


def _path(weights: Weights, records: Sequence[Record], sensor: Sensor, decays: Sequence[float]) -> Iterator[Array]:
    windows = Windows(weights, records, sensor)
    p, starts, damping = weights.first, windows.response.starts, 1e-2
    for decay in decays:
        p, starts, damping = _descend(windows, p, starts, decay * weights.stiffness, damping)
        yield p


def _descend(windows: Windows, p: Array, starts: Array, decay: Array, damping: float) -> tuple[Array, Array, float]:
    """Weights and starts after some rounds of Levenberg and Marquardt, the starts eliminated; and the damping."""

    def objective(p: Array, e: Array) -> float:
        return 0.5 * float(np.sum(e**2) + np.sum(decay * (p - windows.weights.first) ** 2))

    for _ in range(ROUNDS):
        lin = windows.linearise(p, starts)
        e, S = _beside_starts(lin)
        F, g, now = S.T @ S, S.T @ e - decay * (p - windows.weights.first), objective(p, lin.e)
        gain = 0.0
        for _ in range(4):
            dp = np.linalg.solve(F + np.diag(decay + damping * (0.1 * np.mean(np.diag(F)) + 1.0)), g)
            dx = _start_steps(lin, dp)
            gain = now - objective(p + dp, windows.residual(p + dp, starts + dx)[0])
            if gain > 0.0:
                break
            damping = 6.0 * max(damping, 1e-4)
        if not gain > 0.0:
            break
        p, starts, damping = p + dp, starts + dx, 0.25 * damping
        if gain < NEGLIGIBLE:
            break
    return p, starts, damping


def _beside_starts(lin: WindowSensitivities) -> tuple[Array, Array]:
    """What of the residuals (K R,) and of their slopes to the weights (K R, P) lies beside the columns of S_x: the
    starts of all windows eliminated."""
    Q, _ = np.linalg.qr(lin.S_x)
    both = np.concatenate([lin.e[..., None], lin.S_p], axis=-1)
    for _ in range(2):  # once more takes out what rounding left
        both = both - Q @ (np.swapaxes(Q, -1, -2) @ both)
    flat = both.reshape(lin.e.size, -1)
    return flat[:, 0], flat[:, 1:]


def _start_steps(lin: WindowSensitivities, dp: Array) -> Array:
    """The step of the starts (K, 2) that goes with dp; at most half a radian and three times that a second."""
    dx = np.linalg.pinv(lin.S_x, rcond=1e-9) @ (lin.e - lin.S_p @ dp)[..., None]
    return np.clip(dx[..., 0], [-0.5, -3.0], [0.5, 3.0])
