"""The near-optimal return of the paper's pendulums, beside LQR and energy swing-up with LQR.

    python examples/optimal_returns.py              450 x 451 states, about 30 s
    python examples/optimal_returns.py --grid 600   finer

Mean return over the paper's start states: seeds 0 to 9, 20 episodes each, 200 steps.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from policies import design_lqr, design_swing_up, start_states
from policies.control.dynamic_programming import Grid, solve
from policies.evaluation import evaluate
from study.paper.protocol import paper_model
from sysid import InvalidInput

SYSTEMS = ((2.0, 1.5), (1.5, 1.2), (2.5, 2.0), (1.0, 1.0))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one line a pendulum; exit code 2 for a grid that cannot be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--grid", type=int, default=450, metavar="N", help="N x (N + 1) states (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        compare(Grid(options.grid, options.grid + 1))
    except InvalidInput as error:
        parser.error(str(error))
    return 0


def compare(grid: Grid) -> None:
    """Print one line a pendulum. Raises InvalidInput for a grid that is too large."""
    theta, theta_dot = (np.concatenate(x) for x in zip(*(start_states(seed) for seed in range(10)), strict=True))
    print(f"{'m [kg]':>6} {'l [m]':>6} {'optimal':>9} {'swing-up + LQR':>15} {'LQR':>9} {'solved in [s]':>14}")
    for m, l in SYSTEMS:  # noqa: E741
        model = paper_model(m, l)
        begin = time.perf_counter()
        optimal = solve(model, grid)
        seconds = time.perf_counter() - begin
        returns = [
            evaluate(policy, model, theta, theta_dot).mean
            for policy in (optimal, design_swing_up(model), design_lqr(model))
        ]
        print(f"{m:6.1f} {l:6.1f} {returns[0]:9.1f} {returns[1]:15.1f} {returns[2]:9.1f} {seconds:14.1f}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
