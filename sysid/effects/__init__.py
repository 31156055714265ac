"""What may be missing from a model: one file a family, and the catalogue of them all."""

from sysid.effects.actuation import Delay, Lag
from sysid.effects.catalogue import CATALOGUE, effect, register
from sysid.effects.disturbance import TorqueBias
from sysid.effects.effect import DryFriction, Effect, InputEffect, Joint, JointEffect, OutputEffect, Reading
from sysid.effects.friction import Coulomb, QuadraticDrag, Viscous

__all__ = [
    "CATALOGUE",
    "Coulomb",
    "Delay",
    "DryFriction",
    "Effect",
    "InputEffect",
    "Joint",
    "JointEffect",
    "Lag",
    "OutputEffect",
    "QuadraticDrag",
    "Reading",
    "TorqueBias",
    "Viscous",
    "effect",
    "register",
]
