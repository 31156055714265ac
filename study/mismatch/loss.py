"""What an effect of one size costs the policy that does not know it: the bench that measures it, and the table of rows.

loss(size) = J_aware(size) - J_ignorant(size)
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from policies.control.dynamic_programming import Grid, Optimal, solve
from policies.evaluation import batch_returns, fresh_start_states, start_states
from study.mismatch.magnitudes import MAGNITUDES, Magnitude
from study.mismatch.rod import BLUNT, DESIGN_SUBSTEPS, design, machine
from study.pipeline.csv_table import read_table, write_table
from study.statistics import sem
from sysid import InvalidInput, OutputEffect

EFFECT_COST_FOLDER = Path(__file__).parents[1] / "results" / "effect_cost"
LOSS_TABLE, LOSS_FIGURE = "effect_cost.csv", "effect_cost.png"

SHARP = Grid()
"""The table of the second ignorant designer, who plans to the edge; the aware one's is blunt."""

SEED, EPISODES, PAPER_SEEDS = 500_000, 200, range(500, 600, 20)
"""Start states: of one fresh seed, and of five of the paper's, 20 apart so that they share none."""

SMALL = 2.0
"""Loss [%] below which an effect costs nothing worth the name."""


@dataclass(frozen=True)
class LossRow:
    """Returns on the machine with one effect of one size, and what not knowing it costs; sem: of the paired mean.

    percent of |J_aware|, percent_plain of the plain machine's optimum; sharp: loss of the ignorant with the fine table;
    paper_: from the paper's start states.
    """

    effect: str
    size: float
    unit: str
    plain: float
    ignorant: float
    aware: float
    loss: float
    sem: float
    percent: float
    percent_plain: float
    sharp: float
    paper_ignorant: float
    paper_aware: float
    paper_loss: float
    paper_sem: float


class Bench:
    """The plain machine's designers, and what they are worth there; measures one magnitude at one size at a time.

    substeps   of the machine, where others are wanted than `machine` takes
    """

    def __init__(
        self, blunt: Grid = BLUNT, sharp: Grid = SHARP, episodes: int = EPISODES, substeps: int | None = None
    ) -> None:
        self.grid, self.substeps = blunt, substeps
        self.ignorant: tuple[Optimal, ...] = tuple(
            solve(machine(substeps=DESIGN_SUBSTEPS), grid) for grid in (blunt, sharp)
        )
        groups = [fresh_start_states(SEED, episodes), *(start_states(seed) for seed in PAPER_SEEDS)]
        self.starts = tuple(np.concatenate(columns) for columns in zip(*groups, strict=True))
        self.fresh = np.arange(len(self.starts[0])) < episodes
        (self.plain,) = batch_returns(self.ignorant[:1], machine(substeps=substeps), *self.starts)

    def measure(self, magnitude: Magnitude, size: float) -> LossRow:
        """The row of a size."""
        effect = magnitude.at(size)
        model = machine(effect, self.substeps)
        if isinstance(effect, OutputEffect):
            ignorant, sharp = batch_returns(self.ignorant, model, *self.starts)
            aware = self.plain
        else:
            ignorant, sharp, aware = batch_returns((*self.ignorant, design(model, self.grid)), model, *self.starts)
        loss, paper = (aware - ignorant)[self.fresh], (aware - ignorant)[~self.fresh]
        reached = float(np.mean(aware[self.fresh]))
        plain = float(np.mean(self.plain[self.fresh]))
        return LossRow(
            effect=magnitude.effect,
            size=size,
            unit=magnitude.unit,
            plain=plain,
            ignorant=float(np.mean(ignorant[self.fresh])),
            aware=reached,
            loss=float(np.mean(loss)),
            sem=sem(loss),
            percent=100.0 * float(np.mean(loss)) / abs(reached),
            percent_plain=100.0 * float(np.mean(loss)) / abs(plain),
            sharp=float(np.mean((aware - sharp)[self.fresh])),
            paper_ignorant=float(np.mean(ignorant[~self.fresh])),
            paper_aware=float(np.mean(aware[~self.fresh])),
            paper_loss=float(np.mean(paper)),
            paper_sem=sem(paper),
        )


def read_losses(path: Path) -> list[LossRow]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    rows = read_table(LossRow, path, "effects and losses")
    for row in rows:
        if row.effect not in MAGNITUDES:
            raise InvalidInput(f"{path} has a row of effect {row.effect!r}: expected one of {', '.join(MAGNITUDES)}")
    return rows


def write_losses(path: Path, rows: Iterable[LossRow]) -> None:
    """The rows as a CSV file, in the catalogue's order; whole or not at all."""
    order = {name: i for i, name in enumerate(MAGNITUDES)}
    write_table(LossRow, path, sorted(rows, key=lambda row: (order[row.effect], row.size)))
