"""Effects that a model may lack: one file for each family, and the catalogue of all."""

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
