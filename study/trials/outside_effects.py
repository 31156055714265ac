"""Two effects that real machines have and the catalogue lacks: what a diagnosis may only call unknown, or imitate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from sysid import Effect, InputEffect, Joint, JointEffect, ops
from sysid.physics.effects.effect import Memory
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter


@dataclass(frozen=True, eq=False)
class Magnet(JointEffect):
    """tau = -k d exp((1 - d^2) / 2), d = wrap(theta - place) / width: pulls towards `place` with up to k [N m].

    place, width [rad]: k acts at a distance of one width.
    """

    formula: ClassVar[str] = "tau = -k d exp((1 - d^2) / 2), d = wrap(theta - place) / width"
    k: Value = parameter(0.0, unit="N m", bounds=(-10.0, 10.0), neutral=0.0)
    place: Value = parameter(0.4, unit="rad", bounds=(-7.0, 7.0))
    width: Value = parameter(0.3, unit="rad", bounds=(0.01, 3.0))

    def torque(self, joint: Joint) -> Value:
        d = ops.wrap(joint.theta - self.place) / self.width
        return -self.k * d * ops.exp(0.5 * (1.0 - d * d))


@dataclass(frozen=True, eq=False)
class SlewLimit(InputEffect):
    """z moves towards the signal s by at most `rate` [N m/s]; drive = z: a drive that cannot change its torque at once.

    z' = z + clip(s - z, -rate h, rate h), mean over the substep h = (z + z') / 2; after delay and lag.
    """

    formula: ClassVar[str] = "|drive_dot| <= rate"
    stage: ClassVar[int] = 3
    rate: Value = parameter(1e6, unit="N m/s", bounds=(1e-3, 1e6), neutral=1e6)

    def rest(self, dt: float) -> Memory:
        return (0.0,)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """Substep means of the limited signal, and z at the end of the interval."""
        most = self.rate * dt / len(signal)
        (z,) = memory
        limited = []
        for s in signal:
            after = z + ops.clip(s - z, -most, most)
            limited.append(0.5 * (z + after))
            z = after
        return tuple(limited), (z,)


OUTSIDE: dict[str, type[Effect]] = {kind.name: kind for kind in (Magnet, SlewLimit)}
