"""Black-box effects: a filter of the command and a torque that a small network makes of the joint's state.

Both are ordinary effects of a model, and name nothing: what `learning` fits where no equation is sought. Their numbers
are plain arrays, one set for all pendulums or one for each of A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import casadi
import numpy as np

from sysid import Effect, InputEffect, InvalidInput, Joint, JointEffect, ops
from sysid.physics.effects.effect import Memory
from sysid.physics.ops import Value

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
        x = _affine(ops.tanh(x) if i else x, *ops.alike(x, W, b))
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
    Raises InvalidInput where an agent has others.
    """
    import torch

    for own in effects:
        if tuple(type(e) for e in own) != (CommandFilter, ResidualNetwork):
            came = ", ".join(e.name for e in own) or "none"
            raise InvalidInput(f"an agent has the effects {came}: expected command_filter, residual_network")

    def together(numbers: Sequence[Any]) -> Value:
        return torch.from_numpy(np.stack([np.asarray(n, dtype=float) for n in numbers])).to(device)

    filters, torques = zip(*effects, strict=True)
    layers = tuple(
        (together([W for W, _ in layer]), together([b for _, b in layer]))
        for layer in zip(*(e.layers for e in torques), strict=True)
    )
    return replace(filters[0], taps=together([e.taps for e in filters])), replace(torques[0], layers=layers)
