"""Torques that oppose motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sysid import ops
from sysid.effects.effect import DryFriction, Joint, JointEffect
from sysid.ops import Value
from sysid.parameters import parameter


@dataclass(frozen=True, eq=False)
class Viscous(JointEffect):
    """tau = -b theta_dot."""

    friction: ClassVar[bool] = True
    b: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, 10.0), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        """-b theta_dot [N m]."""
        return -self.b * joint.theta_dot


@dataclass(frozen=True, eq=False)
class Coulomb(DryFriction):
    """tau = -tau_c sign(theta_dot); at rest it holds up to tau_c."""

    formula: ClassVar[str] = "tau = -tau_c sign(theta_dot), at rest up to tau_c"
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, 10.0), neutral=0.0)

    def limits(self, joint: Joint) -> tuple[Value, Value]:
        """tau_c both ways [N m]."""
        return self.tau_c, self.tau_c


@dataclass(frozen=True, eq=False)
class QuadraticDrag(JointEffect):
    """tau = -c |theta_dot| theta_dot: air drag at high Reynolds number."""

    friction: ClassVar[bool] = True
    c: Value = parameter(0.0, unit="N m s^2/rad^2", bounds=(0.0, 10.0), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        """-c |theta_dot| theta_dot [N m]."""
        return -self.c * ops.abs(joint.theta_dot) * joint.theta_dot
