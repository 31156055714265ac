"""What may be missing from a model: one file a family, and the catalogue of them all."""

from sysid.physics.effects.actuation import BackEmf, DeadZone, Delay, Lag, Saturation, Stamp, TorqueGain
from sysid.physics.effects.actuators import DCMotor, PositionServo, TorqueConstant
from sysid.physics.effects.catalogue import ACTUATORS, CATALOGUE, effect, kind_of, preferred, register
from sysid.physics.effects.disturbance import Drift, Periodic, TorqueBias
from sysid.physics.effects.effect import (
    Actuator,
    DryFriction,
    Effect,
    InputEffect,
    Joint,
    JointEffect,
    OutputEffect,
    Reading,
)
from sysid.physics.effects.friction import AsymmetricCoulomb, AsymmetricViscous, Coulomb, Drag, Stribeck, Viscous
from sysid.physics.effects.load import LoadFriction, Ripple, RotorInertia, Spring, Tilt
from sysid.physics.effects.sensing import AngleOffset, Backlash, SensorDelay, VelocityBias, VelocityGain

__all__ = [
    "ACTUATORS",
    "CATALOGUE",
    "Actuator",
    "AngleOffset",
    "AsymmetricCoulomb",
    "AsymmetricViscous",
    "BackEmf",
    "Backlash",
    "Coulomb",
    "DCMotor",
    "DeadZone",
    "Delay",
    "Drag",
    "Drift",
    "DryFriction",
    "Effect",
    "InputEffect",
    "Joint",
    "JointEffect",
    "Lag",
    "LoadFriction",
    "OutputEffect",
    "Periodic",
    "PositionServo",
    "Reading",
    "Ripple",
    "RotorInertia",
    "Saturation",
    "SensorDelay",
    "Spring",
    "Stamp",
    "Stribeck",
    "Tilt",
    "TorqueBias",
    "TorqueConstant",
    "TorqueGain",
    "VelocityBias",
    "VelocityGain",
    "Viscous",
    "effect",
    "kind_of",
    "preferred",
    "register",
]
