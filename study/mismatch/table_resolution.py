"""Which table of dynamic programming stands for a trained agent? The one that other machines hurt as much.

    python -m study.mismatch.table_resolution     trains 8 agents on the plain machine, some minutes; writes margin.csv

    ratio(policy, effect) = J(policy, machine with the effect) / J(policy, plain machine)

A table's interpolation is noise to it, so that it keeps a margin; the finer, the less. For every effect at its dearest
chosen size, a table's ratio is compared with the mean of the agents': it stands for them where log ratios are near.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from policies.control.dynamic_programming import Grid, solve
from policies.environments.randomization import Band
from policies.evaluation import Policy, batch_returns, fresh_start_states
from policies.training.population import Population
from policies.training.sac import SACSettings
from study.mismatch.chosen_sizes import SIZES, Size
from study.mismatch.loss import EFFECT_COST_FOLDER, EPISODES, SEED
from study.mismatch.magnitudes import MAGNITUDES
from study.mismatch.rod import DESIGN_SUBSTEPS, machine
from study.pipeline.csv_table import write_csv
from sysid import InvalidInput

Array = NDArray[np.float64]

RESOLUTION_TABLE = "margin.csv"
ANGLES = (90, 120, 150, 180, 240, 450)
"""Angles of the tables; speeds are one more."""

STICKING = 50
"""Steps of a sample where dry friction sticks: 1 ms, of which ratios of many policies do not need less."""

SEEDS = tuple(range(100, 108))
"""The agents', which no study uses."""


@dataclass(frozen=True, eq=False)
class TableResolution:
    """Ratios of returns: tables (effects, tables), agents (effects, agents)."""

    angles: tuple[int, ...]
    effects: tuple[str, ...]
    sizes: tuple[float, ...]
    tables: Array
    agents: Array

    @property
    def distances(self) -> Array:
        """Root mean square over effects of log(ratio of a table) - log(mean ratio of the agents)."""
        difference = np.log(self.tables) - np.log(self.agents.mean(axis=1, keepdims=True))
        return np.sqrt(np.mean(difference**2, axis=0))

    def __str__(self) -> str:
        pairs = zip(self.angles, self.distances, strict=True)
        return "distance to the agents, by angles: " + ", ".join(f"{n} {d:.3f}" for n, d in pairs)


def compare_tables(
    tables: Sequence[Policy], agents: Sequence[Policy], angles: Sequence[int], episodes: int
) -> TableResolution:
    """The ratios at every effect's dearest chosen size, from start states that nothing else uses."""
    starts, policies = fresh_start_states(SEED, episodes, block=1), (*tables, *agents)
    plain = batch_returns(policies, machine(), *starts).mean(axis=1)
    dearest = {name: _dearest(name) for name in MAGNITUDES}
    ratios = []
    for name, size in dearest.items():
        effect = MAGNITUDES[name].at(size.size)
        model = machine(effect, STICKING if machine(effect).dry_frictions else None)
        ratios.append(batch_returns(policies, model, *starts).mean(axis=1) / plain)
    split = len(tables)
    sizes = tuple(size.size for size in dearest.values())
    return TableResolution(
        tuple(angles), tuple(dearest), sizes, np.array(ratios)[:, :split], np.array(ratios)[:, split:]
    )


def _dearest(name: str) -> Size:
    sizes = SIZES[name]
    return sizes.large or sizes.medium or sizes.largest


def train_agents(steps: int = 30_000, seeds: Sequence[int] = SEEDS, hidden: tuple[int, ...] = (64, 64)) -> list[Policy]:
    """Agents that know the plain machine and nothing else."""
    plain = Band({"m": 2.0, "l": 1.5})
    settings = SACSettings(hidden=hidden, steps=steps, random_steps=min(1000, steps // 10))
    population = Population(machine(substeps=DESIGN_SUBSTEPS), [plain] * len(seeds), seeds, settings)
    population.train(steps)
    return list(population.policies())


def write_resolution(path: Path, resolution: TableResolution) -> None:
    """A row an effect: the tables' ratios, the agents' mean and standard deviation."""
    agents = np.column_stack((resolution.agents.mean(axis=1), resolution.agents.std(axis=1, ddof=1)))
    numbers = np.hstack((resolution.tables, agents)).tolist()
    columns = ["effect", "size", *(f"table_{n}" for n in resolution.angles), "agents", "agents_sd"]
    named = zip(resolution.effects, resolution.sizes, numbers, strict=True)
    write_csv(path, columns, ([name, size, *(f"{number:.4g}" for number in own)] for name, size, own in named))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 done, 2 bad input."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], prog="python -m study.mismatch.table_resolution"
    )
    parser.add_argument("--out", type=Path, default=EFFECT_COST_FOLDER, metavar="DIR", help="folder of the table")
    options = parser.parse_args(arguments)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        tables = [solve(machine(substeps=DESIGN_SUBSTEPS), Grid(theta=n, theta_dot=n + 1)) for n in ANGLES]
        resolution = compare_tables(tables, train_agents(), ANGLES, EPISODES)
        write_resolution(options.out / RESOLUTION_TABLE, resolution)
    except (InvalidInput, OSError) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    print(resolution)
    return 0


if __name__ == "__main__":
    sys.exit(main())
