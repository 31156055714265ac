"""The catalogue: every effect that can be named, ours and the user's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from difflib import get_close_matches
from types import ModuleType
from typing import Any, TypeVar

from sysid.errors import LONGEST_SHOWN, InvalidInput, described, excerpt
from sysid.physics.effects import actuation, actuators, disturbance, friction, load, sensing
from sysid.physics.effects.effect import Actuator, Effect


def _declared(module: ModuleType) -> Iterator[tuple[str, Any]]:
    """The effects that a module declares, by name, in the order in which they stand there."""
    for kind in vars(module).values():
        if isinstance(kind, type) and issubclass(kind, Effect) and kind.__module__ == module.__name__:
            yield kind.name, kind


FAMILIES = (friction, load, disturbance, actuation, sensing)
CATALOGUE: dict[str, type[Effect]] = dict(pair for family in FAMILIES for pair in _declared(family))
ACTUATORS: dict[str, type[Actuator]] = dict(_declared(actuators))
"""The actuators, for models whose command is no torque. None is searched for: a log's columns show the command."""

EffectType = TypeVar("EffectType", bound=type[Effect])


def register(kind: EffectType) -> EffectType:
    """Class decorator: a user's effect joins the catalogue under its name, the class name in snake_case.

    Parameters
    ----------
    kind : type of Effect
        The class; see `Effect` for what it declares.

    Returns
    -------
    type of Effect
        The same class.

    Raises
    ------
    InvalidInput
        Where it is no effect, the name is taken by another class, or a declaration has another type than expected.
    """
    _check_declared(kind)
    known = CATALOGUE.get(kind.name)
    if known is not None and known is not kind:
        raise InvalidInput(f"an effect named {kind.name!r} is in the catalogue: give the class another name")
    CATALOGUE[kind.name] = kind
    return kind


def _check_declared(kind: type[Effect]) -> None:
    """Raise InvalidInput for what is no effect, and for a declaration that is of another type than `Effect`'s own."""
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise InvalidInput(f"{excerpt(kind)} is no effect: expected a class derived from JointEffect or another kind")
    for name in Effect.__annotations__:
        value, usual = getattr(kind, name), type(getattr(Effect, name))
        if not isinstance(value, (int, float) if usual is float else usual):
            raise InvalidInput(f"{kind.__name__}.{name} = {excerpt(value)}: expected a {usual.__name__}")
    if len(kind.name) > LONGEST_SHOWN:
        raise InvalidInput(
            f"{kind.__name__}: the name has {len(kind.name):,} characters: expected {LONGEST_SHOWN} at most"
        )


def preferred() -> tuple[str, ...]:
    """The effects that stand for others that a log cannot tell from them, the highest precedence first."""
    ranked = sorted(CATALOGUE.values(), key=lambda kind: kind.precedence, reverse=True)
    return tuple(kind.name for kind in ranked if kind.precedence > 0)


def kind_of(name: str) -> type[Effect]:
    """The class of the effect or actuator of that name; raises InvalidInput where it is unknown, near names first."""
    known: dict[str, type[Effect]] = {**CATALOGUE, **ACTUATORS}
    if not isinstance(name, str):
        raise InvalidInput(f"effect {described(name)}: expected its name, one of {', '.join(known)}")
    if name not in known:
        near = get_close_matches(name, known, n=3, cutoff=0.5)
        perhaps = f"did you mean {' or '.join(near)}? E" if near else "e"
        raise InvalidInput(f"unknown effect {name!r}: {perhaps}xpected one of {', '.join(known)}")
    return known[name]


def effect(name: str, **parameters: Any) -> Effect:
    """The effect or actuator of that name, at its neutral value where no other is given: effect("viscous", b=0.1).

    Parameters
    ----------
    name : str
        A name of the catalogue; `sysid effects` lists them.
    **parameters : float
        Numbers by field.

    Returns
    -------
    Effect
        To be put into a model by `Model.with_effect`.

    Raises
    ------
    InvalidInput
        For an unknown name, the near ones first, and for an unknown parameter.
    """
    kind = kind_of(name)
    known = [f.name for f in fields(kind)]
    for key in parameters:
        if key not in known:
            raise InvalidInput(f"effect {name!r} has no parameter {key!r}: it has {', '.join(known)}")
    return kind(**parameters)
