"""Loads: torques that depend on the angle or on the load, and inertia that is added rigidly or through a spring."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sysid.physics import ops
from sysid.physics.effects.disturbance import period_of
from sysid.physics.effects.effect import DryFriction, DynamicEffect, Joint, JointEffect, Memory, Stretch
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Extent, parameter

LARGEST_SHARE = 0.95
"""Share of the load, at most, that friction may take if the machine is to move."""
LARGEST_ROTOR = 0.9
"""Share of a machine's inertia, at most, that is believed to be its rotor's."""
FURTHEST_WOUND = 10.0
"""Reach of a motion [rad] from which no spring is believed: a wheel that turns round and round winds none."""
LOWEST_RESONANCE = 3.5
"""Times a free swing's own frequency from which a resonance is believed: the swing has next to no higher harmonics."""


@dataclass(frozen=True, eq=False)
class LoadFriction(DryFriction):
    """Dry friction of a gear or a screw that presses harder the more torque it transmits.

    load is the torque of gravity and every effect that is not friction. Where drive and load oppose each other, as when
    a weight is lifted or held, the gear is pressed between them; where both pull the same way, it is relieved. (Model
    M3 of Duclusaud, Passault, Padois, Ly: Extended Friction Models for the Physics Simulation of Servo Actuators, arXiv
    2410.08650.)
    """

    label = "dry friction that grows with the load"
    refines = (("coulomb",),)
    formula = "tau = -mu |drive - load| sign(theta_dot), at rest up to mu |drive - load|"
    confused = ("viscous", "coulomb", "back_emf", "directional_load_friction")
    begins: ClassVar[Mapping[str, float]] = {"mu": 0.2}
    mu: Value = parameter(0.0, unit="1", bounds=(0.0, 1.0), neutral=0.0)

    @property
    def plausible(self) -> bool:
        """Whether what drives the joint can move it."""
        return float(self.mu) < LARGEST_SHARE

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        limit = self.mu * ops.abs(joint.drive - joint.load)
        return limit, limit


@dataclass(frozen=True, eq=False)
class DirectionalLoadFriction(DryFriction):
    """Dry friction of a gear that is pressed by the torque that it transmits, of which the motor's rotor keeps a part.

    A gear transmits the drive's torque less what accelerates the rotor: with the share of all inertia that is the
    rotor's, and before friction,

        drive - share (drive + load) = (1 - share) drive - share load

    With a small share it loses less when the load drives it back than when it drives. share = 1/2 is LoadFriction, with
    twice its mu. (Model M5 of the paper that LoadFriction names, without its Stribeck part: its two numbers are
    mu (1 - share) and mu share.)
    """

    label = "dry friction that grows with the torque that a gear transmits beside what turns the rotor"
    rarity = 3.5
    refines = (("load_friction",), ("coulomb",))
    contains = ("load_friction",)
    formula = "tau = -mu |(1 - share) drive - share load| sign(theta_dot)"
    confused = ("load_friction", "coulomb")
    mu: Value = parameter(0.0, unit="1", bounds=(0.0, 2.0), neutral=0.0)
    share: Value = parameter(0.3, unit="1", bounds=(0.0, 1.0), probe=(0.1, 0.5, 0.9))

    @property
    def plausible(self) -> bool:
        """Whether the drive can move the joint, and not next to all of the inertia is the rotor's."""
        return float(self.share) < LARGEST_ROTOR and float(self.mu * (1.0 - self.share)) < LARGEST_SHARE

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        limit = self.mu * ops.abs(joint.drive - self.share * (joint.drive + joint.load))
        return limit, limit


@dataclass(frozen=True, eq=False)
class Tilt(JointEffect):
    """A base that leans by alpha, or a weight that hangs alpha off the zero of the angle.

    For a fixed axis it cannot be told from an encoder that reads alpha too little. Without gravity it does nothing.
    """

    label = "a base that leans"
    precedence = 3
    rarity = 1.0
    imitates = "theta"
    moves_rest = True
    formula = "tau = gravity_torque(theta + alpha) - gravity_torque(theta)"
    confused = ("angle_offset", "torque_bias", "eccentricity")
    alpha: Value = parameter(0.0, unit="rad", bounds=(-math.pi, math.pi), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return joint.plant.gravity_torque(joint.theta + self.alpha) - joint.gravity


@dataclass(frozen=True, eq=False)
class Spring(JointEffect):
    """A spring or a cable that is slack where the pendulum hangs, at theta = pi, or at the zero of a linear axis.

    theta is unwrapped, so each turn winds it further. A rest angle elsewhere shows as a torque bias beside it.
    """

    label = "a spring"
    imitates = "theta"
    formula = "tau = -k (theta - rest)"
    confused: ClassVar[tuple[str, ...]] = ("torque_bias", "ripple", "cubic_spring")
    k: Value = parameter(0.0, unit="N m/rad", bounds=(-math.inf, math.inf), neutral=0.0)

    @property
    def plausible(self) -> bool:
        """Whether it pulls back. What pushes outwards stands for something else, such as an uneven scale."""
        return float(self.k) >= 0.0

    def resolved(self, sd: float, reach: float, joint: Joint) -> bool:
        """Whether the motion stays within FURTHEST_WOUND."""
        return reach < FURTHEST_WOUND

    def torque(self, joint: Joint) -> Value:
        return -self.k * (joint.theta - joint.plant.rest)


@dataclass(frozen=True, eq=False)
class CubicSpring(Spring):
    """A spring that grows stiffer the further it is bent: rubber, a membrane, a beam between two walls.

    With it an axis is Duffing's oscillator (Nayfeh, Mook: Nonlinear Oscillations, ch. 4). k_3 = 0 is Spring. One that
    softens is left out: bent far enough it pushes outwards, and what it holds runs away.
    """

    label = "a spring that grows stiffer"
    rarity = 2.5
    refines = (("spring",), ("spring", "torque_bias"))
    contains = ("spring",)
    formula = "tau = -k x - k_3 x^3, x = theta - rest"
    confused = ("spring",)
    k_3: Value = parameter(0.0, unit="N m/rad^3", bounds=(0.0, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        x = joint.theta - joint.plant.rest
        return -(self.k + self.k_3 * x * x) * x


@dataclass(frozen=True, eq=False)
class Ripple(JointEffect):
    """A torque that repeats over the angle: cogging of a motor, an eccentric gear.

    `order` counts the waves in a turn. Order 1 is left out: that is gravity.
    """

    label = "a ripple over the angle"
    rarity = 3.0
    imitates = "theta"
    formula = "tau = a sin(order theta) + b cos(order theta)"
    confused = ("spring", "periodic", "eccentricity")
    a: Value = parameter(0.0, unit="N m", bounds=(-math.inf, math.inf), neutral=0.0)
    b: Value = parameter(0.0, unit="N m", bounds=(-math.inf, math.inf), neutral=0.0)
    order: Value = parameter(6.0, unit="1", bounds=(2.0, 60.0), probe=tuple(float(n) for n in range(2, 25)))

    def recurrences(self, theta: Array, t: Array, u: Array) -> float:
        """Waves along the motion; one less in a free swing, where an uneven scale looks like a wave."""
        return float(self.order * np.ptp(theta)) / (2.0 * math.pi) - (0.0 if np.any(u) else 1.0)

    def torque(self, joint: Joint) -> Value:
        phase = self.order * joint.theta
        return self.a * ops.sin(phase) + self.b * ops.cos(phase)


@dataclass(frozen=True, eq=False)
class RotorInertia(JointEffect):
    """The inertia of the motor's rotor, seen through its gear, beside the plant's own. It adds no weight.

    With m and l (or J) free it does not show in the motion: weigh the pendulum, or hang a known payload on it.
    """

    label = "a rotor's inertia"
    inertial = True
    formula = "(J + J_r) theta_ddot = ..."
    confused = ("torque_gain",)
    J_r: Value = parameter(0.0, unit="kg m^2", bounds=(0.0, math.inf), neutral=0.0)

    def inertia(self) -> Value:
        return self.J_r

    def torque(self, joint: Joint) -> Value:
        return 0.0


def _resonances(extent: Extent) -> tuple[float, ...]:
    """Resonances [Hz] to try: from 1 Hz, or three periods in the log, up to 0.3 of the sample rate."""
    low, high = max(1.0, 3.0 / extent.duration), 0.3 / extent.dt
    count = max(2, 1 + round(2.0 * math.log2(max(high / low, 2.0))))
    return tuple(low * (high / low) ** (k / (count - 1)) for k in range(count))


@dataclass(frozen=True, eq=False)
class FlexibleTransmission(DynamicEffect):
    """A part J of the load that hangs on a spring behind the sensor.

    Examples are a harmonic drive, a belt, a long shaft, a sloshing load. delta [rad] is the angle of J against the
    joint, omega = 2 pi f, f [Hz] the resonance with the joint held. Gravity and friction are taken to act at the joint.
    (Spong: ASME Journal of Dynamic Systems, Measurement, and Control 109 (1987) 310, seen from the motor.)
    """

    label = "a part of the load behind a spring: a flexible transmission"
    rarity = 2.5
    # its limits: a stiff spring, and a load so heavy that it stays where it is
    refines = (("rotor_inertia",), ("spring",), ("spring", "torque_bias"))
    formula = "tau = -J (theta_ddot + delta_ddot), delta_ddot = -theta_ddot - 2 zeta omega delta_dot - omega^2 delta"
    start_sd = (0.05, 1.0)
    J: Value = parameter(0.0, unit="kg m^2", bounds=(0.0, math.inf), neutral=0.0)
    f: Value = parameter(10.0, unit="Hz", bounds=(0.2, 500.0), probe=_resonances)
    zeta: Value = parameter(0.03, unit="1", bounds=(0.0, 0.9), probe=(0.03,))

    def recurrences(self, theta: Array, t: Array, u: Array) -> float:
        """0 if a free swing comes back within LOWEST_RESONANCE of its periods: the swing's own second or third harmonic
        is all that shakes it then, and any function of the motion has these."""
        waves = float(self.f) * period_of(theta, t)
        return 0.0 if not np.any(u) and 0.0 < waves < LOWEST_RESONANCE else math.inf

    def follow(self, states: Memory, stretch: Stretch) -> tuple[Value, Value, Memory]:
        """The exact solution for a constant acceleration of the joint."""
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
