"""The catalogue: every effect that can be named, ours and the user's."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

from sysid.effects.actuation import Delay, Lag
from sysid.effects.disturbance import TorqueBias
from sysid.effects.effect import Effect
from sysid.effects.friction import Coulomb, QuadraticDrag, Viscous
from sysid.errors import InvalidInput

CATALOGUE: dict[str, type[Effect]] = {
    kind.name: kind for kind in (Viscous, Coulomb, QuadraticDrag, TorqueBias, Delay, Lag)
}

EffectType = TypeVar("EffectType", bound=type[Effect])


def register(kind: EffectType) -> EffectType:
    """Class decorator: a user's effect joins the catalogue under its name (the class name in snake_case).

    Raises InvalidInput where the name is taken by another class.
    """
    known = CATALOGUE.get(kind.name)
    if known is not None and known is not kind:
        raise InvalidInput(f"an effect named {kind.name!r} is in the catalogue: give the class another name")
    CATALOGUE[kind.name] = kind
    return kind


def effect(name: str, **parameters: Any) -> Effect:
    """The effect of that name, at its neutral value where no other is given: effect("viscous", b=0.1)."""
    if name not in CATALOGUE:
        raise InvalidInput(f"unknown effect {name!r}: expected one of {', '.join(sorted(CATALOGUE))}")
    kind = CATALOGUE[name]
    known = [f.name for f in fields(kind)]
    for key in parameters:
        if key not in known:
            raise InvalidInput(f"effect {name!r} has no parameter {key!r}: it has {', '.join(known)}")
    return kind(**parameters)
