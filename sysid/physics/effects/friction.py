"""Torques that oppose motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sysid.physics import ops
from sysid.physics.effects.effect import DryFriction, DynamicEffect, Joint, JointEffect, Memory, Stretch
from sysid.physics.ops import Value
from sysid.physics.parameters import of_duration, parameter

ONE_WAY = 0.1
"""If one direction's friction is less than this share of the other's, they stand for an offset, not for friction."""
WARM_SHARE = 0.1
"""Least share of a cold machine's friction that is left in a warm one."""
LARGEST_GIVE = 0.1
"""Share of a motion's reach, at most, by which a contact gives before it slides. One that gives by more is a spring,
and beside swings of several amplitudes it imitates two frictions."""


@dataclass(frozen=True, eq=False)
class Viscous(JointEffect):
    """Viscous friction: oil, grease, slow air."""

    label = "viscous friction"
    precedence = 2
    begins: ClassVar[Mapping[str, float]] = {"b": 0.02}
    rarity = 0.0
    formula = "tau = -b theta_dot"
    confused = ("back_emf", "coasting_drive", "drag", "asymmetric_viscous", "load_friction", "coulomb")
    friction = True
    brakes = True
    b: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return -self.b * joint.theta_dot


@dataclass(frozen=True, eq=False)
class Coulomb(DryFriction):
    """Dry friction, which at rest holds up to tau_c: seals, brushes, preloaded bearings."""

    label = "dry friction"
    begins: ClassVar[Mapping[str, float]] = {"tau_c": 0.05}
    rarity = 0.0
    formula = "tau = -tau_c sign(theta_dot), at rest up to tau_c"
    confused = (
        "viscous",
        "stribeck",
        "asymmetric_coulomb",
        "warming_friction",
        "dahl",
        "lugre",
        "load_friction",
        "directional_load_friction",
        "torque_gain",
        "dead_zone",
    )
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        return self.tau_c, self.tau_c


@dataclass(frozen=True, eq=False)
class Stribeck(DryFriction):
    """Dry friction of a lubricated contact, which falls by `excess` as the joint comes up to a few v_s.

    At rest it holds up to tau_c + excess. With excess = 0 it is Coulomb friction. (Armstrong-Helouvry, Dupont, Canudas
    de Wit: Automatica 30 (1994) 1083, with exponent 2.)
    """

    label = "dry friction that is larger at slow speed"
    refines = (("coulomb",), ("coulomb", "drag"))
    contains = ("coulomb",)
    formula = "tau = -(tau_c + excess exp(-(theta_dot/v_s)^2)) sign(theta_dot)"
    confused = ("coulomb", "dahl", "lugre")
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    excess: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    v_s: Value = parameter(0.15, unit="rad/s", bounds=(0.005, 10.0), probe=(0.05, 0.15, 0.5))

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        ratio = joint.theta_dot / self.v_s
        limit = self.tau_c + self.excess * ops.exp(-ratio * ratio)
        return limit, limit


@dataclass(frozen=True, eq=False)
class Drag(JointEffect):
    """Air drag at high Reynolds number."""

    label = "air drag"
    begins: ClassVar[Mapping[str, float]] = {"c": 0.005}
    rarity = 1.5
    formula = "tau = -c |theta_dot| theta_dot"
    confused = ("viscous", "back_emf")
    friction = True
    c: Value = parameter(0.0, unit="N m s^2/rad^2", bounds=(0.0, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return -self.c * ops.abs(joint.theta_dot) * joint.theta_dot


@dataclass(frozen=True, eq=False)
class AsymmetricViscous(JointEffect):
    """Viscous friction that depends on the direction: a worm, a check valve."""

    label = "viscous friction that depends on the direction"
    rarity = 3.0
    refines = (("viscous",), ("viscous", "tilt"), ("viscous", "torque_bias"))
    contains = ("viscous",)
    formula = "tau = -b_plus max(theta_dot, 0) - b_minus min(theta_dot, 0)"
    confused = ("viscous", "asymmetric_coulomb")
    friction = True
    b_plus: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, math.inf), neutral=0.0)
    b_minus: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, math.inf), neutral=0.0)

    @property
    def plausible(self) -> bool:
        return _rubs_both_ways(self.b_plus, self.b_minus)

    def torque(self, joint: Joint) -> Value:
        return -self.b_plus * ops.maximum(joint.theta_dot, 0.0) - self.b_minus * ops.minimum(joint.theta_dot, 0.0)


@dataclass(frozen=True, eq=False)
class AsymmetricCoulomb(DryFriction):
    """Dry friction that depends on the direction; at rest it holds up to either limit.

    If the joint never stands, Coulomb friction of the mean and a torque bias of half the difference act alike.
    """

    label = "dry friction that depends on the direction"
    rarity = 3.0
    refines = (("coulomb",), ("coulomb", "tilt"), ("coulomb", "torque_bias"))
    contains = ("coulomb",)
    formula = "tau = -tau_plus (theta_dot > 0), +tau_minus (theta_dot < 0)"
    confused = ("coulomb", "torque_bias", "asymmetric_viscous")
    tau_plus: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    tau_minus: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)

    @property
    def plausible(self) -> bool:
        return _rubs_both_ways(self.tau_plus, self.tau_minus)

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        return self.tau_plus, self.tau_minus


@dataclass(frozen=True, eq=False)
class WarmingFriction(DryFriction):
    """Dry friction of a grease that warms up; at rest it holds up to as much.

    It falls by `excess` to tau_c with the time constant T of the machine's heat, which is seconds at least. t is the
    time from the start of each record, before which the machine has rested. With excess = 0 it is Coulomb friction.
    """

    label = "dry friction that falls as the machine warms up"
    rarity = 3.5
    refines = (("coulomb",), ("coulomb", "drift"), ("viscous", "coulomb"), ("viscous", "coulomb", "drag"))
    contains = ("coulomb",)
    formula = "tau = -(tau_c + excess exp(-t/T)) sign(theta_dot)"
    confused = ("coulomb", "drift")
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    excess: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    T: Value = parameter(60.0, unit="s", bounds=(2.0, 1e4), probe=of_duration(0.25, 1.0))

    @property
    def plausible(self) -> bool:
        """Whether a tenth of the friction is left in a warm machine."""
        return float(self.tau_c) >= WARM_SHARE * float(self.tau_c + self.excess)

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        limit = self.tau_c + self.excess * ops.exp(-joint.t / self.T)
        return limit, limit


@dataclass(frozen=True, eq=False)
class Dahl(DynamicEffect):
    """Dry friction that builds up over a travel.

    Before a joint slides, the contact gives like a spring of tau_c / z_s [N m/rad]. w is its deflection in units of z_s
    [rad], and 1 when it slides forwards. For z_s -> 0 it is Coulomb friction. (Dahl: Aerospace Corporation
    TOR-0158(3107-18)-1, 1968.)
    """

    label = "dry friction that gives like a spring before it slides"
    rarity = 2.5
    is_dry = True
    begins: ClassVar[Mapping[str, float]] = {"tau_c": 0.05}
    refines: ClassVar[tuple[tuple[str, ...], ...]] = (("coulomb",),)
    contains: ClassVar[tuple[str, ...]] = ("coulomb",)
    formula = "tau = -tau_c w, dw/dt = (theta_dot - |theta_dot| w) / z_s"
    confused = ("coulomb", "stribeck", "lugre")
    start_sd = (0.5,)
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    z_s: Value = parameter(0.01, unit="rad", bounds=(1e-5, 1.0), probe=(0.003, 0.02, 0.1))

    def resolved(self, sd: float, reach: float, joint: Joint) -> bool:
        """Whether z_s is above the sd (otherwise readings show Coulomb friction) and below a large share of the reach
        (otherwise the joint hardly slides)."""
        return sd < float(self.z_s) < LARGEST_GIVE * reach

    def sliding(self, theta_dot: Value) -> tuple[Value, Value]:
        """The largest friction [N m], and the share of it that is left at a speed theta_dot [rad/s]."""
        return self.tau_c, 1.0

    def follow(self, states: Memory, stretch: Stretch) -> tuple[Value, Value, Memory]:
        """The exact solution at the mean speed of the stretch."""
        (w,) = states
        largest, share = self.sliding(stretch.travel / stretch.h)
        end = ops.where(stretch.travel > 0.0, share, -share)
        r = ops.maximum(ops.abs(stretch.travel) / (share * self.z_s), 1e-6)
        left = ops.exp(-r)
        mean = (1.0 - left) / r
        torque = -largest * (end + (w - end) * mean)
        slope = largest * (w - end) * (mean - left) / (r * end * self.z_s)
        return torque, 0.5 * stretch.h * slope, (end + (w - end) * left,)


@dataclass(frozen=True, eq=False)
class LuGre(Dahl):
    """Dahl's friction with Stribeck's curve s.

    A joint that slides feels ratio tau_c s: ratio tau_c [N m] at slow speed, tau_c at a few v_s [rad/s]. The bristle's
    own damping is left out; viscous friction is an effect of its own. (Canudas de Wit, Olsson, Astrom, Lischinsky: IEEE
    Transactions on Automatic Control 40 (1995) 419.)
    """

    name = "lugre"
    label = "dry friction that gives like a spring and is larger at slow speed"
    rarity = 3.5
    refines = (("coulomb",), ("dahl",), ("stribeck",))
    contains = ("coulomb", "dahl", "stribeck")
    formula = (
        "tau = -ratio tau_c w, dw/dt = (theta_dot - |theta_dot| w / s) / z_s, "
        "s = (1 + (ratio - 1) exp(-(theta_dot/v_s)^2)) / ratio"
    )
    confused = ("coulomb", "stribeck", "dahl")
    ratio: Value = parameter(1.5, unit="1", bounds=(1.0, 20.0), probe=(1.5,))
    v_s: Value = parameter(0.15, unit="rad/s", bounds=(0.005, 10.0), probe=(0.05, 0.3))

    def sliding(self, theta_dot: Value) -> tuple[Value, Value]:
        """ratio tau_c, and the share of it that Stribeck's curve leaves."""
        speed = theta_dot / self.v_s
        return self.ratio * self.tau_c, (1.0 + (self.ratio - 1.0) * ops.exp(-speed * speed)) / self.ratio


def _rubs_both_ways(plus: Value, minus: Value) -> bool:
    return bool(min(plus, minus) >= ONE_WAY * max(plus, minus))
