"""What the naming study found: how often the answer was right, and how far m and l were off, as table and figure.

Right is to name the effect, alone: as itself, as one that contains it, or in a class that the log cannot tell apart
("cannot tell"). Where the catalogue lacks the effect it is right to say that something unknown is left: "unknown" or,
beside what was named, "partly". Where nothing is missing "adequate" is right.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, NullLocator

from study.figure_style import panel_title
from study.formatting import capital
from study.mismatch.mismatch_plan import PLANS
from study.pipeline.tables import read_table, write_table
from study.statistics import wilson
from study.trials.hidden_plant import HiddenPlant
from sysid import CATALOGUE

PLAN, NAMING_TABLE = PLANS["mismatch"], "naming.csv"

CONTAINS = {"coulomb": ("stribeck", "asymmetric_coulomb")}
"""Larger effects that are the effect at some of their numbers: to name one of them is right, too."""

RIGHT, COMPANY, PLAIN = "#D55E00", "0.6", "#0072B2"
"""Colours of the right answer, of an accompanied one, and of the model that lacks the effect."""

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


class Rate(NamedTuple):
    """How often, of so many seeds, the naming was right.

    accompanied   how often the effect was named, but with another, or with something left that nothing explains
    """

    right: int
    accompanied: int
    seeds: int

    @property
    def share(self) -> float:
        return self.right / self.seeds

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's, of 95 %."""
        return wilson(self.right, self.seeds)


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


def naming_rates(rows: Iterable[NamingResult]) -> dict[tuple[str, int], Rate]:
    """By (plant, n)."""
    found: dict[tuple[str, int], Rate] = {}
    for row in rows:
        right, accompanied, seeds = found.get((row.plant, row.n), (0, 0, 0))
        company = not row.right and names(PLAN.plant(row.plant), row.steps)
        found[row.plant, row.n] = Rate(right + row.right, accompanied + company, seeds + 1)
    return found


def naming_errors(rows: Iterable[NamingResult], plant: str, n: int) -> tuple[float, float]:
    """Root mean squares over seeds of the errors of m and l, fitted and mended; nan where there is no row."""
    own = [(r.error_fitted, r.error_mended) for r in rows if (r.plant, r.n) == (plant, n) and r.verdict != REFUSED]
    fitted, mended = np.sqrt(np.mean(np.square(own), axis=0)) if own else (math.nan, math.nan)
    return float(fitted), float(mended)


@dataclass(frozen=True)
class NamingTable:
    """The rates as text: "93 [86, 97] (2.1, 0.4)" is the rate with its interval, and the errors of m and l without and
    with what was named, all in percent.

    seeds     how many a cell has: "100", or "20 to 100"
    lines     (hidden plant, a cell a budget); "" for what was not measured
    """

    budgets: tuple[int, ...]
    seeds: str
    lines: tuple[tuple[str, tuple[str, ...]], ...]


def naming_table(rows: Sequence[NamingResult]) -> NamingTable:
    """What was found, in the plan's order of plants."""
    found, budgets = naming_rates(rows), tuple(sorted({row.n for row in rows}))

    def cell(plant: str, n: int) -> str:
        """The text of a plant and a budget; empty where it was not measured."""
        if (plant, n) not in found:
            return ""
        rate, errors = found[plant, n], naming_errors(rows, plant, n)
        low, high = rate.interval
        fitted, mended = (f"{100.0 * error:.2g}" for error in errors)
        return f"{100 * rate.share:.0f} [{100 * low:.0f}, {100 * high:.0f}] ({fitted}, {mended})"

    known = [plant for plant in PLAN.plants if any(name == plant.name for name, _ in found)]
    seeds = sorted({rate.seeds for rate in found.values()})
    return NamingTable(
        budgets,
        " to ".join(str(s) for s in dict.fromkeys((seeds[0], seeds[-1]))),
        tuple((capital(plant.title), tuple(cell(plant.name, n) for n in budgets)) for plant in known),
    )


def read_naming(path: Path) -> list[NamingResult]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    known = {"plant": [plant.name for plant in PLAN.plants]}
    return read_table(NamingResult, path, "effects that were named", optional=True, known=known)


def write_naming(path: Path, rows: Iterable[NamingResult]) -> None:
    """The rows as a CSV file, in the plan's order of plants; whole or not at all."""
    order = [plant.name for plant in PLAN.plants]
    write_table(NamingResult, path, sorted(rows, key=lambda row: (order.index(row.plant), row.n, row.seed)))


def naming_rates_and_errors(rows: Sequence[NamingResult]) -> Figure:
    """Above: how often the right answer is given over n, with Wilson's 95 % band; dashed: the effect and something
    else. Below: root mean square relative error of m and l, without (blue) and with what was named."""
    plants = [p for p in PLAN.plants if any(row.plant == p.name for row in rows)]
    figure = Figure(figsize=(11.0, 4.9), layout="constrained")
    panels = figure.subplots(2, max(1, len(plants)), sharex=True, sharey="row", squeeze=False, height_ratios=(1.0, 1.0))
    for plant, upper, lower in zip(plants, *panels, strict=False):
        _rates(upper, plant, rows)
        _errors(lower, plant, rows)
    budgets = sorted({row.n for row in rows})
    first, below = panels[:, 0]
    first.set_ylim(-3.0, 103.0)
    first.set_ylabel("right answer [%]")
    below.set_yscale("log")
    below.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    below.set_ylabel("RMS error of m and l [%]")
    below.set_xscale("log")
    below.set_xticks(budgets, [str(n) for n in budgets])
    for axes in panels[1]:
        axes.tick_params(axis="x", labelsize=8.0)
        axes.xaxis.set_minor_locator(NullLocator())
    figure.supxlabel("rollouts, n", fontsize=10.0)
    handles = [
        Line2D([], [], color=RIGHT, marker="o", markersize=4, label="diagnosed (above: right)"),
        Line2D([], [], color=COMPANY, linestyle="--", label="right effect, but not alone"),
        Line2D([], [], color=PLAIN, marker="s", markersize=7, markerfacecolor="none", label="m and l alone"),
        Patch(color=RIGHT, alpha=0.18, label="95 %"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=9.0)
    return figure


def _rates(axes: Axes, plant: HiddenPlant, rows: Sequence[NamingResult]) -> None:
    found = {n: rate for (name, n), rate in sorted(naming_rates(rows).items()) if name == plant.name}
    low, high = zip(*(rate.interval for rate in found.values()), strict=True)
    axes.fill_between(list(found), [100.0 * x for x in low], [100.0 * x for x in high], color=RIGHT, alpha=0.18,
                      linewidth=0.0)  # fmt: skip
    axes.plot(list(found), [100.0 * rate.share for rate in found.values()], color=RIGHT, marker="o", markersize=4)
    accompanied = [100.0 * rate.accompanied / rate.seeds for rate in found.values()]
    if any(accompanied):
        axes.plot(list(found), accompanied, color=COMPANY, linestyle="--", linewidth=1.2)
    wanted = {None: "adequate", False: "unknown, partly", True: ""}[plant.in_catalogue]
    panel_title(axes, plant.noun, plant.size, wanted and f"right: “{wanted}”", fontsize=10.0)
    axes.grid(axis="y", color="0.92", linewidth=0.8)


def _errors(axes: Axes, plant: HiddenPlant, rows: Sequence[NamingResult]) -> None:
    budgets = sorted({row.n for row in rows if row.plant == plant.name})
    fitted, mended = zip(*(naming_errors(rows, plant.name, n) for n in budgets), strict=True)
    axes.plot(budgets, [100.0 * e for e in fitted], color=PLAIN, marker="s", markersize=8, markerfacecolor="none")
    axes.plot(budgets, [100.0 * e for e in mended], color=RIGHT, marker="o", markersize=4)
    axes.grid(axis="y", color="0.92", linewidth=0.8)
