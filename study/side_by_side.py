"""The published sweep and this one in one figure each: the heat map, the best width at every budget, the contrasts.

Both sides share their scale, which ends at the optimum of the hidden plant. A cell's small number is how much of the
gap between no data at all, (n, w) = (0, 0), and that optimum it closes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from study.agreement import Agreement, ContrastAgreement
from study.answer import number
from study.figures import ACCENT, COLOURS, PAPER_WHITE
from study.paper import CELLS
from study.published import Summary
from study.references import LQR, OPTIMAL, SWING_UP
from study.statistics import Contrast

NAMES = {OPTIMAL: "optimal", SWING_UP: "swing-up + LQR", LQR: "LQR alone"}
THEIRS, OURS = "0.45", COLOURS(0.35)
"""Colours of the published numbers and of these."""

Sweep = Mapping[tuple[int, float], Summary]
"""Return by (n, w)."""


def published_sweep(point: str = "main") -> Sweep:
    """The paper's cells of an operating point."""
    return {
        (c.spot.n, c.spot.w): Summary(c.mean, c.sem, c.median, c.seeds) for c in CELLS.values() if c.spot.point == point
    }


def sweep(agreement: Agreement, point: str = "main") -> Sweep:
    """Our cells of an operating point."""
    ours = agreement.ours
    return {(spot.n, spot.w): ours.summary(spot) for spot in ours.table if spot.point == point}


def heatmaps(theirs: Sweep, ours: Sweep, titles: tuple[str, str], references: Mapping[str, float]) -> Figure:
    """Mean return +- SEM of every cell, published on the left, here on the right; the best cell is outlined."""
    budgets, widths = sorted({n for n, _ in theirs}), sorted({w for _, w in theirs})
    means = [c.mean for c in [*theirs.values(), *(ours[key] for key in theirs if key in ours)]]
    low, high = min(means), max(*means, references[OPTIMAL])
    figure = Figure(figsize=(10.0, 4.7), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, 2, sharey=True))
    for axes, cells, title in zip(panels, (theirs, ours), titles, strict=True):
        image = _panel(axes, cells, (budgets, widths), (low, high), references[OPTIMAL])
        axes.set_title(title, fontsize=11.0, pad=8.0)
    panels[0].set_ylabel("rollouts measured, n")
    figure.supxlabel(
        "width w of the training band around the estimate\n"
        "bold: mean return; below: standard error over seeds · share of the gap from no data to the optimum",
        fontsize=9.5,
        color="0.15",
    )
    _scale(figure, panels, image, (low, high), references)
    return figure


def _panel(
    axes: Axes, cells: Sweep, grid: tuple[Sequence[int], Sequence[float]], ends: tuple[float, float], optimum: float
) -> Any:
    budgets, widths = grid
    low, high = ends
    values = np.array([[cells[n, w].mean if (n, w) in cells else math.nan for w in widths] for n in budgets])
    image = axes.imshow(values, cmap=COLOURS, vmin=low, vmax=high, aspect="auto")
    start = cells[budgets[0], widths[0]].mean if (budgets[0], widths[0]) in cells else math.nan
    for i, n in enumerate(budgets):
        for j, w in enumerate(widths):
            if (n, w) not in cells:
                axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, facecolor="0.93", edgecolor="white"))
                axes.text(j, i, "not run", ha="center", va="center", color="0.55", fontsize=8.0)
                continue
            cell = cells[n, w]
            colour = "0.05" if (cell.mean - low) / (high - low or 1.0) > 0.55 else "white"
            axes.text(
                j, i - 0.11, number(cell.mean), ha="center", va="center", color=colour, fontsize=11.5, weight="bold"
            )
            error = "" if math.isnan(cell.sem) else f"± {cell.sem:.0f}"
            closed = 100.0 * (cell.mean - start) / (optimum - start)
            share = "" if (i, j) == (0, 0) or math.isnan(closed) else f"{number(round(closed) + 0.0)} %"
            axes.text(j, i + 0.24, " · ".join(filter(None, (error, share))), ha="center", va="center", color=colour,
                      fontsize=7.6)  # fmt: skip
    if cells:
        n, w = max((key for key in cells if key[0] in budgets and key[1] in widths), key=lambda key: cells[key].mean)
        corner = widths.index(w) - 0.5, budgets.index(n) - 0.5
        axes.add_patch(
            Rectangle(corner, 1.0, 1.0, fill=False, edgecolor=ACCENT, linewidth=2.6, zorder=3, clip_on=False)
        )
    axes.set_xticks(range(len(widths)), [f"{w:g}" for w in widths])
    axes.set_yticks(range(len(budgets)), [str(n) for n in budgets])
    for edge in range(1, len(widths)):
        axes.axvline(edge - 0.5, color="white", linewidth=1.2)
    for edge in range(1, len(budgets)):
        axes.axhline(edge - 0.5, color="white", linewidth=1.2)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    return image


def _scale(
    figure: Figure, panels: Sequence[Axes], image: Any, ends: tuple[float, float], references: Mapping[str, float]
) -> None:
    low, high = ends
    bar = figure.colorbar(image, ax=panels, pad=0.02, aspect=22, extend="min")
    bar.outline.set_visible(False)
    ticks = [t for t in bar.get_ticks() if low <= t <= high - 0.12 * (high - low)]
    bar.set_ticks(ticks, labels=[number(t) for t in ticks])
    bar.ax.tick_params(length=0, labelsize=9.0)
    optimum, swing_up, lqr = (references[c] for c in (OPTIMAL, SWING_UP, LQR))
    bar.ax.annotate(f"{number(optimum)} {NAMES[OPTIMAL]}\n{number(swing_up)} swing-up", (1.0, 1.0), (4, 2), va="top",
                    xycoords="axes fraction", textcoords="offset points", fontsize=9.0, color=ACCENT)  # fmt: skip
    bar.ax.annotate(f"{number(lqr)} {NAMES[LQR]}", (1.0, 0.0), (4, -6), va="top", xycoords="axes fraction",
                    textcoords="offset points", fontsize=9.0, color=ACCENT)  # fmt: skip


def paretos(theirs: Sweep, ours: Sweep, titles: tuple[str, str], references: Mapping[str, float]) -> Figure:
    """The best mean return at every budget, there and here, between each side's extremes and the references."""
    figure = Figure(figsize=(10.0, 4.3), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, 2, sharey=True))
    for axes, cells, title in zip(panels, (theirs, ours), titles, strict=True):
        if axes is panels[1]:
            best = _best(theirs)
            axes.plot(list(best), [theirs[key].mean for key in best.values()], color="0.75", linewidth=1.4, zorder=1)
        _pareto(axes, cells)
        axes.set_title(title, fontsize=11.0, pad=8.0)
        axes.set_xticks(sorted({n for n, _ in theirs}))
    low = min(c.mean for side in (theirs, ours) for c in side.values())
    _reference_lines(panels, references, low)
    panels[0].set_ylabel("best mean return at a budget (± SEM)")
    figure.supxlabel("rollouts measured, n", fontsize=10.0, color="0.15")
    return figure


def _best(cells: Sweep) -> dict[int, tuple[int, float]]:
    """The best cell at every budget."""
    budgets = sorted({n for n, _ in cells})
    return {n: max((key for key in cells if key[0] == n), key=lambda key: cells[key].mean) for n in budgets}


def _pareto(axes: Axes, cells: Sweep) -> None:
    best = _best(cells)
    if not best:
        return
    first, last = min(best), max(best)
    breadth = first, max(w for n, w in cells if n == first)
    fidelity = last, min(w for n, w in cells if n == last)
    for (n, w), name, style, shift in ((fidelity, "pure fidelity", "--", -34), (breadth, "pure breadth", ":", 10)):
        axes.axhline(cells[n, w].mean, color="0.35", linestyle=style, linewidth=1.0, zorder=1)
        axes.annotate(f"{name}, n = {n}, w = {w:g}: {number(cells[n, w].mean)}", (0.98, cells[n, w].mean), (0, shift),
                      xycoords=axes.get_yaxis_transform(), textcoords="offset points", va="center", ha="right",
                      color="0.35", fontsize=9.0)  # fmt: skip
    means, errors = ([getattr(cells[key], name) for key in best.values()] for name in ("mean", "sem"))
    axes.errorbar(list(best), means, errors, color=OURS, marker="o", markersize=6, linewidth=1.8, capsize=3, zorder=3)
    for (n, w), mean, error in zip(best.values(), means, errors, strict=True):
        low, right = 0.0 if math.isnan(error) else error, n == last
        axes.annotate(f"w* = {w:g}", (n, mean - low), (5, -16 if right else -5), textcoords="offset points", va="top",
                      color="0.2", fontsize=9.0, ha="right" if right else "left", bbox=PAPER_WHITE)  # fmt: skip


def _reference_lines(panels: Sequence[Axes], references: Mapping[str, float], low: float) -> None:
    """Optimal and swing-up as lines, what lies below the figure as words."""
    high, end = references[OPTIMAL], panels[-1]
    room = 0.12 * (high - low)
    end.set_ylim(low - room, high + room)
    for controller, style, shift in ((OPTIMAL, "-", 6), (SWING_UP, "-.", -6)):
        value = references[controller]
        for axes in panels:
            axes.axhline(value, color=ACCENT, linestyle=style, linewidth=1.1, zorder=1)
        end.annotate(f"{NAMES[controller]} {number(value)}", (1.0, value), (5, shift), va="center", color=ACCENT,
                     xycoords=end.get_yaxis_transform(), textcoords="offset points", fontsize=9.0)  # fmt: skip
    lqr = references[LQR]
    if lqr < low - room:
        end.annotate(f"↓ {NAMES[LQR]} {number(lqr)}", (1.0, 0.0), (5, 4), xycoords="axes fraction", color=ACCENT,
                     textcoords="offset points", fontsize=9.0, va="bottom")  # fmt: skip
        return
    for axes in panels:
        axes.axhline(lqr, color=ACCENT, linestyle=":", linewidth=1.1, zorder=1)
    end.annotate(f"{NAMES[LQR]} {number(lqr)}", (1.0, lqr), (5, 0), va="center", color=ACCENT, fontsize=9.0,
                 xycoords=end.get_yaxis_transform(), textcoords="offset points")  # fmt: skip


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
    axes.grid(axis="x", color="0.92", linewidth=0.8)
    axes.set_axisbelow(True)
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


def titles(hidden: Sequence[int], seeds: int) -> tuple[str, str]:
    """What stands above the two sides."""
    layers = " × ".join(map(str, hidden))  # noqa: RUF001
    return "Published (256 × 256 networks, 10 seeds)", f"Here ({layers} networks, {seeds} seed{'s' * (seeds != 1)})"  # noqa: RUF001
