"""What may be missing from a model: one file a family, and the catalogue of them all."""

from sysid.physics.effects.actuation import (
    BackEmf,
    DeadZone,
    Delay,
    Lag,
    Saturation,
    Stamp,
    TorqueGain,
    TorqueSpeedLimit,
)
from sysid.physics.effects.catalogue import CATALOGUE, effect, register
from sysid.physics.effects.disturbance import Drift, Periodic, TorqueBias
from sysid.physics.effects.effect import DryFriction, Effect, InputEffect, Joint, JointEffect, OutputEffect, Reading
from sysid.physics.effects.friction import (
    AsymmetricCoulomb,
    AsymmetricViscous,
    Coulomb,
    Drag,
    Stribeck,
    Viscous,
    WarmingFriction,
)
from sysid.physics.effects.load import DirectionalLoadFriction, LoadFriction, Ripple, RotorInertia, Spring, Tilt
from sysid.physics.effects.sensing import (
    AngleOffset,
    Backlash,
    Eccentricity,
    FilteredSpeed,
    SensorDelay,
    VelocityBias,
    VelocityGain,
)

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
    "DirectionalLoadFriction",
    "Drag",
    "Drift",
    "DryFriction",
    "Eccentricity",
    "Effect",
    "FilteredSpeed",
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
    "TorqueSpeedLimit",
    "VelocityBias",
    "VelocityGain",
    "Viscous",
    "WarmingFriction",
    "effect",
    "register",
]
