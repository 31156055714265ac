"""What happens to a command before it becomes torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sysid.physics import ops
from sysid.physics.effects.effect import InputEffect, Joint, JointEffect, Memory
from sysid.physics.effects.timing import DeadTime, decaying, delayed, delayed_record, first_order
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import doubling, of_curve, of_largest, parameter

MOST_IDLE = 0.9
"""Share, at most, of the instants with motion and a command at which a drive may give nothing: beyond it the motion
does not depend on the command, like that of a joint that a controller leads along a path."""
NEXT_TO_NOTHING = 0.1
"""Share of a drive's stall torque that counts as next to nothing."""


@dataclass(frozen=True, eq=False)
class Delay(DeadTime, InputEffect):
    """A dead time of the torque, at most `longest` [s], which fixes the length of the memory."""

    label = "a delay of the torque"
    precedence = 1
    rarity = 0.5
    formula = "drive(t) = u(t - T)"
    confused = ("lag", "stamp", "sensor_delay", "filtered_speed")
    excludes = ("stamp",)
    stage = 1

    def with_room(self) -> tuple[Delay, ...]:
        """The same delay with a memory of a second, which costs more to simulate."""
        if self.longest >= 1.0 or float(self.T) < 0.8 * self.longest:
            return ()
        roomy = replace(self, longest=1.0)
        begins, high = (float(self.T), 0.45, 0.65, 0.95), roomy.parameters["T"].bounds[1]
        return tuple(replace(roomy, T=begun) for begun in begins if begun <= high)

    def rest(self, dt: float) -> Memory:
        return (0.0,) * self.intervals(dt)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        return delayed(signal, memory, self.T, dt)

    def whole(self, signal: Array, dt: float) -> Array:
        return delayed_record(signal, self.intervals(dt), self.T, dt)


@dataclass(frozen=True, eq=False)
class Lag(InputEffect):
    """A first-order lag of the torque, whose memory is z.

    Exact for a signal s that is constant over a substep h, and safe at T -> 0:

        z' = s + (z - s) exp(-h/T),   mean of z over the substep = s + (z - s) (T/h) (1 - exp(-h/T))
    """

    label = "a lag of the torque"
    rarity = 1.5
    formula = "T z_dot = u - z, drive = z"
    confused = ("delay", "stamp", "sensor_delay", "filtered_speed")
    stage = 2
    T: Value = parameter(0.0, unit="s", bounds=(0.0, 10.0), neutral=0.0, probe=doubling(1.0))

    def rest(self, dt: float) -> Memory:
        return (0.0,)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        (z,), (decay, share) = memory, first_order(self.T, dt / len(signal))
        lagged = []
        for s in signal:
            lagged.append(s + (z - s) * share)
            z = s + (z - s) * decay
        return tuple(lagged), (z,)

    def whole(self, signal: Array, dt: float) -> Array:
        decay, share = first_order(self.T, dt / signal.shape[-1])
        s = signal.reshape(*signal.shape[:-2], -1)
        filtered = decaying((1.0 - decay) * s, decay)
        z = np.concatenate([np.zeros_like(s[..., :1]), filtered[..., :-1]], axis=-1)
        return np.reshape(s + (z - s) * share, signal.shape)


@dataclass(frozen=True, eq=False)
class TorqueGain(InputEffect):
    """A torque constant that is off by the factor c.

    With m and l (or J and G) free it does not show in the motion: weigh the pendulum, or hang a known payload on it.
    """

    label = "a factor on the torque"
    inertial = True
    formula = "drive = c u"
    confused = ("rotor_inertia", "coulomb", "saturation", "dead_zone")
    c: Value = parameter(1.0, unit="1", bounds=(0.1, 10.0), neutral=1.0)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        return tuple(self.c * s for s in signal), memory


@dataclass(frozen=True, eq=False)
class DeadZone(InputEffect):
    """A dead zone of the drive: commands below d do nothing, those above lose d."""

    label = "a dead zone of the torque"
    rarity = 3.0
    refines = (("coulomb",), ("coulomb", "tilt"), ("coulomb", "torque_bias"))
    formula = "drive = sign(u) max(|u| - d, 0)"
    confused = ("coulomb", "torque_gain")
    d: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)

    def resolved(self, sd: float, reach: float, joint: Joint) -> bool:
        """Whether the drive gives something often enough (MOST_IDLE)."""
        return _share(joint.drive == 0.0) < MOST_IDLE

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        return tuple(s - ops.where(s > 0.0, ops.minimum(s, self.d), ops.maximum(s, -self.d)) for s in signal), memory


@dataclass(frozen=True, eq=False)
class Saturation(InputEffect):
    """A driver that gives no more than `limit`; 10^6 stands for never."""

    label = "a limit of the torque"
    rarity = 1.5
    formula = "drive = clip(u, -limit, limit)"
    confused = ("torque_gain", "torque_speed_limit")
    limit: Value = parameter(
        1e6, unit="N m", bounds=(1e-6, 1e6), neutral=1e6, probe=of_largest(0.9, 0.75, 0.6, 0.45, 0.3)
    )

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        return tuple(ops.clip(s, -self.limit, self.limit) for s in signal), memory


@dataclass(frozen=True, eq=False)
class TorqueSpeedLimit(JointEffect):
    """A motor's torque-speed curve: a limit of the torque that falls with the speed that it drives.

    A driver of limited voltage gives its stall torque `limit` at rest and nothing at the no-load speed limit / k; the
    curve falls with slope k by back-EMF. Against the motion it gives up to `limit`. With k = 0 it is a saturation; a
    limit of 10^6 stands for never. (The same curve is DCMotor in Isaac Lab's actuators.)
    """

    label = "a limit of the torque that falls with speed"
    rarity = 2.5
    refines = (("saturation",),)
    contains = ("saturation",)
    formula = "drive = clip(u, -min(limit, limit + k theta_dot), min(limit, limit - k theta_dot))"
    confused = ("saturation", "back_emf")
    ratios: ClassVar = {"no_load_speed": ("limit", "k", "rad/s")}
    limit: Value = parameter(1e6, unit="N m", bounds=(1e-6, 1e6), neutral=1e6, probe=of_largest(2.0, 1.2, 0.8))
    k: Value = parameter(0.1, unit="N m s/rad", bounds=(0.0, 1e3), probe=of_curve(2.0, 1.2, 0.6))

    def resolved(self, sd: float, reach: float, joint: Joint) -> bool:
        """Whether the drive gives more than next to nothing often enough (MOST_IDLE), where it pushes the joint on."""
        pushes = joint.drive * joint.theta_dot > 0.0
        given = np.abs(joint.drive + self.torque(joint))
        return _share((given < NEXT_TO_NOTHING * float(self.limit))[pushes]) < MOST_IDLE

    def torque(self, joint: Joint) -> Value:
        highest = ops.clip(self.limit - self.k * joint.theta_dot, 0.0, self.limit)
        lowest = -ops.clip(self.limit + self.k * joint.theta_dot, 0.0, self.limit)
        return ops.clip(joint.drive, lowest, highest) - joint.drive


@dataclass(frozen=True, eq=False)
class BackEmf(JointEffect):
    """A torque against the motion: a turning motor takes current from its voltage driver.

    It is exactly viscous friction while the driver is on; only a log with the driver off tells them apart.
    """

    label = "back-EMF"
    formula = "tau = -k theta_dot, while the driver is on"
    confused = ("viscous", "drag", "load_friction", "torque_speed_limit", "coasting_drive")
    friction = True
    brakes = True
    k: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return -self.k * joint.theta_dot


@dataclass(frozen=True, eq=False)
class CoastingDrive(JointEffect):
    """Back-EMF of a driver that opens its bridge at command 0, where the joint then coasts.

    A driver that shorts the motor there brakes with its back-EMF all the time, as `back_emf` does. Many drivers of
    small motors can be set to either.
    """

    label = "a drive that lets the joint coast at command 0"
    formula = "tau = -k theta_dot where the command is not 0"
    rarity = 2.0
    refines = (("viscous",),)
    confused = ("viscous", "back_emf")
    friction = True
    k: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return -self.k * joint.theta_dot * ops.where(ops.abs(joint.command) > 0.0, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class Stamp(InputEffect):
    """Torques that the log stamps s samples early. It belongs to the log, not to the machine.

    s = 0: a row's torque is held from its time to the next row's. s = -1: from the row before until this one.
    s = -1/2: half of each. s = 1: it acts one row late. The effect gets each torque one row early and delays
    it by (1 + s) dt.
    """

    label = "a stamp of the torques"
    precedence = 4
    rarity = 1.0
    formula = "drive(t) = u(t - s dt), of the log and not of the machine"
    confused = ("delay", "lag", "sensor_delay")
    excludes = ("delay",)
    of_log = True
    stage = -1
    ahead = 1
    s: Value = parameter(0.0, unit="samples", bounds=(-1.0, 1.0), neutral=0.0, probe=(-1.0, -0.5, 0.5, 1.0))

    def rest(self, dt: float) -> Memory:
        return (0.0, 0.0)

    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        return delayed(signal, memory, (1.0 + self.s) * dt, dt)

    def whole(self, signal: Array, dt: float) -> Array:
        return delayed_record(signal, 2, (1.0 + self.s) * dt, dt)


def _share(where: NDArray[np.bool_]) -> float:
    """The share of instants at which `where` is true; 0 if there are none."""
    return float(np.mean(where)) if where.size else 0.0
