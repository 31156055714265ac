"""Actuators: what turns a current, a voltage or a position command into the torque at the joint."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.physics import ops
from sysid.physics.effects.effect import Actuator
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter


@dataclass(frozen=True, eq=False)
class TorqueConstant(Actuator):
    """A motor that is driven by a current u [A]; k_t is its torque constant behind the gear."""

    label = "a motor driven by a current"
    formula = "tau = k_t u"
    command = "current"
    unit = "A"
    scale = "k_t"
    k_t: Value = parameter(1.0, unit="N m/A", bounds=(1e-6, 1e6), known=True)

    def torque(self, u: Value, theta: Value, theta_dot: Value) -> Value:
        return self.k_t * u


@dataclass(frozen=True, eq=False)
class DCMotor(Actuator):
    """A DC motor at a voltage u [V], or at a duty cycle times the supply.

    k is the torque constant over the winding's resistance, k_e the back-EMF constant, both behind the gear. Back-EMF
    moves the joint as viscous friction k k_e does: a log tells the two apart only where k_e is known.
    The winding's inductance is left out; a lag of the torque stands for it.
    """

    name = "dc_motor"
    label = "a DC motor driven by a voltage"
    formula = "tau = k (u - k_e theta_dot)"
    excludes = ("back_emf",)
    command = "voltage"
    unit = "V"
    scale = "k"
    damping = "k_e"
    k: Value = parameter(1.0, unit="N m/V", bounds=(1e-6, 1e6), known=True)
    k_e: Value = parameter(0.0, unit="V s/rad", bounds=(0.0, 1e4))

    def torque(self, u: Value, theta: Value, theta_dot: Value) -> Value:
        return self.k * (u - self.k_e * theta_dot)


@dataclass(frozen=True, eq=False)
class PositionServo(Actuator):
    """A servo that holds the angle u [rad].

    The servo closes its loop inside the drive, faster than the log was sampled: its torque follows the joint within a
    sample. A limit of 10^6 stands for none. Gains are those at the joint.
    """

    label = "a servo driven by a position command"
    formula = "tau = clip(k_p (u - theta) - k_d theta_dot, -limit, limit)"
    excludes = ("torque_gain", "dead_zone", "saturation", "coasting_drive")
    command = "position"
    unit = "rad"
    scale = "k_p"
    damping = "k_d"
    at_angle = True
    k_p: Value = parameter(1.0, unit="N m/rad", bounds=(1e-6, 1e6), known=True)
    k_d: Value = parameter(0.0, unit="N m s/rad", bounds=(0.0, 1e6))
    limit: Value = parameter(1e6, unit="N m", bounds=(1e-6, 1e6), known=True)

    def torque(self, u: Value, theta: Value, theta_dot: Value) -> Value:
        return ops.clip(self.k_p * (u - theta) - self.k_d * theta_dot, -self.limit, self.limit)
