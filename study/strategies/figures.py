"""Return over what was spent: real rollouts, a row a group of strategies, and simulated steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from study.figure_style import ACCENT, beside, panel_title
from study.formatting import number
from study.mismatch.plan import HiddenPlant
from study.strategies.catalogue import strategy_class
from study.strategies.findings import Outcome, StrategiesFindings
from study.strategies.plan import BASELINE

GROUPS = {
    "identified": "identified",
    "adapted": "adapted distributions",
    "compared": "compared returns",
    "plant": "learned on the plant",
}
"""A row of panels each; those that spend nothing are in all of them."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7F3C8D")
"""Of the strategies of a group (Okabe and Ito)."""

MARKS = "osD^vPX"

LOWEST = 3.0
"""What returns less than so many times the optimum is an arrow at the lower edge."""

ENOUGH = 3
"""Seeds from which an interval is drawn."""

SENSED = {"encoder": "angle and speed read", "speed": "speed read"}

Look = dict[str, Any]


def strategy_lines(findings: StrategiesFindings) -> Figure:
    """Mean returns over real rollouts, with 95 % intervals over seeds; hollow: the best candidate so far, evaluated
    anew; grey: the point estimate and what spends nothing."""
    plan = findings.plan
    groups = [group for group in GROUPS if any(strategy_class(s).group == group for s in plan.strategies)]
    figure = Figure(figsize=(3.4 + 3.0 * len(plan.places), 1.0 + 2.5 * len(groups)), layout="constrained")
    rows = figure.subplots(len(groups), len(plan.places), squeeze=False, sharex=True, sharey="col")
    for group, panels in zip(groups, rows, strict=True):
        own = [s for s in plan.strategies if strategy_class(s).group == group]
        for place, axes in zip(plan.places, panels, strict=True):
            _panel(axes, findings, place, own)
        panels[0].set_ylabel(f"{GROUPS[group]}\nreturn")
        _beside_panels(figure, _legend(panels[-1], own))
    for (plant, sensing), top, bottom in zip(plan.places, rows[0], rows[-1], strict=True):
        panel_title(top, plant.title, SENSED[sensing], fontsize=10.0)
        bottom.set_xticks(range(len(plan.budgets)), [str(n) for n in plan.budgets])
        bottom.set_xlabel("real rollouts")
    return figure


def _panel(axes: Axes, findings: StrategiesFindings, place: tuple[HiddenPlant, str], own: Sequence[str]) -> None:
    _frame(axes, findings.optimum(place[0].name))
    budgets = findings.plan.budgets
    for strategy in findings.plan.strategies:
        context = strategy == BASELINE or strategy_class(strategy).group == "nothing"
        if strategy in own or context:
            line = findings.line(place[0].name, place[1], strategy)
            points = [(float(budgets.index(n)), outcome) for n, outcome in line.items()]
            _line(axes, points, _look(own.index(strategy)) if strategy in own else _context(strategy))


def _frame(axes: Axes, optimum: float) -> None:
    axes.set_ylim(LOWEST * optimum, optimum + 0.08 * abs(optimum))
    axes.axhline(optimum, color=ACCENT, linewidth=1.1, zorder=1)
    beside(axes, number(optimum), (0.0, optimum), (3, 5), color=ACCENT, fontsize=8.0,
           xycoords=axes.get_yaxis_transform())  # fmt: skip
    axes.grid(axis="y", color="0.93", linewidth=0.8)
    axes.set_axisbelow(True)


def _look(k: int) -> Look:
    return {"color": COLOURS[k % len(COLOURS)], "marker": MARKS[k % len(MARKS)], "markersize": 4.5, "zorder": 4}


def _context(strategy: str) -> Look:
    mark = {BASELINE: "o", "prior": "x"}.get(strategy, "+")
    return {"color": "0.6", "marker": mark, "markersize": 4.5, "zorder": 2}


def _line(axes: Axes, points: Sequence[tuple[float, Outcome]], look: Look) -> None:
    """A strategy's means, and those of its best candidates; arrows for what is below the panel."""
    if not points:
        return
    low = axes.get_ylim()[0]
    x, y = np.array([at for at, _ in points]), np.array([o.mean.mean for _, o in points])
    axes.plot(x, y, linewidth=1.4, **look)
    if np.any(y < low):
        arrows = {**look, "marker": "v", "linestyle": "none"}
        axes.plot(x[y < low], np.full(np.sum(y < low), low), clip_on=False, **arrows)
    for at, outcome in points:
        if len(outcome.seeds) >= ENOUGH:
            ends = [outcome.mean.low, outcome.mean.high]
            axes.plot([at, at], ends, color=look["color"], linewidth=1.0, alpha=0.6, zorder=look["zorder"])
    anew = np.array([o.anew for _, o in points])
    if np.isfinite(anew).any():
        axes.plot(x, anew, linewidth=1.0, linestyle=":", **{**look, "markerfacecolor": "white"})


def _legend(axes: Axes, own: Sequence[str]) -> Any:
    """Names of the group's strategies, and what is grey."""
    named = {strategy_class(s).short: _look(k) for k, s in enumerate(own)}
    if BASELINE not in own:
        named[strategy_class(BASELINE).short] = _context(BASELINE)
    named |= {strategy_class(s).short: _context(s) for s in ("prior", "prior_range")}
    handles = [Line2D([], [], linewidth=1.4, label=name, **look) for name, look in named.items()]
    if any(strategy_class(s).group == "compared" for s in own):
        handles.append(Line2D([], [], color="0.3", marker="o", markerfacecolor="white", linestyle=":", markersize=4.5,
                              label="best candidate, anew"))  # fmt: skip
    return _at_right(axes, handles)


def _at_right(axes: Axes, handles: Sequence[Line2D]) -> Any:
    return axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.03, 0.5), fontsize=8.5)


def simulated_steps(findings: StrategiesFindings) -> Figure:
    """Mean return over the steps that were simulated for it, with the largest budget of the contrasts or the largest
    below that; what simulates nothing is left out."""
    plan = findings.plan
    figure = Figure(figsize=(3.4 + 3.0 * len(plan.places), 4.4), layout="constrained")
    panels: list[Axes] = list(figure.subplots(1, len(plan.places), squeeze=False)[0])
    looks = {
        strategy: {"color": ink, "marker": MARKS[k % len(MARKS)], "markersize": 6.0, "linestyle": "none"}
        for group, ink in zip(("nothing", *GROUPS), ("0.5", *COLOURS), strict=False)
        for k, strategy in enumerate(s for s in plan.strategies if strategy_class(s).group == group)
    }
    for (plant, sensing), axes in zip(plan.places, panels, strict=True):
        axes.set_xscale("log")
        _frame(axes, findings.optimum(plant.name))
        panel_title(axes, plant.title, SENSED[sensing], fontsize=10.0)
        for strategy, look in looks.items():
            _dot(axes, findings.line(plant.name, sensing, strategy), max(plan.contrasted), look)
        axes.margins(x=0.15)
        axes.set_xlabel("simulated steps")
    panels[0].set_ylabel("return")
    handles = [Line2D([], [], label=strategy_class(strategy).short, **look) for strategy, look in looks.items()]
    _beside_panels(figure, _at_right(panels[-1], handles))
    return figure


def _dot(axes: Axes, line: dict[int, Outcome], most: int, look: Look) -> None:
    within = [n for n in line if n <= most]
    if within and (steps := float(np.mean(line[max(within)].simulated))) > 0.0:
        value, low = line[max(within)].mean.mean, axes.get_ylim()[0]
        axes.plot([steps], [max(value, low)], clip_on=False, alpha=0.85, **look)


def _beside_panels(figure: Figure, *legends: Any) -> None:
    """Room at the right for legends, which the layout would take from the last panels."""
    for legend in legends:
        legend.set_in_layout(False)
    figure.get_layout_engine().set(rect=(0.0, 0.0, 1.0 - 2.0 / figure.get_figwidth(), 1.0))
