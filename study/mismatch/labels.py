"""Hidden plants and strategies in words, the same in figures, tables and sentences."""

from __future__ import annotations

from study.mismatch.plan import HiddenPlant, StrategyKey

RUNGS: dict[str, str] = {
    StrategyKey.PRIOR: "prior", StrategyKey.FITTED: "fitted", StrategyKey.MENDED: "mended", StrategyKey.ORACLE: "oracle"
}  # fmt: skip
"""The ladder, from knowing nothing to knowing everything."""

_NOUNS = {"coulomb": "Coulomb friction", "slew_limit": "slew limit"}


def plant_title(plant: HiddenPlant) -> str:
    """What the plant has and the prior lacks: "delay 0.155 s"."""
    return f"{plant_noun(plant)} {plant_size(plant)}".rstrip()


def plant_noun(plant: HiddenPlant) -> str:
    """The kind of effect alone: "delay"."""
    if plant.effect is None:
        return "nothing missing"
    return _NOUNS.get(plant.effect, plant.effect.replace("_", " "))


def plant_size(plant: HiddenPlant) -> str:
    """Its first number with its unit: "0.155 s"; nothing for the plain plant."""
    return f"{plant.numbers[0][1]:g}{_unit(plant)}" if plant.numbers else ""


def capital(text: str) -> str:
    """The text with a capital first letter, and the others as they are."""
    return text[:1].upper() + text[1:]


def is_out_of_catalogue(plant: HiddenPlant) -> bool:
    """Whether the plant has an effect that the catalogue lacks."""
    from sysid import CATALOGUE

    return plant.effect is not None and plant.effect not in CATALOGUE


def in_catalogue(plant: HiddenPlant) -> bool:
    """Whether the plant has an effect of the catalogue."""
    return plant.effect is not None and not is_out_of_catalogue(plant)


def _unit(plant: HiddenPlant) -> str:
    from study.mismatch.ground_truth import effect_of

    effect, name = effect_of(plant), plant.numbers[0][0]
    unit = "" if effect is None else effect.parameters[name].unit
    return "" if unit == "1" else f" {unit}"
