"""What does an effect cost the policy that does not know it? Dynamic programming in the place of training.

    python -m study.mismatch.effect_cost                    draws what was measured: study/results/effect_cost
    python -m study.mismatch.effect_cost --out elsewhere    measures again, about an hour, and goes on if stopped

    loss(size) = J_aware(size) - J_ignorant(size)

The machine is the paper's rod (2.0 kg, 1.5 m), |u| <= 2 N m, a command every 0.05 s, with one effect. Both policies are
optimal for a machine: the ignorant one for that without the effect, the aware one for that with it. Behind a delay the
aware one acts on the state predicted through the commands under way; below a sample of delay, and for a lag, what the
drive remembers is a third axis of its table, so that nothing is approximated but by the table. To be aware of sensing
is to know the state: J_aware is then that of the plain machine. A torque in time begins with the episode, and the
aware one knows when that was.

The machine moves in Runge-Kutta steps of 5 ms; policies are designed on steps of 25 ms.
Episodes start 200 times where no other seed does. Tables have 120 x 121 states, whose interpolation makes them plan
with a margin, as trained agents do: eight agents that were trained on the plain machine lose about as much to each
effect, and less than finer tables do (table_resolution.csv, beside the losses: return on the machine with the effect
over that on the plain one). What an ignorant policy from 450 x 451 states, planned to the edge, loses against the same
aware one stands beside as `sharp`.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from policies.control.dynamic_programming import Grid, solve
from policies.evaluation import batch_returns, fresh_start_states
from study.figure_style import ACCENT, save_figure
from study.mismatch.magnitudes import MAGNITUDES, Magnitude
from study.pipeline.tables import read_table, write_table
from study.statistics import sem
from study.trials.ground_truth import BLUNT, DESIGN_SUBSTEPS, SUBSTEPS, hidden_machine, near_optimal
from study.trials.hidden_plant import ALL_PLANTS
from sysid import OutputEffect
from sysid.cli.command_line import answer_one, entry_point
from sysid.cli.command_options import option
from sysid.data.files import check_outputs, file_errors

logger = logging.getLogger(__name__ if __name__ != "__main__" else "study.mismatch.effect_cost")

EFFECT_COST_FOLDER = Path(__file__).parents[1] / "results" / "effect_cost"
LOSS_TABLE, LOSS_FIGURE = "effect_cost.csv", "effect_cost.png"

SHARP = Grid()
"""The table of the second ignorant designer, who plans to the edge; the aware one's is blunt."""

SEED, EPISODES = 500_000, 200
"""Of the start states: the seed that they come from, and how many there are."""

TARGETS = (1.5, 10.0, 30.0)
"""Losses that sizes are looked for at [% of |J_aware|]."""

MEASURED_SHARES = tuple(i / 8.0 for i in range(9))
"""Shares of the largest plausible size that are measured in any case."""


COLUMNS, TOP = 5, 60.0
"""Panels abreast, and the loss [%] above which lines leave them."""
DEAR = 2.0
"""Loss [%] below which an effect costs nothing worth the name."""


@dataclass(frozen=True)
class LossRow:
    """Returns on the machine with one effect of one size, and what not knowing it costs; sem: of the paired mean.

    percent of |J_aware|; sharp: loss of the ignorant with the fine table.
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
    sharp: float


class Bench:
    """The plain machine's designers, and what they are worth there; measures one magnitude at one size at a time.

    substeps   of the machine in an interval
    """

    def __init__(
        self, blunt: Grid = BLUNT, sharp: Grid = SHARP, episodes: int = EPISODES, substeps: int = SUBSTEPS
    ) -> None:
        self.grid, self.substeps = blunt, substeps
        self.ignorant = tuple(solve(hidden_machine(substeps=DESIGN_SUBSTEPS), grid) for grid in (blunt, sharp))
        self.starts = fresh_start_states(SEED, episodes)
        (self.plain,) = batch_returns(self.ignorant[:1], hidden_machine(substeps=substeps), *self.starts)

    def measure(self, magnitude: Magnitude, size: float) -> LossRow:
        """What it costs not to know an effect of this size."""
        effect = magnitude.at(size)
        model = hidden_machine(effect, self.substeps)
        if isinstance(effect, OutputEffect):
            ignorant, sharp = batch_returns(self.ignorant, model, *self.starts)
            aware = self.plain
        else:
            policies = (*self.ignorant, near_optimal(model, self.grid))
            ignorant, sharp, aware = batch_returns(policies, model, *self.starts)
        loss = aware - ignorant
        means = [float(np.mean(values)) for values in (self.plain, ignorant, aware, loss)]
        share, edge = 100.0 * means[3] / abs(means[2]), float(np.mean(aware - sharp))
        return LossRow(magnitude.effect, size, magnitude.unit, *means, sem(loss), share, edge)


def explore(magnitude: Magnitude, measure: Callable[[Magnitude, float], LossRow]) -> list[LossRow]:
    """Rows over the plausible sizes, then nearer and nearer to those at which the loss passes each target."""
    rows = {
        size: measure(magnitude, size)
        for size in (three_digits(share * magnitude.largest) for share in MEASURED_SHARES)
    }
    for target in TARGETS:
        for _ in range(6):
            size = _between(sorted(rows.values(), key=lambda row: row.size), target)
            if size is None or size in rows:
                break
            rows[size] = measure(magnitude, size)
    return sorted(rows.values(), key=lambda row: row.size)


def _between(rows: Sequence[LossRow], target: float) -> float | None:
    """About where a line between the rows around the first passage meets the target; None where one is near enough, or
    where none is beyond."""
    beyond = next((i for i, row in enumerate(rows) if row.percent > target), 0)
    if beyond == 0:
        return None
    low, high = rows[beyond - 1], rows[beyond]
    if min(abs(row.percent - target) for row in (low, high)) < max(0.45, 0.1 * target):
        return None
    share = (target - low.percent) / (high.percent - low.percent)
    return three_digits(low.size + min(max(share, 0.3), 0.7) * (high.size - low.size))


def three_digits(size: float) -> float:
    """A size to three digits, as tables print it."""
    return float(f"{size:.3g}")


def read_losses(path: Path) -> list[LossRow]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    return read_table(LossRow, path, "effects and losses", optional=True, known={"effect": MAGNITUDES})


def write_losses(path: Path, rows: Iterable[LossRow]) -> None:
    """The rows as a CSV file, in the catalogue's order; whole or not at all. Raises InvalidInput."""
    order = {name: i for i, name in enumerate(MAGNITUDES)}
    ordered = sorted(rows, key=lambda row: (order[row.effect], row.size))
    with file_errors(path, "write"):
        write_table(LossRow, path, ordered)


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


@dataclass(frozen=True)
class EffectCostOptions:
    """What does an effect cost the policy that does not know it? Dynamic programming in the place of training."""

    out: Annotated[Path, option("DIR", "study/results/effect_cost")] = EFFECT_COST_FOLDER
    """Folder of the table and the figure."""

    effects: Annotated[tuple[Literal[*MAGNITUDES], ...], option("NAME", "all")] = tuple(MAGNITUDES)
    """The effects that are measured."""


@entry_point
def main(arguments: Sequence[str]) -> int:
    """Run the command line; returns the exit code: 0 done, 1 nobody reads on, 2 bad input, 130 stopped."""
    return answer_one(EffectCostOptions, measure_and_draw, "python -m study.mismatch.effect_cost", arguments)


def measure_and_draw(command: EffectCostOptions) -> None:
    """Write the figure of the table, after what it lacks was measured. Raises InvalidInput for bad input."""
    with file_errors(command.out, "write"):
        command.out.mkdir(parents=True, exist_ok=True)
    table, figure = command.out / LOSS_TABLE, command.out / LOSS_FIGURE
    check_outputs((), (table, figure), force=True)
    rows = _measured(table, command.effects)
    save_figure(lambda: draw_effect_cost(rows), figure)


def _measured(path: Path, effects: Sequence[str]) -> list[LossRow]:
    """The rows of the table, after those that it lacks were measured."""
    known = {(row.effect, row.size): row for row in read_losses(path)}
    bench: list[Bench] = []

    def measure(magnitude: Magnitude, size: float) -> LossRow:
        """The row of an effect's size, kept in the file as soon as it is known."""
        if (magnitude.effect, size) not in known:
            if not bench:
                bench.append(Bench())
            row = known[magnitude.effect, size] = bench[0].measure(magnitude, size)
            write_losses(path, known.values())
            logger.info(
                f"{row.effect} {size:g} {row.unit}: aware {row.aware:.1f}, ignorant {row.ignorant:.1f}, "
                f"loss {row.loss:.1f} +- {row.sem:.1f} ({row.percent:.1f} %)"
            )
        return known[magnitude.effect, size]

    for name in effects:
        explore(MAGNITUDES[name], measure)
    return list(known.values())


if __name__ == "__main__":
    sys.exit(main())
