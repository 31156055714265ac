"""Presets: what a study measures, trains and compares, as frozen plain data.

This module loads nothing heavy, so that `python -m study.main --help` answers at once.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from typing import Any, NamedTuple

FORMAT = 1
"""Version of the results folder: raised whenever stored numbers or tables change their meaning."""


class Cell(NamedTuple):
    """One run: n rollouts are measured, the training band has relative width w, everything random comes from seed."""

    n: int
    w: float
    seed: int


@dataclass(frozen=True)
class Preset:
    """A grid of runs, budgets x widths x seeds, and everything their numbers depend on.

    budgets      n, rollouts measured on the hidden plant; 0 trains at the prior
    widths       w, relative half-width of the training band
    hidden       layer sizes of actor and critics
    steps        environment steps an agent trains
    population   agents trained together in one process; a function of the preset alone, never of the machine
    truth        the hidden plant's (m [kg], l [m]); prior: what an engineer would assume without data
    sigma        sd of a speed reading [rad/s]
    episodes     evaluation episodes a run
    reference_seeds  whose start states rate the references, beside the study's own seeds: the paper's ten
    grid         angles, and speeds but for one, of the dynamic programs, at the truth and at every estimate
    """

    name: str
    budgets: tuple[int, ...]
    widths: tuple[float, ...]
    seeds: tuple[int, ...]
    hidden: tuple[int, ...]
    steps: int
    population: int
    truth: tuple[float, float] = (2.0, 1.5)
    prior: tuple[float, float] = (1.0, 1.0)
    sigma: float = 1.0
    episodes: int = 20
    reference_seeds: tuple[int, ...] = tuple(range(10))
    batch: int = 256
    random_steps: int = 1000
    grid: int = 450
    resamples: int = 20_000

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Every run. Seeds vary slowest: whole grids of the first seeds are finished first."""
        return tuple(Cell(n, w, seed) for seed in self.seeds for n in self.budgets for w in self.widths)

    @property
    def populations(self) -> tuple[tuple[Cell, ...], ...]:
        """The runs that train together: consecutive cells, `population` at a time."""
        cells = self.cells
        return tuple(cells[i : i + self.population] for i in range(0, len(cells), self.population))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return json.loads(json.dumps(dataclasses.asdict(self)))

    @property
    def fingerprint(self) -> str:
        """Sixteen hexadecimal digits that change with any setting and with FORMAT."""
        text = json.dumps({"format": FORMAT, **self.to_dict()}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


QUICK = Preset(
    name="quick",
    budgets=(0, 5, 50),
    widths=(0.0, 0.5),
    seeds=(0, 1, 2),
    hidden=(64, 64),
    steps=30_000,
    population=9,
)

PAPER = Preset(
    name="paper",
    budgets=(0, 5, 10, 25, 50),
    widths=(0.0, 0.1, 0.2, 0.3, 0.5),
    seeds=tuple(range(10)),
    hidden=(256, 256),
    steps=75_000,
    population=25,
    grid=600,
)

SMOKE = Preset(
    name="smoke",
    budgets=(0, 2),
    widths=(0.0,),
    seeds=(0, 1),
    hidden=(8, 8),
    steps=1200,
    population=2,
    batch=32,
    random_steps=200,
    episodes=5,
    grid=100,
)

PRESETS = {preset.name: preset for preset in (QUICK, PAPER, SMOKE)}
