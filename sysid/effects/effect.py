"""The kinds of effect: what may stand between command and torque, and at the joint."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from sysid.ops import Value
from sysid.parameters import Parametric
from sysid.plants import Plant

Memory = tuple[Value, ...]


class Joint(NamedTuple):
    """What a joint effect sees: theta [rad], theta_dot [rad/s], t [s], the drive torque [N m], the plant, and
    `load` [N m] = gravity + drive + all effects that are not friction (0 while those are being summed)."""

    theta: Value
    theta_dot: Value
    t: Value
    drive: Value
    load: Value
    plant: Plant


@dataclass(frozen=True, eq=False)
class Effect(Parametric):
    """A physical effect that a model may or may not have: an InputEffect or a JointEffect."""

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "name" not in cls.__dict__:
            cls.name = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    name: ClassVar[str] = "effect"

    def at_neutral(self) -> Any:
        """The same effect with its parameters at the values at which it changes nothing."""
        return self.with_parameters({k: p.neutral for k, p in self.parameters.items() if p.neutral is not None})


@dataclass(frozen=True, eq=False)
class InputEffect(Effect):
    """Maps the command to the drive torque; depends on the command alone, not on the joint's state.

    A signal over one control interval is a tuple of means over its substeps. Effects act in the order of
    `stage`: static ones (0), then delay (1), then lag (2).
    """

    stage: ClassVar[int] = 0

    def rest(self, dt: float) -> Memory:
        """The memory after a long time without command; () for a static effect."""
        return ()

    @abstractmethod
    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """The signal after this effect over one interval dt [s], and the memory for the next interval."""


@dataclass(frozen=True, eq=False)
class JointEffect(Effect):
    """Adds a torque, and where it has one an inertia, at the joint. Frictions are summed last."""

    friction: ClassVar[bool] = False

    def inertia(self) -> Value:
        """Added inertia [kg m^2]."""
        return 0.0

    @abstractmethod
    def torque(self, joint: Joint) -> Value:
        """Torque on the joint [N m]; positive raises theta."""
