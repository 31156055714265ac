"""Return over what was spent: real rollouts, a row a group of strategies, and simulated steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from study.figure_style import ACCENT, annotate_beside, faint_lines, panel_title, panels_abreast
from study.formatting import number
from study.strategies.catalogue import strategy_class
from study.strategies.strategies_findings import StrategiesFindings
from study.strategies.strategies_plan import BASELINE
from study.strategies.trial_findings import Outcome
from study.trials.hidden_plant import HiddenPlant

GROUPS = {
    "identified": "identified",
    "adapted": "adapted distributions",
    "compared": "compared returns",
    "plant": "learned on the plant",
}
"""A row of panels each; those that spend nothing are in all of them."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7F3C8D", "#222222")
"""Of the strategies of a group (Okabe and Ito)."""

MARKS = "osD^vPXp"

LOWEST = 3.0
"""What returns less than so many times the optimum is an arrow at the edge of its panel."""

ENOUGH = 3
"""Seeds from which an interval is drawn."""

SENSED = {"encoder": "angle and speed read", "speed": "speed read"}

Look = dict[str, Any]


def returns_of_strategies(findings: StrategiesFindings) -> Figure:
    """Mean returns with 95 % intervals over seeds: over the real rollouts where there are several budgets, and a row a
    strategy where there is one. Hollow: the best candidate so far, evaluated anew."""
    return _lines(findings) if sum(n > 0 for n in findings.plan.budgets) > 1 else _rows(findings)


def _rows(findings: StrategiesFindings) -> Figure:
    """The largest budget of each strategy, groups below each other; grey lines continue the point estimate."""
    plan = findings.plan
    groups = {g: [s for s in plan.strategies if strategy_class(s).group == g] for g in ("nothing", *GROUPS)}
    shown = [s for own in groups.values() for s in own]
    places = len(plan.places)
    figure, panels = panels_abreast(places, 2.6 + 3.4 * places, 1.6 + 0.27 * len(shown))
    for (plant, sensing), axes in zip(plan.places, panels, strict=True):
        optimum = findings.optimum(plant.name)
        lines = {s: line for s in shown if (line := findings.line(plant.name, sensing, s))}
        last = {s: line[max(line)] for s, line in lines.items()}
        axes.set_xlim(*_limits(optimum, list(last.values())))
        axes.axvline(optimum, color=ACCENT, linewidth=1.1, zorder=1)
        annotate_beside(axes, number(optimum), (optimum, 1.0), (0, 6), color=ACCENT, fontsize=8.0, ha="center",
               xycoords=axes.get_xaxis_transform())  # fmt: skip
        if BASELINE in last:
            axes.axvline(last[BASELINE].mean.mean, color="0.7", linewidth=1.0, linestyle="--", zorder=1)
        for group, ink in zip(groups, ("0.5", *COLOURS), strict=False):
            for strategy in groups[group]:
                if strategy in last:
                    _row(axes, shown.index(strategy), last[strategy], ink)
        faint_lines(axes, "x")
        panel_title(axes, plant.title, SENSED[sensing], fontsize=10.0)
        axes.set_xlabel("return")
        axes.locator_params(axis="x", nbins=5)
    panels[0].set_ylim(len(shown) - 0.4, -0.6)
    panels[0].set_yticks(range(len(shown)), [strategy_class(s).short for s in shown])
    return figure


def _row(axes: Axes, at: int, outcome: Outcome, ink: str) -> None:
    """A mean with its interval, its seeds where they are too few for one, and its best candidate."""
    low, mean = axes.get_xlim()[0], outcome.mean
    if mean.mean < low:
        axes.plot([low], [at], color=ink, marker="<", markersize=6.0, clip_on=False, zorder=4)
        annotate_beside(axes, number(mean.mean), (low, at), (8, 0), color=ink, fontsize=8.0)
        return
    if len(outcome.seeds) >= ENOUGH:
        axes.plot([max(low, mean.low), mean.high], [at, at], color=ink, linewidth=1.6, alpha=0.6, zorder=3)
    look: Look = {"color": ink, "marker": "o", "markersize": 5.5, "zorder": 4}
    axes.plot([mean.mean], [at], **look)
    if np.isfinite(outcome.anew):
        axes.plot([max(low, outcome.anew)], [at], **{**look, "markerfacecolor": "white"})


def _limits(optimum: float, outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """From a little below the least that is shown, but not below LOWEST optima, to a little above the optimum."""
    least = min([optimum, *(min(o.mean.mean, o.mean.low if np.isfinite(o.mean.low) else 0.0) for o in outcomes)])
    room = 0.06 * abs(max(least, LOWEST * optimum) - optimum) + 0.02 * abs(optimum)
    return max(least - room, LOWEST * optimum), optimum + room


def _lines(findings: StrategiesFindings) -> Figure:
    """A row of panels a group; grey: the point estimate and what spends nothing."""
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
    _frame(axes, findings, place)
    budgets = findings.plan.budgets
    for strategy in findings.plan.strategies:
        context = strategy == BASELINE or strategy_class(strategy).group == "nothing"
        if strategy in own or context:
            line = findings.line(place[0].name, place[1], strategy)
            points = [(float(budgets.index(n)), outcome) for n, outcome in line.items()]
            _line(axes, points, _look(own.index(strategy)) if strategy in own else _context(strategy))


def _frame(axes: Axes, findings: StrategiesFindings, place: tuple[HiddenPlant, str]) -> None:
    """The optimum, and room for every mean of the place, so that panels of a place agree."""
    optimum = findings.optimum(place[0].name)
    own = [o for c, o in findings.outcomes.items() if (c.plant, c.sensing) == (place[0].name, place[1])]
    axes.set_ylim(*_limits(optimum, own))
    axes.axhline(optimum, color=ACCENT, linewidth=1.1, zorder=1)
    annotate_beside(axes, number(optimum), (0.0, optimum), (3, 5), color=ACCENT, fontsize=8.0,
           xycoords=axes.get_yaxis_transform())  # fmt: skip
    faint_lines(axes, "y")


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
    figure, panels = panels_abreast(len(plan.places), 3.4 + 3.0 * len(plan.places), 4.4, one_scale=False)
    looks = {
        strategy: {"color": ink, "marker": MARKS[k % len(MARKS)], "markersize": 6.0, "linestyle": "none"}
        for group, ink in zip(("nothing", *GROUPS), ("0.5", *COLOURS), strict=False)
        for k, strategy in enumerate(s for s in plan.strategies if strategy_class(s).group == group)
    }
    for (plant, sensing), axes in zip(plan.places, panels, strict=True):
        axes.set_xscale("log")
        _frame(axes, findings, (plant, sensing))
        panel_title(axes, plant.title, SENSED[sensing], fontsize=10.0)
        for strategy, look in looks.items():
            _dot(axes, findings.line(plant.name, sensing, strategy), max(plan.contrasted), look)
        _whole_decades(axes)
        axes.set_xlabel("simulated steps")
    panels[0].set_ylabel("return")
    handles = [Line2D([], [], label=strategy_class(strategy).short, **look) for strategy, look in looks.items()]
    _beside_panels(figure, _at_right(panels[-1], handles))
    return figure


def _whole_decades(axes: Axes) -> None:
    """Powers of ten at both ends: a shorter logarithmic axis has no tick, or too many."""
    low, high = np.log10(axes.get_xlim())
    axes.set_xlim(10.0 ** np.floor(low), 10.0 ** np.ceil(high))


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
