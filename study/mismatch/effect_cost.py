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
where the paper's generator says. Tables have 120 x 121 states, whose interpolation makes them plan with a margin: as
trained agents do, says `margin`. What an ignorant policy from 450 x 451 states, planned to the edge, loses
against the same aware one stands beside as `sharp`.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from policies.abreast import returns
from policies.control.design import is_periodic, is_steady, without_dead_time
from policies.control.optimal import Grid, Optimal, solve
from policies.control.predictive import design_predictive
from policies.evaluate import Policy, fresh_start_states, start_states
from study import rows as table
from study.mismatch.cases import CASES, U_MAX, Case
from study.mismatch.sizes import Size, Sizes
from sysid import RK4, Effect, InvalidInput, Model, OutputEffect, RodPendulum

Array = NDArray[np.float64]

SHIPPED = Path(__file__).parents[1] / "results" / "effect_cost"
TABLE, FIGURE = "effect_cost.csv", "effect_cost.png"

BLUNT, SHARP = Grid(theta=120, theta_dot=121), Grid()
"""Tables of the two ignorant designers; the aware one's is the blunt one's."""

SEED, EPISODES, PAPER_SEEDS = 500_000, 200, range(500, 600, 20)
"""Start states: of one fresh seed, and of five of the paper's, 20 apart so that they share none."""

TARGETS = (1.5, 10.0, 30.0)
"""Losses that sizes are looked for at [% of |J_aware|]."""

SMALL = 2.0
"""Loss [%] below which an effect costs nothing worth the name."""

STEPS = tuple(i / 8.0 for i in range(9))
"""Shares of the largest plausible size that are measured in any case."""


@dataclass(frozen=True)
class Row:
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


def machine(effect: Effect | None = None, substeps: int | None = None) -> Model:
    """The hidden machine; by default in steps of 5 ms, or of 0.2 ms where something makes it stick."""
    plain = Model(RodPendulum(m=2.0, l=1.5, g=10.0), dt=0.05, u_max=U_MAX)
    model = plain if effect is None else plain.with_effect(effect)
    fine = 250 if model.dry_frictions else 10
    return dataclasses.replace(model, integrator=RK4(substeps=fine if substeps is None else substeps))


def design(model: Model, grid: Grid = BLUNT) -> Policy:
    """The near-optimal policy for a machine, designed on steps of 25 ms; it knows the state.

    Raises InvalidInput for a machine with effects of the sensors, or one that no table can be made for.
    """
    if model.output_effects:
        raise InvalidInput(f"{model.output_effects[0].name} is of the sensors: expected a machine whose state is known")
    model = dataclasses.replace(model, integrator=RK4(substeps=2))
    core, _ = without_dead_time(model)
    if any(e.rest(core.dt) for e in core.input_effects) or not is_steady(core):
        grid = dataclasses.replace(grid, u=11, memory=7)
    return design_predictive(model, dataclasses.replace(grid, turns=1 if is_periodic(model) else 3))


class Bench:
    """The plain machine's designers, and what they are worth there; measures one case at one size at a time.

    substeps   of the machine, where others are wanted than `machine` takes
    """

    def __init__(
        self, blunt: Grid = BLUNT, sharp: Grid = SHARP, episodes: int = EPISODES, substeps: int | None = None
    ) -> None:
        self.grid, self.substeps = blunt, substeps
        self.ignorant: tuple[Optimal, ...] = tuple(solve(machine(substeps=2), grid) for grid in (blunt, sharp))
        groups = [fresh_start_states(SEED, episodes), *(start_states(seed) for seed in PAPER_SEEDS)]
        self.starts = tuple(np.concatenate(columns) for columns in zip(*groups, strict=True))
        self.fresh = np.arange(len(self.starts[0])) < episodes
        (self.plain,) = returns(self.ignorant[:1], machine(substeps=substeps), *self.starts)

    def measure(self, case: Case, size: float) -> Row:
        """The row of a size."""
        effect = case.at(size)
        model = machine(effect, self.substeps)
        if isinstance(effect, OutputEffect):
            ignorant, sharp = returns(self.ignorant, model, *self.starts)
            aware = self.plain
        else:
            ignorant, sharp, aware = returns((*self.ignorant, design(model, self.grid)), model, *self.starts)
        loss, paper = (aware - ignorant)[self.fresh], (aware - ignorant)[~self.fresh]
        reached = float(np.mean(aware[self.fresh]))
        plain = float(np.mean(self.plain[self.fresh]))
        return Row(
            effect=case.effect,
            size=size,
            unit=case.unit,
            plain=plain,
            ignorant=float(np.mean(ignorant[self.fresh])),
            aware=reached,
            loss=float(np.mean(loss)),
            sem=_sem(loss),
            percent=100.0 * float(np.mean(loss)) / abs(reached),
            percent_plain=100.0 * float(np.mean(loss)) / abs(plain),
            sharp=float(np.mean((aware - sharp)[self.fresh])),
            paper_ignorant=float(np.mean(ignorant[~self.fresh])),
            paper_aware=float(np.mean(aware[~self.fresh])),
            paper_loss=float(np.mean(paper)),
            paper_sem=_sem(paper),
        )


def _sem(values: Array) -> float:
    return float(np.std(values, ddof=1)) / math.sqrt(len(values))


def explore(case: Case, measure: Callable[[Case, float], Row]) -> list[Row]:
    """Rows over the plausible sizes, then nearer and nearer to those at which the loss passes each target."""
    rows = {size: measure(case, size) for size in (_rounded(share * case.largest) for share in STEPS)}
    for target in TARGETS:
        for _ in range(6):
            size = _between(sorted(rows.values(), key=lambda row: row.size), target)
            if size is None or size in rows:
                break
            rows[size] = measure(case, size)
    return sorted(rows.values(), key=lambda row: row.size)


def _between(rows: Sequence[Row], target: float) -> float | None:
    """About where a line between the rows around the first passage meets the target; None where one is near enough, or
    where none is beyond."""
    beyond = next((i for i, row in enumerate(rows) if row.percent > target), 0)
    if beyond == 0:
        return None
    low, high = rows[beyond - 1], rows[beyond]
    if min(abs(row.percent - target) for row in (low, high)) < max(0.45, 0.1 * target):
        return None
    share = (target - low.percent) / (high.percent - low.percent)
    return _rounded(low.size + min(max(share, 0.3), 0.7) * (high.size - low.size))


def _rounded(size: float) -> float:
    return float(f"{size:.3g}")


def choose(rows: Sequence[Row]) -> Sizes:
    """From one effect's rows: small is the last eighth of what is plausible before losses reach 2 % (else the least
    size measured); medium and large are nearest to 10 % and 30 % up to the first passage, if within a third of it."""
    rows = sorted(rows, key=lambda row: row.size)
    case = CASES[rows[0].effect]
    first = next((i for i, row in enumerate(rows) if row.percent >= SMALL), len(rows))
    eighths = {_rounded(share * case.largest) for share in STEPS[1:]}
    small = next((row for row in reversed(rows[:first]) if row.size in eighths), rows[1])
    medium, large = (_passage(rows, target) for target in TARGETS[1:])
    return Sizes(_size(small), medium and _size(medium), large and _size(large), _size(rows[-1]))


def _passage(rows: Sequence[Row], target: float) -> Row | None:
    """The row nearest to the target, of those up to the first beyond it."""
    beyond = next((i for i, row in enumerate(rows) if row.percent > target), len(rows) - 1)
    nearest = min(rows[: beyond + 1], key=lambda row: abs(row.percent - target))
    return nearest if abs(nearest.percent - target) < target / 3.0 else None


def _size(row: Row) -> Size:
    numbers = tuple((name, float(f"{value:.6g}")) for name, value in CASES[row.effect].numbers(row.size).items())
    rounded = (round(value, 2) + 0.0 for value in (row.loss, row.percent, row.sharp))
    return Size(row.size, row.unit, numbers, *rounded)


def read(path: Path) -> list[Row]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    return table.read(Row, path, "effects and losses")


def write(path: Path, rows: Iterable[Row]) -> None:
    """The rows as a CSV file, in the catalogue's order; whole or not at all."""
    order = {name: i for i, name in enumerate(CASES)}
    table.write(Row, path, sorted(rows, key=lambda row: (order[row.effect], row.size)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], prog="python -m study.mismatch.effect_cost")
    parser.add_argument("--out", type=Path, default=SHIPPED, metavar="DIR", help="folder of table and figure")
    parser.add_argument("--effects", nargs="+", default=list(CASES), choices=list(CASES), metavar="NAME")
    options = parser.parse_args(arguments)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        rows = _measured(options.out / TABLE, options.effects)
        from study.figures.effect_cost import draw
        from study.figures.style import save

        save(lambda: draw(rows), options.out / FIGURE)
    except (InvalidInput, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    return 0


def _measured(path: Path, effects: Sequence[str]) -> list[Row]:
    """The rows of the table, after those that it lacks were measured."""
    known = {(row.effect, row.size): row for row in read(path)}
    bench: list[Bench] = []

    def measure(case: Case, size: float) -> Row:
        """The row of an effect's size, kept in the file as soon as it is known."""
        if (case.effect, size) not in known:
            if not bench:
                bench.append(Bench())
            row = known[case.effect, size] = bench[0].measure(case, size)
            write(path, known.values())
            print(
                f"{row.effect} {size:g} {row.unit}: aware {row.aware:.1f}, ignorant {row.ignorant:.1f}, "
                f"loss {row.loss:.1f} +- {row.sem:.1f} ({row.percent:.1f} %)",
                flush=True,
            )
        return known[case.effect, size]

    for name in effects:
        explore(CASES[name], measure)
    return list(known.values())


if __name__ == "__main__":
    sys.exit(main())
