"""Dead times and first-order filters, for commands and readings that come late."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.errors import InvalidInput
from sysid.physics import ops
from sysid.physics.effects.effect import Effect, Memory
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Parameter, doubling, parameter


@dataclass(frozen=True, eq=False)
class DeadTime(Effect):
    """A dead time of T [s], at most `longest` [s], which fixes how many intervals are remembered."""

    T: Value = parameter(0.0, unit="s", bounds=(0.0, 1.0), neutral=0.0)
    longest: float = 0.3

    def __post_init__(self) -> None:
        if not 0.0 < self.longest < math.inf:
            raise InvalidInput(f"{self.name} longest = {self.longest}: expected a positive time [s]")
        super().__post_init__()

    @property
    def parameters(self) -> dict[str, Parameter]:
        """T, which is also bounded by the length of the memory."""
        T = super().parameters["T"]
        high = min(T.bounds[1], self.longest)
        return {"T": replace(T, bounds=(T.bounds[0], high), probe=doubling(high))}

    def intervals(self, dt: float) -> int:
        """How many intervals dt [s] back `longest` reaches."""
        return math.ceil(self.longest / dt - 1e-9)


def delayed(signal: Sequence[Value], memory: Memory, T: Value, dt: float) -> tuple[tuple[Value, ...], Memory]:
    """Substep means of u(t - T), T [s] >= 0, for a command u held over each interval; and the next memory.

    signal holds this interval's command, memory those before, the latest first. The mean over a substep [t_j, t_j + h]
    is sum_c W_jc(T) u_(k-c), where W_jc is the share of the substep in which the command of c intervals ago acts:

        W_jc = (clip(t_j + h - T) - clip(t_j - T)) / h,   clipped to [-c dt, (1 - c) dt]

    W is piecewise linear in T, so that derivatives exist; looking u up at the stages of a Runge-Kutta step has none.
    """
    h = dt / len(signal)
    commands = (signal[0], *memory)
    late = []
    for j in range(len(signal)):
        total: Value = 0.0
        for c, command in enumerate(commands):
            low, high = -c * dt, (1 - c) * dt
            if (j + 1) * h > low + 1e-9 * dt:
                share = (_earlier((j + 1) * h, T, low, high) - _earlier(j * h, T, low, high)) / h
                if not (isinstance(share, float) and share == 0.0):
                    total = total + share * command
        late.append(total)
    return tuple(late), commands[: len(memory)]


def delayed_record(signal: Array, intervals: int, T: float, dt: float) -> Array:
    """`delayed` for all intervals of records (..., N, S), from rest: the memory is the record itself, shifted."""
    *batch, N, S = signal.shape
    u, h = np.concatenate([np.zeros((*batch, intervals)), signal[..., 0]], axis=-1), dt / S
    c = np.arange(intervals + 1)
    low, high = -c * dt, (1 - c) * dt
    late = np.zeros(signal.shape)
    for j in range(S):
        share = (np.clip((j + 1) * h - T, low, high) - np.clip(j * h - T, low, high)) / h
        for k in np.flatnonzero(share):
            late[..., j] += share[k] * u[..., intervals - k : intervals - k + N]
    return late


def _earlier(t: float, T: Value, low: float, high: float) -> Value:
    """clip(t - T, low, high) without the limits that T >= 0 never reaches, so that the slope at T = 0 is right."""
    near = 1e-9 * (high - low)
    if t <= low + near:
        return low
    if t <= high + near:
        return ops.maximum(t - T, low)
    return ops.clip(t - T, low, high)


def first_order(T: Value, h: float) -> tuple[Value, Value]:
    """exp(-h/T) and (T/h) (1 - exp(-h/T)) of a lag with the time constant T [s] over a step h [s]; safe at T = 0."""
    T = T + 1e-15
    decay = ops.exp(-h / T)
    return decay, (T / h) * (1.0 - decay)


def decaying(entering: Array, decay: float) -> Array:
    """z_k = decay z_(k-1) + entering_k (..., N), from z = 0."""
    from scipy.linalg import solve_banded  # scipy.signal's filter would take half a second to load

    N = entering.shape[-1]
    band = np.stack([np.ones(N), np.full(N, -decay)])
    # a model that runs away makes infinite signals, which are no error here
    return solve_banded((1, 0), band, entering.reshape(-1, N).T, check_finite=False).T.reshape(entering.shape)
