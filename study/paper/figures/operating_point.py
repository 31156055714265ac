"""What a finished operating point shows, each figure a function of its findings; `save_all` writes the files.

heatmap   mean return of every cell, n down, w across      pareto   the best width at every budget
gap       agents and perfect designers against the optimum  curves   how training went
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from study.figure_style import save, width_colours
from study.paper.figures import sweeps
from study.paper.figures.sweeps import reference_lines
from study.paper.findings import PointFindings
from study.paper.sweep import figure_name
from study.statistics import sem

SMOOTH = 10
"""Training episodes averaged into a point of a learning curve."""


def heatmap(findings: PointFindings) -> Figure:
    """Mean return +- SEM of every cell; the best cell is outlined; the brightest colour is the optimum."""
    return sweeps.heatmaps({"Mean return on the hidden plant": findings.summaries}, findings.allowed())


def pareto(findings: PointFindings) -> Figure:
    """The best mean return at every budget and the width that reached it, between two extremes and the references."""
    return sweeps.paretos({"What the next rollout is worth": findings.summaries}, findings.allowed())


def gap(findings: PointFindings) -> Figure:
    """Agents at every width, and the controller that is optimal for the estimate, below the optimum of the plant."""
    budgets, widths = findings.point.budgets, findings.point.widths
    figure = Figure(figsize=(6.6, 4.2), layout="constrained")
    axes = figure.add_subplot()
    x = np.arange(len(budgets), dtype=float)
    design = [findings.design((n, widths[0])) for n in budgets]
    axes.errorbar(x, [np.mean(d) for d in design], [sem(d) for d in design], color="0.1", marker="D", markersize=6,
                  linestyle="none", capsize=3, label="optimal for the estimate", zorder=3)  # fmt: skip
    offsets = 0.16 + 0.56 * np.arange(len(widths)) / max(1, len(widths) - 1) * min(1.0, len(widths) / 5.0)
    lows = [float(np.mean(d)) - _reach(sem(d)) for d in design]
    for w, offset, colour in zip(widths, offsets, width_colours(len(widths)), strict=True):
        means, errors = zip(*(findings.summaries[n, w][:2] for n in budgets), strict=True)
        lows += [mean - _reach(error) for mean, error in zip(means, errors, strict=True)]
        axes.errorbar(x + offset, means, errors, color=colour, marker="o", markersize=5, linestyle="none", capsize=2,
                      label=f"agent, {findings.label(w)}", zorder=3)  # fmt: skip
    axes.set_xticks(x + 0.5 * offsets[-1], [str(n) for n in budgets])
    axes.tick_params(axis="x", length=0)
    for edge in x[1:] - 0.5 * (1.0 - offsets[-1]):
        axes.axvline(edge, color="0.9", linewidth=0.8, zorder=0)
    reference_lines([axes], findings.allowed(), min(lows))
    axes.set_xlabel("rollouts measured, n")
    axes.set_ylabel("mean return on the hidden plant (± SEM)")
    axes.set_title("Why agents are short of the optimum")
    axes.legend(loc="lower right" if len(budgets) > 1 else "center", fontsize=9.0)
    return figure


def _reach(error: float) -> float:
    """How far a bar reaches; one seed has none."""
    return error if math.isfinite(error) else 0.0


def curves(findings: PointFindings) -> Figure:
    """Training returns, in the simulators an agent trains on, averaged over seeds and a few episodes."""
    budgets, widths = findings.point.budgets, findings.point.widths
    figure = Figure(figsize=(1.2 + 2.0 * len(budgets), 2.9), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, len(budgets), sharey=True, squeeze=False)[0])
    for axes, n in zip(panels, budgets, strict=True):
        for w, colour in zip(widths, width_colours(len(widths)), strict=True):
            table = [run.curve for run in findings.cells[n, w] if run.curve]
            episodes = min((len(curve) for curve in table), default=0)
            size = min(SMOOTH, max(1, episodes))
            usable = episodes - episodes % size
            if not usable:
                continue
            steps = np.array([step for step, _ in table[0][:usable]]).reshape(-1, size)[:, -1]
            returns = np.array([[value for _, value in curve[:usable]] for curve in table])
            axes.plot(
                steps / 1000.0,
                returns.reshape(len(table), -1, size).mean((0, 2)),
                color=colour,
                label=findings.label(w),
            )
        axes.set_title(f"n = {n}", fontweight="normal", loc="center", pad=4)
    panels[0].set_ylabel("training return")
    labelled = [axes for axes in panels if axes.lines]
    if labelled:
        labelled[-1].legend(fontsize=8.0, loc="lower right")
    lacking = sum(not run.curve for run in findings.runs)
    if lacking:
        figure.suptitle(f"{lacking} of {len(findings.runs)} runs were imported without learning curves", fontsize=9.0)
    figure.supxlabel("environment steps [thousands]", fontsize=10.0)
    return figure


DRAWINGS: dict[str, Callable[[PointFindings], Figure]] = {
    "heatmap": heatmap,
    "pareto": pareto,
    "gap": gap,
    "curves": curves,
}


def drawn_of(findings: PointFindings) -> list[str]:
    """The figures that say something: of a choice where there is one, and of curves that are known."""
    point = findings.point
    idle = {
        "heatmap": len(point.budgets) * len(point.widths) == 1,
        "pareto": len(point.budgets) == 1,
        "curves": not any(run.curve for run in findings.runs),
    }
    return [name for name in DRAWINGS if not idle.get(name)]


def save_all(findings: PointFindings, folder: Path) -> dict[str, Path]:
    """Draw the figures of an operating point into the folder; returns the files by name (`store.figure_name`)."""
    names = drawn_of(findings)
    files = {name: folder / figure_name(findings.preset, findings.point.name, name) for name in names}
    for name, path in files.items():
        save(lambda name=name: DRAWINGS[name](findings), path)
    return files
