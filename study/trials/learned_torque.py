"""A torque learned from rollouts on top of a fitted model: what one does who will not ask for the missing effect.

Two black-box effects, a filter of the command and a torque that a small network makes of the joint's state, are
ordinary effects of a model and name nothing. Their numbers are plain arrays, one set for all pendulums or one for each
of A. They are fitted by

    min  1/2 |e(p, starts)|^2 + decay/2 |p - p_0|^2        over the weights p and the starts of windows of a second

from strong to weak decay, each from where the last one ended. Some rollouts are held out: they choose the decay, or
nothing where no decay lowers their error. Then all rollouts are learned from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import casadi
import numpy as np

from sysid import Effect, InputEffect, InvalidInput, Joint, JointEffect, Model, Record, Sensor, State, ops
from sysid.estimation.held_out import held_out_error
from sysid.estimation.linearisation import Samples
from sysid.estimation.output_error import Response
from sysid.estimation.windows import cut
from sysid.physics.effects.effect import Memory
from sysid.physics.ops import Array, Value

TAPS = 5
"""The command itself and the last four: as many as an agent sees."""

TYPICAL_SPEED = 5.0
"""Typical speed [rad/s] that a network's input is measured in."""

HIDDEN = (16, 16)
INPUTS = 4

STEEP = 3.0
"""Gain of the first layer: what acts within a few tenths of a radian must be within its reach."""

Layers = tuple[tuple[Value, Value], ...]
"""W (I, H) and b (H,) of each layer; for A pendulums of their own (A, I, H) and (A, H)."""


@dataclass(frozen=True, eq=False)
class CommandFilter(InputEffect):
    """drive_k = sum_i taps_i u_(k-i), i = 0 ... C-1: a filter of the command u [N m] with a memory of C - 1 intervals.

    taps [1] (C,), or (A, C): of each of A pendulums. At (1, 0, ..., 0) nothing changes.
    """

    formula: ClassVar[str] = "drive_k = sum_i taps_i u_(k-i)"
    stage: ClassVar[int] = 1
    taps: Value = field(default_factory=lambda: np.eye(TAPS)[0])

    def rest(self, dt: float) -> Memory:
        return (0.0,) * (self.taps.shape[-1] - 1)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """The filtered command in every substep; the signal before it is constant over the interval."""
        commands = (signal[0], *memory)
        drive = sum(self.taps[..., i] * u for i, u in enumerate(commands))
        return (drive,) * len(signal), commands[:-1]


@dataclass(frozen=True, eq=False)
class ResidualNetwork(JointEffect):
    """tau = net(cos theta, sin theta, theta_dot / 5, drive / drive_max) [N m], a network of tanh layers.

    layers   W and b of each layer; with no layer there is no torque
    """

    formula: ClassVar[str] = "tau = net(cos theta, sin theta, theta_dot, drive)"
    layers: Layers = ()
    drive_max: float = 2.0

    def torque(self, joint: Joint) -> Value:
        theta, theta_dot, drive = joint.theta, joint.theta_dot, joint.drive
        inputs = (ops.cos(theta), ops.sin(theta), theta_dot / TYPICAL_SPEED, drive / self.drive_max)
        return network(inputs, self.layers) if self.layers else 0.0 * theta


def network(inputs: Sequence[Value], layers: Layers) -> Value:
    """The output (...,) of tanh layers with a linear last one, over as many inputs (...,) as the first W has rows."""
    x = ops.stack(inputs)
    if isinstance(x, casadi.SX | casadi.MX):
        for i, (W, b) in enumerate(layers):
            x = casadi.mtimes(W.T, ops.tanh(x) if i else x) + b
        return x
    for i, (W, b) in enumerate(layers):
        x = _affine(ops.tanh(x) if i else x, *ops.as_type_of(x, W, b))
    return x[..., 0]


def _affine(x: Value, W: Value, b: Value) -> Value:
    """x W + b; a row of x (A, I) meets its own W where that is (A, I, H)."""
    return x @ W + b if W.ndim == 2 else (x[..., None, :] @ W)[..., 0, :] + b


def untrained(rng: np.random.Generator, hidden: Sequence[int] = HIDDEN) -> Layers:
    """Random hidden layers, the first steep and the others of unit gain, and a last layer of zeros: a network that says
    0 and can learn."""
    sizes = (INPUTS, *hidden)
    gains = (STEEP, *(1.0 for _ in hidden[1:]))
    layers = [
        (gain * rng.standard_normal((i, h)) / np.sqrt(i), gain * 0.5 * rng.standard_normal(h))
        for gain, i, h in zip(gains, sizes, hidden, strict=False)
    ]
    return (*layers, (np.zeros((sizes[-1], 1)), np.zeros(1)))


def stacked(effects: Sequence[Sequence[Effect]], device: str = "cpu") -> tuple[Effect, ...]:
    """The learned effects of A agents as those of one model, whose pendulum a moves as under effects[a] alone.

    effects   of each agent a filter and a torque, in this order
    """
    import torch

    def together(numbers: Sequence[Any]) -> Value:
        return torch.from_numpy(np.stack([np.asarray(n, dtype=float) for n in numbers])).to(device)

    filters, torques = zip(*effects, strict=True)
    layers = tuple(
        (together([W for W, _ in layer]), together([b for _, b in layer]))
        for layer in zip(*(e.layers for e in torques), strict=True)
    )
    return replace(filters[0], taps=together([e.taps for e in filters])), replace(torques[0], layers=layers)


HELD_OUT = 0.2
"""Share of the rollouts, at least one, that choose the decay."""

WINDOW = 1.0
"""Seconds that the model is simulated for before it is put right."""

DECAYS = tuple(10.0**k for k in (3, 2, 1, 0, -1, -2, -3))
"""Of the network's weights, in units of the whitened residuals; the taps, which are few, decay by a hundredth of it."""

ROUNDS = 6
"""Steps of Levenberg and Marquardt at a decay."""

NEGLIGIBLE_DECREASE = 0.5
"""A decrease of the objective that ends a decay's rounds."""

FAILED_DECAYS = 2
"""Decays that may fail to lower the held-out error before the search ends."""


def fit_network(model: Model, records: Sequence[Record], sensor: Sensor, rng: np.random.Generator) -> Model:
    """Learn what the records show beyond a model whose own numbers stay: the model with a command filter and a learned
    torque, or the one that came where neither helps.

    Raises InvalidInput for fewer than two records, or those that do not fit the model.
    """
    if len(records) < 2:
        raise InvalidInput(f"{len(records)} records to learn from: expected at least two, one is held out")
    count = max(1, round(HELD_OUT * len(records)))
    held, seen = records[:count], records[count:]
    weights = Weights.untrained(model, rng)
    chosen, least, failed = 0, held_out_error(model, held, sensor, WINDOW).ratio, 0
    for k, p in enumerate(_path(weights, seen, sensor, DECAYS), 1):
        after = held_out_error(weights.model(p), held, sensor, WINDOW).ratio
        failed = 0 if after < least else failed + 1
        if after < least:
            chosen, least = k, after
        elif failed == FAILED_DECAYS:
            break
    if not chosen:
        return model
    *_, p = _path(weights, records, sensor, DECAYS[:chosen])
    return weights.model(p)


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
        self.response = Response(weights.base, Samples(weights.base, records, sensor), cut(records, WINDOW))
        past = [[np.concatenate([np.zeros(i), r.u])[: len(r)] for i in range(weights.taps)] for r in records]
        commands = np.concatenate([*(np.transpose(delayed) for delayed in past), np.zeros((1, weights.taps))])
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
        K, L, _, P = G.shape
        Z = np.zeros((K, L + 1, 2, 2 + P))
        Z[:, 0, :, :2] = np.eye(2)
        for k in range(L):
            Z[:, k + 1] = A[:, k] @ Z[:, k]
            Z[:, k + 1, :, 2:] += G[:, k]
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
        weights = torch.from_numpy(p).expand(K * L, -1).clone().requires_grad_()
        u, *past = torch.from_numpy(self.commands.reshape(K * L, -1)).unbind(-1)
        t = torch.from_numpy(self.response.time[:, :L].reshape(-1))
        after = self.weights.model(weights).advance(State(x[:, 0], x[:, 1], (tuple(past),)), u, t)
        A, G = np.empty((K * L, 2, 2)), np.empty((K * L, 2, len(p)))
        for row, value in enumerate((after.theta, after.theta_dot)):
            slopes = torch.autograd.grad(value.sum(), (x, weights), retain_graph=row == 0)
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
        if gain < NEGLIGIBLE_DECREASE:
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
