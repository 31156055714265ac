"""How many rollouts it takes to name the missing effect, and what that is worth to m and l: a panel a hidden plant."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, NullLocator

from study.figure_style import panel_title
from study.mismatch.mismatch_plan import PLANS
from study.mismatch.naming_results import NamingResult, naming_errors, naming_rates
from study.trials.hidden_plant import HiddenPlant

RIGHT, COMPANY, PLAIN = "#D55E00", "0.6", "#0072B2"


def naming_rates_and_errors(rows: Sequence[NamingResult]) -> Figure:
    """Above: how often the right answer is given over n, with Wilson's 95 % band; dashed: the effect and something
    else. Below: root mean square relative error of m and l, without (blue) and with what was named."""
    plants = [p for p in PLANS["mismatch"].plants if any(row.plant == p.name for row in rows)]
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
