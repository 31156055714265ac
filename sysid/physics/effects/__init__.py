"""What may be missing from a model: one file a family, and the catalogue of them all."""

from sysid.physics.effects.catalogue import ACTUATORS, CATALOGUE, effect, kind_of, preferred, register
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
