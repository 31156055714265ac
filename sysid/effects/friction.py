"""Torques that oppose motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sysid import ops
from sysid.effects.effect import Joint, JointEffect
from sysid.errors import InvalidInput
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
class Coulomb(JointEffect):
    """tau = -tau_c tanh(theta_dot / v_s): dry friction, smoothed over v_s [rad/s] so that derivatives exist.

    v_s is a setting of the approximation, no parameter: below v_s the joint creeps where a real one sticks.
    """

    friction: ClassVar[bool] = True
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, 10.0), neutral=0.0)
    v_s: float = 0.05

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.v_s > 0.0:
            raise InvalidInput(f"coulomb v_s = {self.v_s}: expected a positive speed [rad/s]")

    def torque(self, joint: Joint) -> Value:
        """-tau_c tanh(theta_dot / v_s) [N m]."""
        return -self.tau_c * ops.tanh(joint.theta_dot / self.v_s)


@dataclass(frozen=True, eq=False)
class QuadraticDrag(JointEffect):
    """tau = -c |theta_dot| theta_dot: air drag at high Reynolds number."""

    friction: ClassVar[bool] = True
    c: Value = parameter(0.0, unit="N m s^2/rad^2", bounds=(0.0, 10.0), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        """-c |theta_dot| theta_dot [N m]."""
        return -self.c * ops.abs(joint.theta_dot) * joint.theta_dot
