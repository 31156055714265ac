"""Return over what was spent: real rollouts above, simulated steps below, a panel a plant, a line a strategy."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from study.figure_style import ACCENT, beside, panel_title
from study.formatting import number
from study.strategies.catalogue import strategy_class
from study.strategies.findings import Outcome, StrategiesFindings

INKS = {"nothing": "0.45", "identified": "#0072B2", "adapted": "#D55E00", "compared": "#009E73", "plant": "#CC79A7"}
"""Of the groups of strategies (Okabe and Ito)."""

MARKS = "osD^vPX<>*"
"""Of the strategies within a group."""

LOWEST = 2.2
"""What returns less than so many times the optimum is an arrow at the lower edge."""

SENSED = {"encoder": "angle and speed read", "speed": "speed read"}


def strategy_lines(findings: StrategiesFindings) -> Figure:
    """Mean returns with 95 % intervals over seeds; hollow: the best candidate so far, evaluated anew."""
    places = findings.plan.places
    figure = Figure(figsize=(2.6 + 3.6 * len(places), 8.2), layout="constrained")
    rows = figure.subplots(2, len(places), squeeze=False, sharey="col")
    looks = _looks(findings.plan.strategies)
    for (plant, sensing), upper, lower in zip(places, *rows, strict=True):
        optimum = findings.optimum(plant.name)
        upper.set_ylim(LOWEST * optimum, optimum + 0.06 * abs(optimum))
        panel_title(upper, plant.title, SENSED[sensing], fontsize=10.0)
        shown = sorted({0, *findings.plan.budgets})
        for k, (strategy, (ink, mark)) in enumerate(looks.items()):
            aside = 0.5 * (k / max(1, len(looks) - 1) - 0.5)
            line = findings.line(plant.name, sensing, strategy)
            style = {"color": ink, "marker": mark, "markersize": 5.0}
            _line(upper, [(shown.index(n) + aside, o) for n, o in line.items()], style, bars=True)
            _line(lower, [(float(np.mean(o.simulated)), o) for o in line.values()], style, bars=False)
        upper.set_xticks(range(len(shown)), [str(n) for n in shown])
        lower.set_xscale("log")
        for axes in (upper, lower):
            axes.axhline(optimum, color=ACCENT, linewidth=1.1, zorder=1)
            axes.grid(axis="y", color="0.93", linewidth=0.8)
            axes.set_axisbelow(True)
        beside(upper, f"optimum {number(optimum)}", (1.0, optimum), (-4, 6), ha="right", color=ACCENT, fontsize=8.5,
               xycoords=upper.get_yaxis_transform())  # fmt: skip
        upper.set_xlabel("real rollouts")
        lower.set_xlabel("simulated steps")
    for axes in rows[:, 0]:
        axes.set_ylabel("return on the hidden plant")
    _key(figure, looks)
    return figure


def _looks(strategies: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Colour and mark of each."""
    count: dict[str, int] = {}
    found = {}
    for strategy in strategies:
        group = strategy_class(strategy).group
        k = count[group] = count.get(group, -1) + 1
        found[strategy] = INKS[group], MARKS[k % len(MARKS)]
    return found


def _line(axes: Axes, points: list[tuple[float, Outcome]], style: dict[str, object], bars: bool) -> None:
    """A strategy's means, and those of its best candidates; arrows for what is below the panel."""
    if not points:
        return
    low, _ = axes.get_ylim()
    x, means = np.array([at for at, _ in points]), [o.mean for _, o in points]
    y = np.array([mean.mean for mean in means])
    inside = y > low
    axes.plot(x, y, linewidth=1.4, alpha=0.9, zorder=3, clip_on=True, **style)
    if bars:
        for at, mean in zip(x, means, strict=True):
            if np.isfinite(mean.low):
                axes.plot([at, at], [mean.low, mean.high], color=style["color"], linewidth=1.0, alpha=0.5, zorder=2)
    axes.plot(x[~inside], np.full(np.sum(~inside), low), color=style["color"], marker="v", linestyle="none",
              markersize=6.0, clip_on=False, zorder=4)  # fmt: skip
    anew = np.array([o.anew for _, o in points])
    axes.plot(x, anew, linewidth=1.0, linestyle=":", zorder=3, **{**style, "markerfacecolor": "white"})


def _key(figure: Figure, looks: dict[str, tuple[str, str]]) -> None:
    handles = [
        Line2D([], [], color=ink, marker=mark, markersize=5.0, linewidth=1.4, label=strategy_class(strategy).short)
        for strategy, (ink, mark) in looks.items()
    ]
    handles.append(Line2D([], [], color="0.3", marker="o", markerfacecolor="white", linestyle=":", markersize=5.0,
                          label="its best candidate, anew"))  # fmt: skip
    handles.append(Line2D([], [], color="0.3", marker="v", linestyle="none", label="below the panel"))
    handles.append(Line2D([], [], color=ACCENT, linewidth=1.1, label="optimum (dynamic programming)"))
    figure.legend(handles=handles, loc="outside right center", fontsize=8.5)
