"""The sizes of effects that are hidden from policies, fixed before any policy was trained, with what they cost.

They stand in chosen_sizes.csv, which `choose_sizes` made of what `effect_cost` measured. This module loads nothing
heavy.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from study.mismatch.magnitudes import MAGNITUDES

CHOSEN = Path(__file__).with_suffix(".csv")


@dataclass(frozen=True)
class Size:
    """An effect at a size, and what not to know it costs by dynamic programming.

    numbers   the effect's parameters (name, value): effect(name, **dict(numbers))
    loss      J_aware - J_ignorant; percent of |J_aware|; sharp: loss of the ignorant that plans to the edge
    """

    size: float
    unit: str
    numbers: tuple[tuple[str, float], ...]
    loss: float
    percent: float
    sharp: float


@dataclass(frozen=True)
class Sizes:
    """small: below 2 %; medium: about 10 %; large: about 30 %, None where no plausible size costs so much; largest: the
    end of what is plausible."""

    small: Size
    medium: Size | None
    large: Size | None
    largest: Size


def size_of(effect: str, size: float, loss: float, percent: float, sharp: float) -> Size:
    """An effect's size with its unit and the effect's parameters (to six digits)."""
    magnitude = MAGNITUDES[effect]
    numbers = tuple((name, float(f"{value:.6g}")) for name, value in magnitude.numbers(size).items())
    return Size(size, magnitude.unit, numbers, loss, percent, sharp)


def _chosen() -> dict[str, Sizes]:
    found: dict[str, dict[str, Size]] = {}
    with CHOSEN.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            costs = (float(row[name]) for name in ("size", "loss", "percent", "sharp"))
            found.setdefault(row["effect"], {})[row["level"]] = size_of(row["effect"], *costs)
    return {
        effect: Sizes(own["small"], own.get("medium"), own.get("large"), own["largest"])
        for effect, own in found.items()
    }


SIZES = _chosen()
