"""The study's figures, each a function of the answer; files are written by `save_all`.

heatmap   mean return of every cell, n down, w across      pareto   the best width at every budget
gap       agents and perfect designers against the optimum  curves   how training went
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from study.answer import Answer, number
from study.files import write_whole
from study.statistics import sem
from study.store import figure_name

STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 12.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "0.4",
    "axes.labelcolor": "0.15",
    "xtick.color": "0.3",
    "ytick.color": "0.3",
    "legend.frameon": False,
    "figure.dpi": 160.0,
    "figure.constrained_layout.w_pad": 0.1,
    "figure.constrained_layout.h_pad": 0.08,
}
COLOURS = matplotlib.colormaps["viridis"]
ACCENT = "#c8102e"
PAPER_WHITE = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
SMOOTH = 10
"""Training episodes averaged into a point of a learning curve."""


def heatmap(answer: Answer) -> Figure:
    """Mean return +- SEM of every cell; the best cell is outlined; the brightest colour is the optimum."""
    budgets, widths = answer.point.budgets, answer.point.widths
    values = np.array([[answer.mean((n, w)) for w in widths] for n in budgets])
    figure = Figure(figsize=(2.4 + 1.25 * max(2, len(widths)), 1.5 + 0.62 * len(budgets)), layout="constrained")
    axes = figure.add_subplot()
    low, high = float(values.min()), max(answer.optimum, float(values.max()))
    image = axes.imshow(values, cmap=COLOURS, vmin=low, vmax=high, aspect="auto")
    for i, n in enumerate(budgets):
        for j, w in enumerate(widths):
            bright = (values[i, j] - low) / (high - low or 1.0) > 0.55
            text = number(values[i, j]) + (f" ± {answer.sem((n, w)):.0f}" if len(answer.point.seeds) > 1 else "")
            axes.text(j, i, text, ha="center", va="center", color="0.05" if bright else "white")
    i, j = budgets.index(answer.best[0]), widths.index(answer.best[1])
    axes.add_patch(
        Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, fill=False, edgecolor=ACCENT, linewidth=3.0, zorder=3, clip_on=False)
    )
    axes.set_xticks(range(len(widths)), [_width(w) for w in widths])
    axes.set_yticks(range(len(budgets)), [str(n) for n in budgets])
    axes.set_xlabel("width w of the training band around the estimate")
    axes.set_ylabel("rollouts measured, n")
    axes.set_title("Mean return on the hidden plant")
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    bar = figure.colorbar(image, ax=axes, pad=0.03, aspect=18)
    bar.outline.set_visible(False)
    ticks = [t for t in bar.get_ticks() if low <= t <= high - 0.06 * (high - low)]
    bar.set_ticks([*ticks, high], labels=[*(number(t) for t in ticks), f"{number(high)} optimum"])
    bar.ax.tick_params(length=0)
    return figure


def pareto(answer: Answer) -> Figure:
    """The best mean return at every budget and the width that reached it, between two extremes and the optimum."""
    budgets, widths = answer.point.budgets, answer.point.widths
    chosen = [answer.best_width(n) for n in budgets]
    means = [answer.mean((n, w)) for n, w in zip(budgets, chosen, strict=True)]
    errors = [answer.sem((n, w)) for n, w in zip(budgets, chosen, strict=True)]
    figure = Figure(figsize=(6.6, 4.2), layout="constrained")
    axes = figure.add_subplot()
    first, last = (budgets[0], widths[-1]), (budgets[-1], widths[0])
    lines = (
        (answer.optimum, "optimum", ACCENT, "-", "bottom"),
        (answer.mean(last), f"pure fidelity\nn = {last[0]}, w = {last[1]:g}", "0.35", "--", "top"),
        (answer.mean(first), f"pure breadth\nn = {first[0]}, w = {first[1]:g}", "0.35", ":", "center"),
    )
    for value, label, colour, style, place in lines:
        axes.axhline(value, color=colour, linestyle=style, linewidth=1.2, zorder=1)
        axes.annotate(label, (1.0, value), (5, {"bottom": -2, "top": -1, "center": 0}[place]), va=place, color=colour,
                      xycoords=axes.get_yaxis_transform(), textcoords="offset points", fontsize=9.0)  # fmt: skip
    axes.errorbar(
        budgets, means, yerr=errors, color=COLOURS(0.35), marker="o", markersize=6, linewidth=1.8, capsize=3, zorder=3
    )
    for n, mean, error, w in zip(budgets, means, errors, chosen, strict=True):
        low_end = mean - float(np.nan_to_num(error))
        axes.annotate(f"w* = {w:g}", (n, low_end), (4, -6), textcoords="offset points", va="top", color="0.25",
                      fontsize=9.0, ha="right" if n == budgets[-1] else "left", bbox=PAPER_WHITE)  # fmt: skip
    low = min(*means, lines[2][0])
    room = 0.12 * (answer.optimum - low)
    axes.set_ylim(low - 1.3 * room, answer.optimum + room)
    axes.set_xticks(budgets)
    axes.set_xlabel("rollouts measured, n")
    axes.set_ylabel("best mean return on the hidden plant (± SEM)")
    axes.set_title("What the next rollout is worth")
    return figure


def gap(answer: Answer) -> Figure:
    """Agents at every width, and the controller that is optimal for the estimate, below the optimum of the plant."""
    budgets, widths = answer.point.budgets, answer.point.widths
    figure = Figure(figsize=(6.6, 4.2), layout="constrained")
    axes = figure.add_subplot()
    x = np.arange(len(budgets), dtype=float)
    axes.axhline(answer.optimum, color=ACCENT, linewidth=1.2, zorder=1)
    axes.annotate(f"optimum {number(answer.optimum)}", (1.0, answer.optimum), (0, 4), textcoords="offset points",
                  xycoords=axes.get_yaxis_transform(), ha="right", va="bottom", color=ACCENT, fontsize=9.0)  # fmt: skip
    design = [answer.design((n, widths[0])) for n in budgets]
    axes.errorbar(x, [np.mean(d) for d in design], [sem(d) for d in design], color="0.1", marker="D", markersize=6,
                  linestyle="none", capsize=3, label="optimal for the estimate", zorder=3)  # fmt: skip
    offsets = 0.16 + 0.56 * np.arange(len(widths)) / max(1, len(widths) - 1) * min(1.0, len(widths) / 5.0)
    for w, offset, colour in zip(widths, offsets, _width_colours(len(widths)), strict=True):
        means = [answer.mean((n, w)) for n in budgets]
        errors = [answer.sem((n, w)) for n in budgets]
        axes.errorbar(x + offset, means, errors, color=colour, marker="o", markersize=5, linestyle="none", capsize=2,
                      label=f"agent, {answer.label(w)}", zorder=3)  # fmt: skip
    axes.set_xticks(x + 0.5 * offsets[-1], [str(n) for n in budgets])
    axes.tick_params(axis="x", length=0)
    for edge in x[1:] - 0.5 * (1.0 - offsets[-1]):
        axes.axvline(edge, color="0.9", linewidth=0.8, zorder=0)
    axes.set_xlabel("rollouts measured, n")
    axes.set_ylabel("mean return on the hidden plant (± SEM)")
    axes.set_title("Why agents are short of the optimum")
    axes.legend(loc="lower right" if len(budgets) > 1 else "center", fontsize=9.0)
    return figure


def curves(answer: Answer) -> Figure:
    """Training returns, in the simulators an agent trains on, averaged over seeds and a few episodes."""
    budgets, widths = answer.point.budgets, answer.point.widths
    figure = Figure(figsize=(1.2 + 2.0 * len(budgets), 2.9), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, len(budgets), sharey=True, squeeze=False)[0])
    for axes, n in zip(panels, budgets, strict=True):
        for w, colour in zip(widths, _width_colours(len(widths)), strict=True):
            table = [run.curve for run in answer.cells[n, w] if run.curve]
            episodes = min((len(curve) for curve in table), default=0)
            size = min(SMOOTH, max(1, episodes))
            usable = episodes - episodes % size
            if not usable:
                continue
            steps = np.array([step for step, _ in table[0][:usable]]).reshape(-1, size)[:, -1]
            returns = np.array([[value for _, value in curve[:usable]] for curve in table])
            axes.plot(
                steps / 1000.0, returns.reshape(len(table), -1, size).mean((0, 2)), color=colour, label=answer.label(w)
            )
        axes.set_title(f"n = {n}", fontweight="normal", loc="center", pad=4)
    panels[0].set_ylabel("training return")
    labelled = [axes for axes in panels if axes.lines]
    if labelled:
        labelled[-1].legend(fontsize=8.0, loc="lower right")
    lacking = sum(not run.curve for run in answer.runs)
    if lacking:
        figure.suptitle(f"{lacking} of {len(answer.runs)} runs were imported without learning curves", fontsize=9.0)
    figure.supxlabel("environment steps [thousands]", fontsize=10.0)
    return figure


FIGURES: dict[str, Callable[[Answer], Figure]] = {"heatmap": heatmap, "pareto": pareto, "gap": gap, "curves": curves}


def drawn_of(answer: Answer) -> list[str]:
    """The figures that say something: of a choice where there is one, and of curves that are known."""
    point = answer.point
    idle = {
        "heatmap": len(point.budgets) * len(point.widths) == 1,
        "pareto": len(point.budgets) == 1,
        "curves": not any(run.curve for run in answer.runs),
    }
    return [name for name in FIGURES if not idle.get(name)]


def save_all(answer: Answer, folder: Path) -> dict[str, Path]:
    """Draw the figures of an operating point into the folder; returns the files by name (`store.figure_name`)."""
    names = drawn_of(answer)
    files = {name: folder / figure_name(answer.preset, answer.point.name, name) for name in names}
    for name, path in files.items():
        save(lambda name=name: FIGURES[name](answer), path)
    return files


def save(draw: Callable[[], Figure], path: Path) -> Path:
    """Draw a figure in the study's style into a PNG file; returns the path."""
    with matplotlib.rc_context(STYLE):
        figure = draw()
        FigureCanvasAgg(figure)
        content = io.BytesIO()
        figure.savefig(content, format="png")
        write_whole(path, content.getvalue())
    return path


def _width(w: float) -> str:
    return "0" if w == 0 else f"{w:g}  (±{100 * w:.0f} %)"


def _width_colours(count: int) -> list[tuple[float, ...]]:
    return [COLOURS(0.15 + 0.7 * k / max(1, count - 1)) for k in range(count)]
