"""What may be missing from a model: one file a family, and the catalogue of them all."""

from sysid.effects.actuation import BackEmf, DeadZone, Delay, Lag, Saturation, Stamp, TorqueGain
from sysid.effects.catalogue import CATALOGUE, effect, register
from sysid.effects.disturbance import Drift, Periodic, TorqueBias
from sysid.effects.effect import DryFriction, Effect, InputEffect, Joint, JointEffect, OutputEffect, Reading
from sysid.effects.friction import AsymmetricCoulomb, AsymmetricViscous, Coulomb, Drag, Stribeck, Viscous
from sysid.effects.load import LoadFriction, Ripple, RotorInertia, Spring, Tilt
from sysid.effects.sensing import AngleOffset, Backlash, SensorDelay, VelocityBias, VelocityGain

__all__ = [
    "CATALOGUE",
    "AngleOffset",
    "AsymmetricCoulomb",
    "AsymmetricViscous",
    "BackEmf",
    "Backlash",
    "Coulomb",
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
    "TorqueGain",
    "VelocityBias",
    "VelocityGain",
    "Viscous",
    "effect",
    "register",
]
