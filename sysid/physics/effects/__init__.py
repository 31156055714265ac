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
from sysid.physics.effects.actuators import DCMotor, PositionServo, TorqueConstant
from sysid.physics.effects.catalogue import ACTUATORS, CATALOGUE, effect, kind_of, preferred, register
from sysid.physics.effects.disturbance import Drift, Periodic, TorqueBias
from sysid.physics.effects.effect import (
    Actuator,
    DryFriction,
    DynamicEffect,
    Effect,
    InputEffect,
    Joint,
    JointEffect,
    OutputEffect,
    Reading,
)
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
from sysid.physics.effects.presliding import Dahl, LuGre
from sysid.physics.effects.sensing import (
    AngleOffset,
    Backlash,
    Eccentricity,
    FilteredSpeed,
    SensorDelay,
    VelocityBias,
    VelocityGain,
)
from sysid.physics.effects.transmission import FlexibleTransmission
