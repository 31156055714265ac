"""Chooses the sizes of effects that are hidden from policies, by what they cost: chosen_sizes.csv.

python -m study.mismatch.choose_sizes      from study/results/effect_cost; to be done before any policy is trained
"""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Sequence
from dataclasses import fields

from study.mismatch.chosen_sizes import CHOSEN, Size, Sizes, size_of
from study.mismatch.effect_cost import STEPS, TARGETS, rounded
from study.mismatch.loss import EFFECT_COST_FOLDER, LOSS_TABLE, SMALL, LossRow, read_losses
from study.mismatch.magnitudes import MAGNITUDES
from sysid.data.files import write_whole


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
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["effect", "level", "size", "loss", "percent", "sharp"])
    for effect in MAGNITUDES:
        sizes = choose([row for row in rows if row.effect == effect])
        for level in (field.name for field in fields(Sizes)):
            size = getattr(sizes, level)
            if size is not None:
                writer.writerow([effect, level, size.size, size.loss, size.percent, size.sharp])
    write_whole(CHOSEN, text.getvalue())
    return 0


if __name__ == "__main__":
    sys.exit(main())
