"""What a joint drives through a spring."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sysid.physics import ops
from sysid.physics.effects.effect import DynamicEffect, Memory, Stretch
from sysid.physics.ops import Value
from sysid.physics.parameters import Extent, parameter


def _resonances(extent: Extent) -> tuple[float, ...]:
    """From a few periods a log to where the samples still show one."""
    low, high = max(1.0, 3.0 / extent.duration), 0.3 / extent.dt
    count = max(2, 1 + round(2.0 * math.log2(max(high / low, 2.0))))
    return tuple(low * (high / low) ** (k / (count - 1)) for k in range(count))


@dataclass(frozen=True, eq=False)
class FlexibleTransmission(DynamicEffect):
    """A part J of the load that hangs on a spring behind the sensor.

    It may be a harmonic drive, a belt, a long shaft, a sloshing load. delta [rad] is its angle against the joint,
    omega = 2 pi f, f [Hz] the resonance while the joint is held. Gravity and friction are taken to act at the joint.
    (Spong: ASME Journal of Dynamic Systems, Measurement, and Control 109 (1987) 310, seen from the motor.)
    """

    words = "a part of the load behind a spring: a flexible transmission"
    rarity = 2.5
    # which it is where the spring is stiff, and where what hangs on it is so heavy that it stays
    refines = (("rotor_inertia",), ("spring",), ("spring", "torque_bias"))
    formula = "tau = -J (theta_ddot + delta_ddot), delta_ddot = -theta_ddot - 2 zeta omega delta_dot - omega^2 delta"
    start_sd = (0.05, 1.0)
    J: Value = parameter(0.0, unit="kg m^2", bounds=(0.0, math.inf), neutral=0.0)
    f: Value = parameter(10.0, unit="Hz", bounds=(0.2, 500.0), probe=_resonances)
    zeta: Value = parameter(0.03, unit="1", bounds=(0.0, 0.9), probe=(0.03,))

    def follow(self, states: Memory, stretch: Stretch) -> tuple[Value, Value, Memory]:
        """The exact solution at constant acceleration of the joint."""
        (delta, delta_dot), h = states, stretch.h
        omega = 2.0 * math.pi * self.f
        damped = omega * ops.sqrt(1.0 - self.zeta * self.zeta)
        a = (stretch.end - stretch.begin) / h
        sagging = -a / (omega * omega)
        decay = ops.exp(-self.zeta * omega * h)
        cosine, sine = decay * ops.cos(damped * h), decay * ops.sin(damped * h) / damped
        off, damping = delta - sagging, self.zeta * omega
        after = sagging + off * (cosine + damping * sine) + delta_dot * sine
        after_dot = delta_dot * (cosine - damping * sine) - off * (omega * omega * sine)
        torque = -self.J * (a + (after_dot - delta_dot) / h)
        slope = -self.J * (1.0 - sine / h) / h
        return torque, slope, (after, after_dot)


EFFECTS = (FlexibleTransmission,)
