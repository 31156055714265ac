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

The machine moves in Runge-Kutta steps of 5 ms, of 0.2 ms where it sticks; policies are designed on steps of 25 ms.
Episodes start 200 times where no other seed does (the loss, and the standard error of its paired mean), and 100 times
where the paper's generator says. Tables have 120 x 121 states, whose interpolation makes them plan with a margin, as
trained agents do: eight agents that were trained on the plain machine lose about as much to each effect, and less than
finer tables do (table_resolution.csv, beside the losses: return on the machine with the effect over that on the plain
one). What an ignorant policy from 450 x 451 states, planned to the edge, loses against the same aware one stands beside
as `sharp`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from policies.control.dynamic_programming import Grid, solve
from policies.evaluation import batch_returns, fresh_start_states, start_states
from study.figure_style import save_figure
from study.mismatch.effect_losses import LossRow, draw_effect_cost, read_losses, write_losses
from study.mismatch.magnitudes import MAGNITUDES, Magnitude
from study.statistics import sem
from study.trials.ground_truth import BLUNT, DESIGN_SUBSTEPS, design, hidden_machine
from sysid import InvalidInput, OutputEffect

EFFECT_COST_FOLDER = Path(__file__).parents[1] / "results" / "effect_cost"
LOSS_TABLE, LOSS_FIGURE = "effect_cost.csv", "effect_cost.png"

SHARP = Grid()
"""The table of the second ignorant designer, who plans to the edge; the aware one's is blunt."""

SEED, EPISODES, PAPER_SEEDS = 500_000, 200, range(500, 600, 20)
"""Start states: of one fresh seed, and of five of the paper's, 20 apart so that they share none."""

TARGETS = (1.5, 10.0, 30.0)
"""Losses that sizes are looked for at [% of |J_aware|]."""

STEPS = tuple(i / 8.0 for i in range(9))
"""Shares of the largest plausible size that are measured in any case."""


class Bench:
    """The plain machine's designers, and what they are worth there; measures one magnitude at one size at a time.

    substeps   of the machine, where others are wanted than `hidden_machine` takes
    """

    def __init__(
        self, blunt: Grid = BLUNT, sharp: Grid = SHARP, episodes: int = EPISODES, substeps: int | None = None
    ) -> None:
        self.grid, self.substeps = blunt, substeps
        self.ignorant = tuple(solve(hidden_machine(substeps=DESIGN_SUBSTEPS), grid) for grid in (blunt, sharp))
        groups = [fresh_start_states(SEED, episodes), *(start_states(seed) for seed in PAPER_SEEDS)]
        self.starts = tuple(np.concatenate(columns) for columns in zip(*groups, strict=True))
        self.fresh = np.arange(len(self.starts[0])) < episodes
        (self.plain,) = batch_returns(self.ignorant[:1], hidden_machine(substeps=substeps), *self.starts)

    def measure(self, magnitude: Magnitude, size: float) -> LossRow:
        """What it costs not to know an effect of this size."""
        effect = magnitude.at(size)
        model = hidden_machine(effect, self.substeps)
        if isinstance(effect, OutputEffect):
            ignorant, sharp = batch_returns(self.ignorant, model, *self.starts)
            aware = self.plain
        else:
            ignorant, sharp, aware = batch_returns((*self.ignorant, design(model, self.grid)), model, *self.starts)
        loss = aware - ignorant
        means = [float(np.mean(own[self.fresh])) for own in (self.plain, ignorant, aware, loss)]
        plain, _, reached, lost = means
        paper = [float(np.mean(own[~self.fresh])) for own in (ignorant, aware, loss)]
        return LossRow(
            magnitude.effect, size, magnitude.unit, *means, sem(loss[self.fresh]), 100.0 * lost / abs(reached),
            100.0 * lost / abs(plain), float(np.mean((aware - sharp)[self.fresh])), *paper, sem(loss[~self.fresh]),
        )  # fmt: skip


def explore(magnitude: Magnitude, measure: Callable[[Magnitude, float], LossRow]) -> list[LossRow]:
    """Rows over the plausible sizes, then nearer and nearer to those at which the loss passes each target."""
    rows = {size: measure(magnitude, size) for size in (three_digits(share * magnitude.largest) for share in STEPS)}
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], prog="python -m study.mismatch.effect_cost")
    parser.add_argument("--out", type=Path, default=EFFECT_COST_FOLDER, metavar="DIR", help="table and figure")
    parser.add_argument("--effects", nargs="+", default=list(MAGNITUDES), choices=list(MAGNITUDES), metavar="NAME")
    options = parser.parse_args(arguments)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        rows = _measured(options.out / LOSS_TABLE, options.effects)
        save_figure(lambda: draw_effect_cost(rows), options.out / LOSS_FIGURE)
    except (InvalidInput, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


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
            print(
                f"{row.effect} {size:g} {row.unit}: aware {row.aware:.1f}, ignorant {row.ignorant:.1f}, "
                f"loss {row.loss:.1f} +- {row.sem:.1f} ({row.percent:.1f} %)",
                flush=True,
            )
        return known[magnitude.effect, size]

    for name in effects:
        explore(MAGNITUDES[name], measure)
    return list(known.values())


if __name__ == "__main__":
    sys.exit(main())
