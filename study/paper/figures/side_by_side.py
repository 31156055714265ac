"""The published study and this one: their sweeps, and every contrast there and here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from study.figure_style import ACCENT
from study.formatting import number
from study.paper.agreement import ContrastAgreement
from study.paper.figures.sweeps import OURS
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
    layers = " × ".join(map(str, hidden))  # noqa: RUF001
    return "Published (256 × 256 networks, 10 seeds)", f"Here ({layers} networks, {seeds} seed{'s' * (seeds != 1)})"  # noqa: RUF001
