"""What each effect costs the policy that does not know it, over its plausible sizes: rows, and a panel an effect."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from study.figure_style import ACCENT
from study.mismatch.magnitudes import MAGNITUDES
from study.pipeline.tables import read_table, write_table
from study.trials.hidden_plant import ALL_PLANTS
from sysid import InvalidInput

COLUMNS, TOP = 5, 60.0
"""Panels abreast, and the loss [%] above which lines leave them."""
DEAR = 2.0
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


def read_losses(path: Path) -> list[LossRow]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    rows = read_table(LossRow, path, "effects and losses", optional=True)
    for row in rows:
        if row.effect not in MAGNITUDES:
            raise InvalidInput(f"{path} has a row of effect {row.effect!r}: expected one of {', '.join(MAGNITUDES)}")
    return rows


def write_losses(path: Path, rows: Iterable[LossRow]) -> None:
    """The rows as a CSV file, in the catalogue's order; whole or not at all."""
    order = {name: i for i, name in enumerate(MAGNITUDES)}
    write_table(LossRow, path, sorted(rows, key=lambda row: (order[row.effect], row.size)))


def draw_effect_cost(rows: Sequence[LossRow]) -> Figure:
    """Loss in percent of the aware policy's return; the panels from the dearest effect to those that cost nothing."""
    of = {name: sorted((r for r in rows if r.effect == name), key=lambda r: r.size) for name in MAGNITUDES}
    order = sorted((name for name in of if of[name]), key=lambda name: -max(r.percent for r in of[name]))
    rows_of_panels = -(-len(order) // COLUMNS)
    figure = Figure(figsize=(11.0, 1.4 + 2.1 * rows_of_panels), layout="constrained")
    panels = list(np.ravel(figure.subplots(rows_of_panels, COLUMNS, sharey=True, squeeze=False)))
    for axes, name in zip(panels, order, strict=False):
        _panel(axes, of[name])
    for axes in panels[len(order) :]:
        axes.remove()
    named = [pair[::-1] for axes in reversed(panels) for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
    lines = dict(named)
    figure.legend(lines.values(), lines.keys(), loc="outside lower center", ncols=3)
    figure.suptitle("What an effect costs the policy that is optimal without it", x=0.01, ha="left", fontweight="bold")
    figure.supylabel("loss, % of the return of the policy that knows the effect", fontsize=10.0)
    return figure


def _panel(axes: Axes, rows: Sequence[LossRow]) -> None:
    magnitude = MAGNITUDES[rows[0].effect]
    size, percent = np.array([r.size for r in rows]), np.array([r.percent for r in rows])
    error = 100.0 * np.array([r.sem / abs(r.aware) for r in rows])
    sharp = 100.0 * np.array([r.sharp / abs(r.aware) for r in rows])
    dear = float(np.max(percent)) >= DEAR
    colour = "#1f5a94" if dear else "0.6"
    for target in (10.0, 30.0):
        axes.axhline(target, color="0.88", linewidth=0.8, zorder=0)
    axes.fill_between(size, percent - error, percent + error, color=colour, alpha=0.25, linewidth=0.0)
    axes.plot(size, percent, color=colour, label="planned with a margin (table of 120 x 121 states) ± SEM")
    axes.plot(size, sharp, color=colour, linewidth=0.9, linestyle=(0, (3, 2)),
              label="planned to the edge (450 x 451 states)")  # fmt: skip
    hidden = [(p.numbers[0][1], p.percent) for p in ALL_PLANTS if p.effect == magnitude.effect]
    if hidden:
        axes.plot(*zip(*hidden, strict=True), "o", color=ACCENT, markersize=4.5, label="hidden from the agents",
                  clip_on=False, zorder=4)  # fmt: skip
    axes.set_title(magnitude.effect.replace("_", " "), color="0.1" if dear else "0.5", fontsize=10.0, pad=4)
    unit = "" if magnitude.unit == "1" else f" [{magnitude.unit}]"
    axes.set_xlabel(magnitude.meaning.split(",")[0] + unit, fontsize=8.0)
    axes.tick_params(labelsize=8.0)
    axes.set_xlim(0.0, magnitude.largest)
    axes.set_ylim(-3.0, TOP)
