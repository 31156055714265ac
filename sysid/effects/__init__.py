"""What may be missing from a model: one file a family, and the catalogue of them all."""

from sysid.effects.actuation import Delay, Lag
from sysid.effects.catalogue import CATALOGUE, effect, register
from sysid.effects.disturbance import TorqueBias
from sysid.effects.effect import Effect, InputEffect, Joint, JointEffect
from sysid.effects.friction import Coulomb, QuadraticDrag, Viscous

__all__ = [
    "CATALOGUE",
    "Coulomb",
    "Delay",
    "Effect",
    "InputEffect",
    "Joint",
    "JointEffect",
    "Lag",
    "QuadraticDrag",
    "TorqueBias",
    "Viscous",
    "effect",
    "register",
]
