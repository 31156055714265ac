"""What a finished operating point shows, and what stands beside the publication.

heatmaps, paretos   mean return of every cell, n down, w across; the best width at every budget
curves              how training went
contrasts           every contrast, there and here
identification      the scatter of the paper's grid search over the budget; identifiers: the budget curve of three

Heat maps and best widths may stand side by side: then they share their scale, which ends at the optimum of the hidden
plant from the start states of the preset's reference seeds. A cell's small number is how much of the gap between no
data at all, (n, w) = (0, 0), and the optimum from the cell's own start states it closes.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation
from matplotlib.ticker import FuncFormatter, NullLocator
from matplotlib.transforms import BboxBase

from study.figure_style import ACCENT, COLOUR_MAP, annotate_beside, faint_lines, panels_abreast, shades
from study.formatting import number, percent
from study.paper.agreement import ContrastAgreement
from study.paper.claims import CELL, nearest_cell
from study.paper.identification_scatter import Scatter
from study.paper.published_numbers import ID_ERRORS, CellSummary
from study.paper.reference_controllers import LQR, OPTIMAL, SWING_UP
from study.paper.saturation_budget import LABELS, BudgetCurve
from study.paper.sweep_findings import PointFindings
from study.statistics import Contrast

OURS = COLOUR_MAP(0.35)
"""Colour of our numbers."""
NAMES = {OPTIMAL: "optimal", SWING_UP: "swing-up + LQR", LQR: "LQR alone"}
LINES = {OPTIMAL: ("-", 6), SWING_UP: ("-.", -6), LQR: (":", 0)}
"""Line style, and by how many points the name stands beside the line."""

Summaries = Mapping[tuple[int, float], CellSummary]
"""Return by (n, w)."""


def heatmaps(sides: Mapping[str, Summaries], references: Mapping[str, float], optima: Mapping[str, float]) -> Figure:
    """Mean return +- SEM of every cell of each side, by title; the best cell is outlined.

    The first side says which cells there are; optima: of each side, from the start states of its own seeds.
    """
    first = next(iter(sides.values()))
    budgets, widths = sorted({n for n, _ in first}), sorted({w for _, w in first})
    means = [side[key].mean for side in sides.values() for key in first if key in side]
    low, high = min(means), max(*means, references[OPTIMAL])
    across = max(5.6, 2.2 + 0.78 * len(sides) * len(widths))
    figure, panels = panels_abreast(len(sides), across, 1.8 + 0.6 * len(budgets))
    for axes, (title, cells) in zip(panels, sides.items(), strict=True):
        image = _panel(axes, cells, (budgets, widths), (low, high), optima[title])
        axes.set_title(title, fontsize=11.0, pad=8.0)
    panels[0].set_ylabel("rollouts measured, n")
    legend = "bold: mean return; below: standard error over seeds"
    if budgets[0] == 0:
        legend += " · share of the gap from no data to the optimum"
        others = [number(optima[title]) for title in sides if not math.isclose(optima[title], references[OPTIMAL])]
        legend += f" ({' and '.join(others)} from this study's start states)" * bool(others)
    legend = textwrap.fill(legend, int(14.0 * across))
    figure.supxlabel(f"width w of the training band around the estimate\n{legend}", fontsize=9.0, color="0.15")
    _scale(figure, panels, image, (low, high), references)
    return figure


def _panel(
    axes: Axes, cells: Summaries, grid: tuple[Sequence[int], Sequence[float]], ends: tuple[float, float], optimum: float
) -> Any:
    budgets, widths = grid
    low, high = ends
    values = np.array([[cells[n, w].mean if (n, w) in cells else math.nan for w in widths] for n in budgets])
    image = axes.imshow(values, cmap=COLOUR_MAP, vmin=low, vmax=high, aspect="auto")
    start = cells[0, widths[0]].mean if (0, widths[0]) in cells else math.nan
    for i, n in enumerate(budgets):
        for j, w in enumerate(widths):
            if (n, w) not in cells:
                axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, facecolor="0.93", edgecolor="white"))
                axes.text(j, i, "not run", ha="center", va="center", color="0.55", fontsize=8.0)
                continue
            cell = cells[n, w]
            colour = "0.05" if (cell.mean - low) / (high - low or 1.0) > 0.55 else "white"
            middle = {"ha": "center", "va": "center", "color": colour}
            axes.text(j, i - 0.11, number(cell.mean), fontsize=11.5, weight="bold", **middle)
            error = "" if math.isnan(cell.sem) else f"± {cell.sem:.0f}"
            closed = (cell.mean - start) / (optimum - start)
            share = "" if (i, j) == (0, 0) or math.isnan(closed) else percent(closed)
            axes.text(j, i + 0.24, " · ".join(filter(None, (error, share))), fontsize=7.6, **middle)
    if cells:
        n, w = max((key for key in cells if key[0] in budgets and key[1] in widths), key=lambda key: cells[key].mean)
        corner, line = (widths.index(w) - 0.5, budgets.index(n) - 0.5), {"edgecolor": ACCENT, "linewidth": 2.6}
        axes.add_patch(Rectangle(corner, 1.0, 1.0, fill=False, zorder=3, clip_on=False, **line))
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
    optimum, swing_up, lqr = (references[c] for c in (OPTIMAL, SWING_UP, LQR))
    span = high - low or 1.0
    ticks = [t for t in bar.get_ticks() if low <= t <= high - 0.17 * span and abs(t - lqr) > 0.06 * span]
    bar.set_ticks(ticks, labels=[number(t) for t in ticks])
    bar.ax.tick_params(length=0, labelsize=9.0)
    best, style = (f"{number(optimum)} {NAMES[OPTIMAL]}\n{number(swing_up)} swing-up", {"xycoords": "axes fraction"})
    annotate_beside(bar.ax, best, (1.0, 1.0), (4, 2), va="top", color=ACCENT, **style)
    place = (lqr - low) / span
    shift = (4, -9 if place < 0.0 else 0)
    annotate_beside(bar.ax, f"{number(lqr)} {NAMES[LQR]}", (1.0, max(place, 0.0)), shift, color=ACCENT, **style)


def paretos(sides: Mapping[str, Summaries], references: Mapping[str, float]) -> Figure:
    """The best mean return at every budget of each side, by title, between its extremes and the references.

    Sides after the first show the first one's best in grey.
    """
    figure, panels = panels_abreast(len(sides), 6.8 if len(sides) == 1 else 10.0, 4.3)
    first = next(iter(sides.values()))
    low = min(cell.mean for cells in sides.values() for cell in cells.values())
    for axes, (title, cells) in zip(panels, sides.items(), strict=True):
        if cells is not first:
            best = _best(first)
            axes.plot(list(best), [first[key].mean for key in best.values()], color="0.75", linewidth=1.4, zorder=1)
        _pareto(axes, cells, max(n for n, _ in first), 0.25 * (references[OPTIMAL] - low))
        axes.set_title(title, fontsize=11.0, pad=8.0)
        axes.set_xticks(sorted({n for n, _ in first}))
    reference_lines(panels, references, low)
    panels[0].set_ylabel("best mean return at a budget (± SEM)")
    legend = "w*: the width with the best mean return at that n"
    figure.supxlabel(f"rollouts measured, n\n{legend}", fontsize=9.0, color="0.15")
    figure.draw_without_rendering()
    for axes in panels:
        _keep_apart(axes)
    return figure


def _best(cells: Summaries) -> dict[int, tuple[int, float]]:
    budgets = sorted({n for n, _ in cells})
    return {n: max((key for key in cells if key[0] == n), key=lambda key: cells[key].mean) for n in budgets}


def _pareto(axes: Axes, cells: Summaries, end: int, near: float) -> None:
    """One side; end: the last budget of the axis, near: a distance of two lines within which their names must not stand
    between them."""
    best = _best(cells)
    first, last = min(best), max(best)
    breadth = first, max(w for n, w in cells if n == first)
    fidelity = last, min(w for n, w in cells if n == last)
    without = ("pure breadth" if breadth[1] else "no data") if first == 0 else "least data"
    means, errors = ([getattr(cells[key], name) for key in best.values()] for name in ("mean", "sem"))
    axes.errorbar(list(best), means, errors, color=OURS, marker="o", markersize=6, linewidth=1.8, capsize=3, zorder=3)
    for (n, w), mean, error in zip(best.values(), means, errors, strict=True):
        low, right = 0.0 if math.isnan(error) else error, n == end
        annotate_beside(axes, f"w* = {w:g}", (n, mean - low), (5, -16 if right else -5), va="top", color="0.2",
                        ha="right" if right else "left",
                        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0})  # fmt: skip
    across = axes.get_yaxis_transform()
    apart = cells[fidelity].mean - cells[breadth].mean
    shifts = (-34, 10) if abs(apart) > near else (10, -10) if apart > 0.0 else (-10, 10)
    for (n, w), name, style, shift in (
        (fidelity, "pure fidelity", "--", shifts[0]),
        (breadth, without, ":", shifts[1]),
    ):
        value = cells[n, w].mean
        axes.axhline(value, color="0.35", linestyle=style, linewidth=1.0, zorder=1)
        text = f"{name}, n = {n}, w = {w:g}: {number(value)}"
        annotate_beside(axes, text, (0.98, value), (0, shift), xycoords=across, ha="right", color="0.35")


def reference_lines(panels: Sequence[Axes], references: Mapping[str, float], low: float) -> None:
    """Lines across panels that share their scale, named at the right; what lies below the figure, whose least mean
    return is `low`, stands in words."""
    room, end = 0.14 * (references[OPTIMAL] - low), panels[-1]
    end.set_ylim(low - room, references[OPTIMAL] + room)
    for controller, (style, shift) in LINES.items():
        value = references[controller]
        inside = value > low - room
        for axes in panels if inside else ():
            axes.axhline(value, color=ACCENT, linestyle=style, linewidth=1.1, zorder=1)
        at = 1.0, value if inside else low - 0.9 * room
        text = f"{'' if inside else '↓ '}{NAMES[controller]} {number(value)}"
        annotate_beside(end, text, at, (5, shift), xycoords=end.get_yaxis_transform(), color=ACCENT)


def _keep_apart(axes: Axes) -> None:
    """Move the notes of a drawn panel up or down, by as little as it takes, until none covers another; the first ones
    stay where they are."""
    placed: list[BboxBase] = []
    for note in axes.findobj(Annotation):
        box = note.get_window_extent().padded(0.002 * axes.figure.bbox.width)
        steps = (0.25 * box.height * k for k in sorted(range(-40, 41), key=abs))
        moved = next((s for s in steps if not any(box.translated(0.0, s).overlaps(other) for other in placed)), 0.0)
        note.xyann = note.xyann[0], note.xyann[1] + 72.0 * moved / axes.figure.dpi
        placed.append(box.translated(0.0, moved))


SMOOTH = 10
"""Training episodes averaged into a point of a learning curve."""


def curves(findings: PointFindings) -> Figure:
    """Training returns, in the simulators an agent trains on, averaged over seeds and a few episodes."""
    budgets, widths = findings.point.budgets, findings.point.widths
    figure, panels = panels_abreast(len(budgets), 1.2 + 2.0 * len(budgets), 2.9)
    for axes, n in zip(panels, budgets, strict=True):
        for w, colour in zip(widths, shades(len(widths)), strict=True):
            table = [run.curve for run in findings.cells[n, w] if run.curve]
            episodes = min((len(curve) for curve in table), default=0)
            size = min(SMOOTH, max(1, episodes))
            usable = episodes - episodes % size
            if not usable:
                continue
            steps = np.array([step for step, _ in table[0][:usable]]).reshape(-1, size)[:, -1]
            returns = np.array([[value for _, value in curve[:usable]] for curve in table])
            smooth = returns.reshape(len(table), -1, size).mean((0, 2))
            axes.plot(steps / 1000.0, smooth, color=colour, label=findings.label(w))
        axes.set_title(f"n = {n}", fontweight="normal", loc="center", pad=4)
    panels[0].set_ylabel("return in the simulator\nit is trained in", fontsize=10.0)
    labelled = [axes for axes in panels if axes.lines]
    if labelled:
        labelled[-1].legend(fontsize=8.0, loc="lower right")
    lacking = sum(not run.curve for run in findings.runs)
    if lacking:
        figure.suptitle(f"{lacking} of {len(findings.runs)} runs were imported without learning curves", fontsize=9.0)
    figure.supxlabel("environment steps [thousands]", fontsize=10.0)
    return figure


def drawings(findings: PointFindings) -> dict[str, Callable[[], Figure]]:
    """What draws the figures that say something: of a choice where there is one, and of curves that are known."""
    cells, figures = findings.summaries, dict[str, Callable[[], Figure]]()
    name = "Mean return on the hidden plant"
    if len(cells) > 1:
        figures["heatmap"] = lambda: heatmaps({name: cells}, findings.figure_references, {name: findings.optimum})
    if len(findings.point.budgets) > 1:
        figures["pareto"] = lambda: paretos({"What the next rollout is worth": cells}, findings.figure_references)
    if any(run.curve for run in findings.runs):
        figures["curves"] = lambda: curves(findings)
    return figures


def contrasts(rows: Sequence[ContrastAgreement]) -> Figure:
    """Every published contrast: bootstrap intervals as bars, t intervals as thin lines, there (grey) and here."""
    figure = Figure(figsize=(8.4, 1.2 + 0.36 * len(rows)), layout="constrained")
    axes = figure.add_subplot()
    for k, row in enumerate(rows):
        _interval(axes, row.theirs, row.theirs_t, k - 0.16, "0.45", "published")
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
IDENTIFIER_LOOKS = {"grid": ("0.4", "s"), "least_squares": (COLOUR_MAP(0.3), "o"), "unscented": (COLOUR_MAP(0.68), "^")}
"""Colour and marker of an identifier."""


def identification(scatter: Scatter) -> Figure:
    """Left: the mean error of theta_hat over n, with the published points. Right: m of single measurements."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    budgets = np.array(scatter.budgets, dtype=float)
    left.axvspan(5.0, 50.0, color="0.95", zorder=0)
    across = left.get_xaxis_transform()
    annotate_beside(left, "the paper's budgets", (np.sqrt(250.0), 0.02), (0, 3), va="baseline", ha="center",
                    color="0.45", fontsize=8.5, xycoords=across)  # fmt: skip
    for k, (sigma, colour) in enumerate(zip(scatter.sigmas, shades(len(scatter.sigmas), 0.12, 0.8), strict=True)):
        errors = scatter.errors(sigma)
        mean = errors.mean(axis=1)
        left.errorbar(budgets, mean, 1.96 * errors.std(axis=1, ddof=1) / np.sqrt(scatter.seeds), color=colour,
                      marker="o", markersize=4, linewidth=1.7, capsize=2, zorder=3)  # fmt: skip
        annotate_beside(left, f"σ = {sigma:g}", (budgets[-1], mean[-1]), (6, 0), color=colour)  # noqa: RUF001
        printed = {n: e for n, e in ID_ERRORS.get(POINT_OF_NOISE.get(sigma, ""), {}).items() if n}
        left.plot(list(printed), list(printed.values()), color=colour, marker="x", markersize=7, linestyle="none",
                  markeredgewidth=1.8, label="published" if k == 0 else None, zorder=4)  # fmt: skip
    guide = scatter.errors(1.0).mean(axis=1)[-1] * np.sqrt(budgets[-1] / budgets)
    left.plot(budgets, guide, color=ACCENT, linewidth=1.0, linestyle="--", zorder=1, label="1/√n")
    left.axhspan(nearest_cell(scatter.truth), CELL, color=ACCENT, alpha=0.12, linewidth=0.0, label="cells of the grid")
    _log_axis(left, scatter.budgets)
    left.set_yscale("log")
    left.set_ylim(0.015, 3.0)
    left.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0], ["0.02", "0.05", "0.1", "0.2", "0.5", "1", "2"])
    left.yaxis.set_minor_locator(NullLocator())
    left.set_ylabel("mean identification error")
    left.set_title("The error over the budget")
    left.legend(fontsize=8.5, loc="lower left", bbox_to_anchor=(0.0, 0.2))
    _masses(right, scatter)
    return figure


def _masses(axes: Axes, scatter: Scatter) -> None:
    edges = np.arange(0.3 - 1.5 * CELL, 3.0 + 3.0 * CELL, 3.0 * CELL)
    looks = ((False, COLOUR_MAP(0.35), 0.85, "noise in inputs too"), (True, "0.2", 1.0, "as much, in outputs alone"))
    for clean, colour, alpha, label in looks:
        m = scatter.thetas(1.0, 50, clean=clean)[:, 0]
        axes.stairs(*np.histogram(m, edges), fill=not clean, color=colour, alpha=alpha, label=label, linewidth=1.3)
    axes.axvline(scatter.truth[0], color=ACCENT, linewidth=1.4)
    across = axes.get_xaxis_transform()
    annotate_beside(axes, "the truth", (scatter.truth[0], 1.0), (4, -2), xycoords=across, va="top", color=ACCENT)
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
