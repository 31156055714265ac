"""What happens to a command before it becomes torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from sysid import ops
from sysid.effects.effect import InputEffect, Memory
from sysid.errors import InvalidInput
from sysid.ops import Value
from sysid.parameters import Parameter, parameter

_TINY = 1e-15


@dataclass(frozen=True, eq=False)
class Delay(InputEffect):
    """drive(t) = u(t - T): a dead time of T [s], at most `longest` [s], which fixes the length of the memory.

    The command is held over dt, so the mean of u(t - T) over a substep [t_j, t_j + h] is
    sum_c W_jc(T) u_(k-c), where W_jc is the share of the substep in which the command of c intervals ago
    acts:  W_jc = (clip(t_j + h - T) - clip(t_j - T)) / h,  clipped to [-c dt, (1 - c) dt].
    W is piecewise linear in T, so derivatives with respect to T exist; a look-up at the stages of a
    Runge-Kutta step would have none.
    """

    stage: ClassVar[int] = 1
    T: Value = parameter(0.0, unit="s", bounds=(0.0, 1.0), neutral=0.0)
    longest: float = 0.2

    def __post_init__(self) -> None:
        if not 0.0 < self.longest < math.inf:
            raise InvalidInput(f"delay longest = {self.longest}: expected a positive time [s]")
        super().__post_init__()

    @property
    def parameters(self) -> dict[str, Parameter]:
        """T, bounded by the length of the memory too."""
        T = super().parameters["T"]
        return {"T": replace(T, bounds=(T.bounds[0], min(T.bounds[1], self.longest)))}

    def rest(self, dt: float) -> Memory:
        """Zero commands, the latest first, as far back as `longest` reaches."""
        return (0.0,) * math.ceil(self.longest / dt - 1e-9)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """Substep means of the delayed command; the signal before a delay is constant over the interval."""
        h = dt / len(signal)
        commands = (signal[0], *memory)
        delayed = []
        for j in range(len(signal)):
            begin, end = j * h - self.T, (j + 1) * h - self.T
            total: Value = 0.0
            for c, command in enumerate(commands):
                low, high = -c * dt, (1 - c) * dt
                total = total + (ops.clip(end, low, high) - ops.clip(begin, low, high)) / h * command
            delayed.append(total)
        return tuple(delayed), commands[: len(memory)]


@dataclass(frozen=True, eq=False)
class Lag(InputEffect):
    """T z_dot = s - z, drive = z: a first-order lag of time constant T [s] on the signal s.

    Exact for s constant over a substep h, and safe at T -> 0:
        z' = s + (z - s) exp(-h/T),   mean of z over the substep = s + (z - s) (T/h) (1 - exp(-h/T))
    """

    stage: ClassVar[int] = 2
    T: Value = parameter(0.0, unit="s", bounds=(0.0, 10.0), neutral=0.0)

    def rest(self, dt: float) -> Memory:
        """z = 0."""
        return (0.0,)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """Substep means of the lagged signal, and z at the end of the interval."""
        h = dt / len(signal)
        T = self.T + _TINY
        decay = ops.exp(-h / T)
        share = (T / h) * (1.0 - decay)
        (z,) = memory
        lagged = []
        for s in signal:
            lagged.append(s + (z - s) * share)
            z = s + (z - s) * decay
        return tuple(lagged), (z,)
