"""Hidden plants. This module loads nothing heavy.

Sizes of the hidden effects are those that dynamic programming found dear (`python -m study.mismatch.effect_cost`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sysid import Effect


@dataclass(frozen=True)
class HiddenPlant:
    """A machine with one effect, of the catalogue or outside it; None: the plain rod.

    numbers   the effect's parameters (name, value)
    percent   what it costs an optimal policy not to know it, in percent of the return, by the programs of
              `effect_cost`; a record: nothing is computed from it
    """

    name: str
    effect: str | None = None
    numbers: tuple[tuple[str, float], ...] = ()
    percent: float = 0.0

    @property
    def in_catalogue(self) -> bool | None:
        """Whether the catalogue has its effect; None without one."""
        from sysid import CATALOGUE

        return None if self.effect is None else self.effect in CATALOGUE

    @cached_property
    def hidden_effect(self) -> Effect | None:
        """What the plant has and the prior lacks. Raises InvalidInput for an unknown effect."""
        from study.trials.outside_effects import OUTSIDE
        from sysid import effect

        if self.effect is None:
            return None
        numbers = dict(self.numbers)
        return OUTSIDE[self.effect](**numbers) if self.effect in OUTSIDE else effect(self.effect, **numbers)

    @property
    def noun(self) -> str:
        """The kind of effect in words: "delay"."""
        if self.effect is None:
            return "nothing missing"
        return _NOUNS.get(self.effect, self.effect.replace("_", " "))

    @property
    def size(self) -> str:
        """The effect's first number with its unit: "0.155 s"; nothing for the plain plant."""
        if self.hidden_effect is None:
            return ""
        name, value = self.numbers[0]
        return f"{value:g} {self.hidden_effect.parameters[name].unit}".removesuffix(" 1")

    @property
    def title(self) -> str:
        """What the plant has and the prior lacks: "delay 0.155 s"."""
        return f"{self.noun} {self.size}".rstrip()


_NOUNS = {"coulomb": "Coulomb friction", "slew_limit": "slew limit"}

PLAIN = HiddenPlant("plain")
COULOMB = HiddenPlant("coulomb", "coulomb", (("tau_c", 1.5),), 3.9)
DELAY_MEDIUM = HiddenPlant("delay_medium", "delay", (("T", 0.126),), 9.9)
DELAY_LARGE = HiddenPlant("delay_large", "delay", (("T", 0.155),), 30.0)
MAGNET = HiddenPlant("magnet", "magnet", (("k", 1.25),), 29.1)
SLEW = HiddenPlant("slew", "slew_limit", (("rate", 8.5),), 28.4)

ALL_PLANTS = (PLAIN, COULOMB, DELAY_MEDIUM, DELAY_LARGE, MAGNET, SLEW)
