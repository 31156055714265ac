"""Two sweeps held against each other, seed by seed: do other networks, versions or settings change the returns?

    python examples/compare_sweeps.py study/results/paper-small/runs.csv study/results/paper/runs.csv
    python examples/compare_sweeps.py PATH/TO/sim2real_budget/results study/results/paper/runs.csv

Each is a runs.csv of ours or the folder of the authors' files. Compared are the cells that both have, over the seeds
that both have; the same seed has the same rollouts, the same estimate and the same start states in both.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from study.paper.finished_runs import Outcomes, read_published, read_runs
from study.paper.published_numbers import Spot
from study.statistics import paired_t, sem
from sysid import InvalidInput

FAR = 50.0
"""A run that is further than this from its pair is counted."""


def cell(returns: np.ndarray) -> str:
    """Mean, standard error and median over seeds."""
    return f"{returns.mean():5.0f} ± {sem(returns):2.0f} ({np.median(returns):.0f})"


def common(first: Outcomes, second: Outcomes) -> dict[Spot, tuple[tuple[int, ...], np.ndarray, np.ndarray]]:
    """Seeds (S,) and returns (S,) of both in every cell with two seeds in common."""
    cells = {}
    for spot in sorted(spot for spot in first.table if spot in second):
        seeds = tuple(sorted(set(first.seeds(spot)) & set(second.seeds(spot))))
        if len(seeds) > 1:
            cells[spot] = seeds, first.returns(spot, seeds), second.returns(spot, seeds)
    return cells


def overall(pairs: dict[Spot, tuple[tuple[int, ...], np.ndarray, np.ndarray]]) -> str:
    """The change over all cells with data, a seed counted once, and how many runs moved far."""
    moved: dict[int, list[float]] = {}
    for spot, (seeds, a, b) in pairs.items():
        for seed, change in zip(seeds, b - a, strict=True):
            if spot.n > 0:
                moved.setdefault(seed, []).append(change)
    every = np.array([change for changes in moved.values() for change in changes])
    means = np.array([np.mean(changes) for changes in moved.values()])
    if len(means) < 2:
        return "no pairs with data"
    low, high = int(np.sum(every < -FAR)), int(np.sum(every > FAR))
    change = paired_t(means)
    return f"all {len(every)} pairs with data: {change}; {low} lower and {high} higher by more than {FAR:.0f}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the comparison; exit code 2 for what cannot be read or has no cell in common."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=Path, help="runs.csv, or the folder of the authors' files")
    parser.add_argument("second", type=Path, help="the same; differences are second - first")
    options = parser.parse_args(arguments)
    try:
        first, second = (read_published(p) if p.is_dir() else read_runs(p) for p in (options.first, options.second))
    except InvalidInput as error:
        parser.error(str(error))
    pairs = common(first, second)
    if not pairs:
        parser.error(f"{options.first} and {options.second} share no cell of two seeds: expected the same preset's")
    print(f"{'point':12} {'n':>3} {'w':>4} {'seeds':>5}  {'first':>18} {'second':>18}  second - first (t, 95 %)")
    for spot, (seeds, a, b) in pairs.items():
        where = f"{spot.point:12} {spot.n:3d} {spot.w:4g} {len(seeds):5d}"
        print(f"{where}  {cell(a):>18} {cell(b):>18}  {paired_t(b, a)}")
    print(overall(pairs))
    return 0


if __name__ == "__main__":
    sys.exit(main())
