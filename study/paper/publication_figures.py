"""What stands beside the publication: every contrast there and here, the scatter of the paper's grid search over the
budget, and the budget curve of three identifiers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

from study.figure_style import ACCENT, COLOURS, annotate_beside, faint_lines, shades
from study.formatting import number
from study.paper.agreement import ContrastAgreement
from study.paper.claims import CELL, nearest_cell
from study.paper.identification_scatter import Scatter
from study.paper.published_numbers import ID_ERRORS
from study.paper.saturation_budget import LABELS, BudgetCurve
from study.paper.sweep_figures import OURS, reference_lines
from study.statistics import Contrast

THEIRS = "0.45"
"""Colour of the published numbers."""


def contrasts(rows: Sequence[ContrastAgreement]) -> Figure:
    """Every published contrast: bootstrap intervals as bars, t intervals as thin lines, there (grey) and here."""
    figure = Figure(figsize=(8.4, 1.2 + 0.36 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    for k, row in enumerate(rows):
        _interval(axes, row.theirs, row.theirs_t, k - 0.16, THEIRS, "published")
        if row.ours and row.ours_t:
            _interval(axes, row.ours, row.ours_t, k + 0.16, OURS, "here")
    axes.axvline(0.0, color=ACCENT, linewidth=1.0, zorder=1)
    axes.set_yticks(range(len(rows)), [row.published.label for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xscale("symlog", linthresh=50.0, linscale=0.8)
    ticks = (-400, -200, -100, -50, 0, 50, 100, 200, 400)
    axes.set_xticks(ticks, [number(t) for t in ticks])
    axes.minorticks_off()
    axes.tick_params(axis="y", length=0)
    faint_lines(axes, "x")
    axes.set_xlabel("change of the mean return; 95 % intervals: bar bootstrap, line t")
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    axes.legend(unique.values(), unique.keys(), loc="upper left", fontsize=9.0, frameon=True, facecolor="white",
                edgecolor="none", framealpha=0.9)  # fmt: skip
    return figure


def _interval(axes: Axes, bootstrap: Contrast, t: Contrast, y: float, colour: Any, label: str) -> None:
    if math.isfinite(t.low):
        axes.plot([t.low, t.high], [y, y], color=colour, linewidth=1.2, zorder=2)
    axes.plot([bootstrap.low, bootstrap.high], [y, y], color=colour, linewidth=4.5, alpha=0.55, zorder=2,
              solid_capstyle="butt")  # fmt: skip
    axes.plot([bootstrap.mean], [y], color=colour, marker="o", markersize=4.5, linestyle="none", zorder=3, label=label)


POINT_OF_NOISE = {0.5: "low_noise", 1.0: "main", 2.0: "high_noise"}
"""Whose published errors belong to a noise level."""
IDENTIFIER_LOOKS = {"grid": ("0.4", "s"), "least_squares": (COLOURS(0.3), "o"), "unscented": (COLOURS(0.68), "^")}
"""Colour and marker of an identifier."""


def identification(found: Scatter) -> Figure:
    """Left: the mean error of theta_hat over n, with the published points. Right: m of single measurements."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    budgets = np.array(found.budgets, dtype=float)
    left.axvspan(5.0, 50.0, color="0.95", zorder=0)
    across = left.get_xaxis_transform()
    annotate_beside(left, "the paper's budgets", (np.sqrt(250.0), 0.02), (0, 3), va="baseline", ha="center",
                    color="0.45", fontsize=8.5, xycoords=across)  # fmt: skip
    for k, (sigma, colour) in enumerate(zip(found.sigmas, shades(len(found.sigmas), 0.12, 0.8), strict=True)):
        errors = found.errors(sigma)
        mean = errors.mean(axis=1)
        left.errorbar(budgets, mean, 1.96 * errors.std(axis=1, ddof=1) / np.sqrt(found.seeds), color=colour, marker="o",
                      markersize=4, linewidth=1.7, capsize=2, zorder=3)  # fmt: skip
        annotate_beside(left, f"σ = {sigma:g}", (budgets[-1], mean[-1]), (6, 0), color=colour)  # noqa: RUF001
        printed = {n: e for n, e in ID_ERRORS.get(POINT_OF_NOISE.get(sigma, ""), {}).items() if n}
        left.plot(list(printed), list(printed.values()), color=colour, marker="x", markersize=7, linestyle="none",
                  markeredgewidth=1.8, label="published" if k == 0 else None, zorder=4)  # fmt: skip
    guide = found.errors(1.0).mean(axis=1)[-1] * np.sqrt(budgets[-1] / budgets)
    left.plot(budgets, guide, color=ACCENT, linewidth=1.0, linestyle="--", zorder=1, label="1/√n")
    left.axhspan(nearest_cell(found.truth), CELL, color=ACCENT, alpha=0.12, linewidth=0.0, label="cells of the grid")
    _log_axis(left, found.budgets)
    left.set_yscale("log")
    left.set_ylim(0.015, 3.0)
    left.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0], ["0.02", "0.05", "0.1", "0.2", "0.5", "1", "2"])
    left.yaxis.set_minor_locator(NullLocator())
    left.set_ylabel("mean identification error")
    left.set_title("The error over the budget")
    left.legend(fontsize=8.5, loc="lower left", bbox_to_anchor=(0.0, 0.2))
    _masses(right, found)
    return figure


def _masses(axes: Axes, found: Scatter) -> None:
    edges = np.arange(0.3 - 1.5 * CELL, 3.0 + 3.0 * CELL, 3.0 * CELL)
    looks = ((False, COLOURS(0.35), 0.85, "noise in inputs too"), (True, "0.2", 1.0, "as much, in outputs alone"))
    for clean, colour, alpha, label in looks:
        m = found.thetas(1.0, 50, clean=clean)[:, 0]
        axes.stairs(*np.histogram(m, edges), fill=not clean, color=colour, alpha=alpha, label=label, linewidth=1.3)
    axes.axvline(found.truth[0], color=ACCENT, linewidth=1.4)
    across = axes.get_xaxis_transform()
    annotate_beside(axes, "the truth", (found.truth[0], 1.0), (4, -2), xycoords=across, va="top", color=ACCENT)
    axes.set_xlabel("m found from 50 rollouts, σ = 1  [kg]")  # noqa: RUF001
    axes.set_ylabel("measurements")
    axes.set_title("How m scatters")
    axes.legend(fontsize=8.5, loc="upper left")


def identifiers(
    curves: Mapping[str, BudgetCurve], wider: Mapping[str, BudgetCurve], references: Mapping[str, float]
) -> Figure:
    """Left: mean return over n for three identifiers, at w = 0 and wider (faint). Right: the error of theta_hat."""
    figure = Figure(figsize=(10.0, 4.3), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    for group, faint in ((wider, True), (curves, False)):
        for name, curve in group.items():
            colour, marker = IDENTIFIER_LOOKS[name]
            if faint:
                left.plot(_spread(curve.budgets), curve.returns, color=colour, linewidth=1.2, linestyle="--", alpha=0.7)
                continue
            left.errorbar(_spread(curve.budgets), curve.returns, curve.sems, color=colour, marker=marker, markersize=6,
                          linewidth=1.9, capsize=3, label=LABELS[name].removeprefix("the "), zorder=3)  # fmt: skip
    if wider:
        left.plot([], [], color="0.5", linestyle="--", linewidth=1.2, label=f"w = {next(iter(wider.values())).w:g}")
    lows = [value for group in (curves, wider) for curve in group.values() for value in curve.returns]
    reference_lines([left], references, min(lows))
    for name, curve in curves.items():
        colour, marker = IDENTIFIER_LOOKS[name]
        right.plot(curve.budgets[1:], curve.errors[1:], color=colour, marker=marker, markersize=6, linewidth=1.9)
    budgets = max((curve.budgets for curve in curves.values()), key=len)
    left.set_xticks(_spread(budgets), [str(n) for n in budgets])
    left.set_xlabel("rollouts measured, n")
    left.set_ylabel("mean return on the hidden plant")
    left.set_title("What a rollout is worth")
    left.legend(fontsize=9.0, loc="center right")
    _log_axis(right, budgets[1:])
    right.set_yscale("log")
    right.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    right.set_ylabel("mean identification error")
    right.set_title("How close m and l come")
    return figure


def _spread(budgets: Sequence[int]) -> list[float]:
    """Places of budgets on an axis on which one rollout is far from none."""
    return [float(np.log2(1.0 + 1.5 * n)) for n in budgets]


def _log_axis(axes: Axes, budgets: Sequence[int]) -> None:
    axes.set_xscale("log")
    axes.set_xticks(list(budgets), [str(n) for n in budgets])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xlabel("rollouts measured, n")
