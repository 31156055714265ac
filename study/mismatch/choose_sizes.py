"""Chooses the sizes of effects that are hidden from policies, by what they cost: chosen_sizes.csv.

python -m study.mismatch.choose_sizes      from study/results/effect_cost; to be done before any policy is trained
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import fields

from study.mismatch.chosen_sizes import CHOSEN, Size, Sizes, size_of
from study.mismatch.effect_cost import STEPS, TARGETS, rounded
from study.mismatch.loss import EFFECT_COST_FOLDER, LOSS_TABLE, SMALL, LossRow, read_losses
from study.mismatch.magnitudes import MAGNITUDES
from study.pipeline.csv_table import write_csv


def choose(rows: Sequence[LossRow]) -> Sizes:
    """From one effect's rows: small is the last eighth of what is plausible before losses reach 2 % (else the least
    size measured); medium and large are nearest to 10 % and 30 % up to the first passage, if within a third of it."""
    rows = sorted(rows, key=lambda row: row.size)
    magnitude = MAGNITUDES[rows[0].effect]
    first = next((i for i, row in enumerate(rows) if row.percent >= SMALL), len(rows))
    eighths = {rounded(share * magnitude.largest) for share in STEPS[1:]}
    small = next((row for row in reversed(rows[:first]) if row.size in eighths), rows[1])
    medium, large = (_passage(rows, target) for target in TARGETS[1:])
    return Sizes(_size(small), medium and _size(medium), large and _size(large), _size(rows[-1]))


def _passage(rows: Sequence[LossRow], target: float) -> LossRow | None:
    """The row nearest to the target, of those up to the first beyond it."""
    beyond = next((i for i, row in enumerate(rows) if row.percent > target), len(rows) - 1)
    nearest = min(rows[: beyond + 1], key=lambda row: abs(row.percent - target))
    return nearest if abs(nearest.percent - target) < target / 3.0 else None


def _size(row: LossRow) -> Size:
    loss, percent, sharp = (round(value, 2) + 0.0 for value in (row.loss, row.percent, row.sharp))
    return size_of(row.effect, row.size, loss, percent, sharp)


def main() -> int:
    """Write the table."""
    rows = read_losses(EFFECT_COST_FOLDER / LOSS_TABLE)
    chosen = {effect: choose([row for row in rows if row.effect == effect]) for effect in MAGNITUDES}
    levels = [(effect, f.name, getattr(sizes, f.name)) for effect, sizes in chosen.items() for f in fields(sizes)]
    costs = ([effect, level, s.size, s.loss, s.percent, s.sharp] for effect, level, s in levels if s is not None)
    write_csv(CHOSEN, ["effect", "level", "size", "loss", "percent", "sharp"], costs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
