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
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from study.mismatch.loss import (
    EFFECT_COST_FOLDER,
    LOSS_FIGURE,
    LOSS_TABLE,
    Bench,
    LossRow,
    read_losses,
    write_losses,
)
from study.mismatch.magnitudes import MAGNITUDES, Magnitude
from sysid import InvalidInput

TARGETS = (1.5, 10.0, 30.0)
"""Losses that sizes are looked for at [% of |J_aware|]."""

STEPS = tuple(i / 8.0 for i in range(9))
"""Shares of the largest plausible size that are measured in any case."""


def explore(magnitude: Magnitude, measure: Callable[[Magnitude, float], LossRow]) -> list[LossRow]:
    """Rows over the plausible sizes, then nearer and nearer to those at which the loss passes each target."""
    rows = {size: measure(magnitude, size) for size in (rounded(share * magnitude.largest) for share in STEPS)}
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
    return rounded(low.size + min(max(share, 0.3), 0.7) * (high.size - low.size))


def rounded(size: float) -> float:
    """To three digits."""
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
        from study.figure_style import save
        from study.mismatch.figures.effect_cost import draw_effect_cost

        save(lambda: draw_effect_cost(rows), options.out / LOSS_FIGURE)
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
