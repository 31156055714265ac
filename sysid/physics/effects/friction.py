"""Torques that oppose motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sysid.physics import ops
from sysid.physics.effects.effect import DryFriction, Joint, JointEffect
from sysid.physics.effects.probes import of_duration
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter

ONE_WAY = 0.1
"""Share of one direction's friction below which that of the other stands for an offset, not for friction."""


@dataclass(frozen=True, eq=False)
class Viscous(JointEffect):
    """Viscous friction: oil, grease, slow air."""

    words = "viscous friction"
    precedence = 2
    begins: ClassVar[Mapping[str, float]] = {"b": 0.02}
    rarity = 0.0
    formula = "tau = -b theta_dot"
    confused = ("back_emf", "drag", "asymmetric_viscous", "load_friction", "coulomb")
    friction = True
    brakes = True
    b: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, math.inf), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return -self.b * joint.theta_dot


@dataclass(frozen=True, eq=False)
class Coulomb(DryFriction):
    """Dry friction, which at rest holds up to tau_c: seals, brushes, preloaded bearings."""

    words = "dry friction"
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

    words = "dry friction that is larger at slow speed"
    refines = (("coulomb",),)
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

    words = "air drag"
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

    words = "viscous friction that depends on the direction"
    rarity = 3.0
    refines = (("viscous",), ("viscous", "tilt"), ("viscous", "torque_bias"))
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
    """Dry friction that depends on the direction; at rest it holds between the two.

    Where the joint never stands, Coulomb friction of the mean and a torque bias of half the difference move alike.
    """

    words = "dry friction that depends on the direction"
    rarity = 3.0
    refines = (("coulomb",), ("coulomb", "tilt"), ("coulomb", "torque_bias"))
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

    Friction falls by `excess` to tau_c with the time constant T of the machine's heat, which takes seconds at least; t
    is the time from the start of each record, before which the machine has rested. With excess = 0 it is Coulomb
    friction.
    """

    words = "dry friction that falls as the machine warms up"
    rarity = 3.5
    refines = (("coulomb",), ("coulomb", "drift"))
    formula = "tau = -(tau_c + excess exp(-t/T)) sign(theta_dot)"
    confused = ("coulomb", "drift")
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    excess: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    T: Value = parameter(60.0, unit="s", bounds=(2.0, 1e4), probe=of_duration(0.25, 1.0))

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        limit = self.tau_c + self.excess * ops.exp(-joint.t / self.T)
        return limit, limit


def _rubs_both_ways(plus: Value, minus: Value) -> bool:
    return bool(min(plus, minus) >= ONE_WAY * max(plus, minus))


EFFECTS = (Viscous, Coulomb, Stribeck, Drag, AsymmetricViscous, AsymmetricCoulomb, WarmingFriction)
