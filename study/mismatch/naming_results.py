"""What the naming study found: how often the answer was right, and how far m and l were off, as a table.

Right is to name the effect, alone: as itself, as one that contains it, or in a class that the log cannot tell apart
("cannot tell"). Where the catalogue lacks the effect it is right to say that something unknown is left: "unknown" or,
beside what was named, "partly". Where nothing is missing "adequate" is right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from study.formatting import capital
from study.mismatch.mismatch_plan import PLANS
from study.pipeline.tables import read_table, write_table
from study.statistics import wilson
from study.trials.hidden_plant import HiddenPlant
from sysid import CATALOGUE

PLAN, NAMING_TABLE = PLANS["mismatch"], "naming.csv"

CONTAINS = {"coulomb": ("stribeck", "asymmetric_coulomb")}
"""Larger effects that are the effect at some of their numbers: to name one of them is right, too."""

REFUSED = "refused"
"""The verdict where the rollouts do not even allow a fit."""


@dataclass(frozen=True)
class NamingResult:
    """What n rollouts of a hidden plant led to.

    steps         what was added, in order; with "/" between the effects that the log cannot tell apart
    right         whether that is what is missing, and nothing else
    error_fitted  of m and l of the model that lacks the effect; error_mended: of that with what was added [1]
    """

    plant: str
    n: int
    seed: int
    verdict: str
    steps: tuple[str, ...]
    right: bool
    error_fitted: float
    error_mended: float


def is_right(plant: HiddenPlant, verdict: str, steps: Sequence[str]) -> bool:
    """Whether this is what the plant has, and nothing else."""
    if plant.effect is None:
        return verdict == "adequate"
    if plant.effect not in CATALOGUE:
        return verdict in ("unknown", "partly")
    return verdict in ("missing", "cannot tell") and len(steps) == 1 and names(plant, steps)


def names(plant: HiddenPlant, steps: Sequence[str]) -> bool:
    """Whether one of the steps is the plant's effect, one that contains it, or one that the log cannot tell from it."""
    wanted = {plant.effect, *CONTAINS.get(plant.effect or "", ())}
    return any(wanted & set(step.split("/")) for step in steps)


def naming_errors(rows: Iterable[NamingResult]) -> tuple[float, float]:
    """Root mean squares of the errors of m and l, fitted and mended; nan where there is no fit."""
    own = [(row.error_fitted, row.error_mended) for row in rows if row.verdict != REFUSED]
    fitted, mended = np.sqrt(np.mean(np.square(own), axis=0)) if own else (math.nan, math.nan)
    return float(fitted), float(mended)


def naming_table(rows: Sequence[NamingResult]) -> Table:
    """What was found, a line a hidden plant in the plan's order and a column a budget, all in percent.

    "93 [86, 97]" is how often the answer was right, with Wilson's interval, and "(2.1, 0.4)" below it are the errors
    of m and l without and with what was named; a cell is empty where nothing was measured.
    """
    cells: dict[tuple[str, int], list[NamingResult]] = {}
    for row in rows:
        cells.setdefault((row.plant, row.n), []).append(row)
    budgets, seeds = sorted({row.n for row in rows}), sorted({len(own) for own in cells.values()})
    counted = " to ".join(str(s) for s in dict.fromkeys((seeds[0], seeds[-1])))
    title = f"right [%] of {counted} seeds (errors of m and l without and with what was named [%])"
    table = Table(title=title, title_justify="left")
    for head in ("hidden plant", *(f"n = {n}" for n in budgets)):
        table.add_column(head, no_wrap=True)
    for plant in PLAN.plants:
        if any(name == plant.name for name, _ in cells):
            table.add_row(capital(plant.title), *(_cell(cells.get((plant.name, n), [])) for n in budgets))
    return table


def _cell(rows: Sequence[NamingResult]) -> str:
    if not rows:
        return ""
    right = sum(row.right for row in rows)
    low, high = wilson(right, len(rows))
    fitted, mended = (f"{100.0 * error:.2g}" for error in naming_errors(rows))
    return f"{100 * right / len(rows):.0f} [{100 * low:.0f}, {100 * high:.0f}]\n({fitted}, {mended})"


def read_naming(path: Path) -> list[NamingResult]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    known = {"plant": [plant.name for plant in PLAN.plants]}
    return read_table(NamingResult, path, "effects that were named", optional=True, known=known)


def write_naming(path: Path, rows: Iterable[NamingResult]) -> None:
    """The rows as a CSV file, in the plan's order of plants; whole or not at all."""
    order = [plant.name for plant in PLAN.plants]
    write_table(NamingResult, path, sorted(rows, key=lambda row: (order.index(row.plant), row.n, row.seed)))
