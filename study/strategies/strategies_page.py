"""The strategies experiment, told: figures and page.

Mean returns of the strategies, a panel a plant: over the rollouts, or below each other with one budget.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from study.figure_style import ACCENT, annotate_beside, faint_lines, panel_title
from study.formatting import number
from study.pipeline.publication import Account
from study.strategies.catalogue import strategy_class
from study.strategies.strategies_findings import StrategiesFindings, strategies_findings, strategies_sentences
from study.strategies.strategies_plan import BASELINE, StrategiesPlan
from study.strategies.trial_figures import ENOUGH, LOWEST, SENSED, returns_in_rows
from study.strategies.trial_findings import Outcome, TrialResults, trial_account

GROUPS = {
    "nothing": "no rollouts",
    "identified": "identified",
    "adapted": "adapted distributions",
    "compared": "compared returns",
    "plant": "learned on the plant",
}
"""Groups of strategies, in the order of their rows."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#7F3C8D", "#222222")
"""Okabe and Ito's."""
INKS = dict(zip(GROUPS, ("0.5", *COLOURS), strict=False))
"""Of the groups, where these stand in one panel."""
LOOKS = [{"color": colour, "marker": mark} for colour, mark in zip(COLOURS, "osD^vPXp", strict=True)]
"""Of the lines of a group."""


def returns_of_strategies(findings: StrategiesFindings) -> Figure:
    """Mean returns with 95 % intervals over seeds: lines over the rollouts where there are several budgets, and else a
    row a strategy. Hollow: the best candidate so far, evaluated anew."""
    several = len({condition.n for condition in findings.outcomes} - {0}) > 1
    return (_lines if several else _rows)(findings)


def _lines(findings: StrategiesFindings) -> Figure:
    """A row of panels a group, with its names at the right; grey: the point estimate and what spends nothing."""
    plan, places = findings.plan, len(findings.plan.places)
    groups = {g: [s for s in plan.strategies if strategy_class(s).group == g] for g in GROUPS}
    context = [s for s in plan.strategies if s == BASELINE or s in groups["nothing"]]
    grey = {s: {"color": "0.6", "marker": "o" if s == BASELINE else "x+"[k % 2]} for k, s in enumerate(context)}
    spending = {group: own for group, own in groups.items() if own and group != "nothing"}
    figure = Figure(figsize=(3.4 + 3.0 * places, 1.0 + 2.5 * len(spending)), layout="constrained")
    rows = figure.subplots(len(spending), places + 1, squeeze=False, sharex="col", sharey="col",
                           width_ratios=[3.0] * places + [2.0])  # fmt: skip
    for (group, own), (*panels, key) in zip(spending.items(), rows, strict=True):
        looks = grey | dict(zip(own, cycle(LOOKS), strict=False))
        for (plant, sensing), axes in zip(plan.places, panels, strict=True):
            optimum = findings.optimum(plant.name)
            here = [o for c, o in findings.outcomes.items() if c[:2] == (plant.name, sensing)]
            axes.set_ylim(*_limits(optimum, here))
            axes.axhline(optimum, color=ACCENT, linewidth=1.1, zorder=1)
            annotate_beside(axes, number(optimum), (0.0, optimum), (3, 5), color=ACCENT, fontsize=8.0,
                            xycoords=axes.get_yaxis_transform())  # fmt: skip
            for strategy, look in looks.items():
                _line(axes, plan.budgets, findings.line(plant.name, sensing, strategy), look)
            faint_lines(axes, "y")
        panels[0].set_ylabel(f"{GROUPS[group]}\nreturn")
        for strategy, look in sorted(looks.items(), key=lambda item: item[0] not in own):
            key.plot([], [], label=strategy_class(strategy).short, linewidth=1.4, markersize=4.5, **look)
        key.legend(loc="center left", fontsize=8.5)
        key.set_axis_off()
    for (plant, sensing), top, bottom in zip(plan.places, rows[0], rows[-1], strict=False):
        panel_title(top, plant.title, SENSED[sensing], fontsize=10.0)
        bottom.set_xticks(range(len(plan.budgets)), [str(n) for n in plan.budgets])
        bottom.set_xlabel("real rollouts")
    return figure


def _line(axes: Axes, budgets: Sequence[int], line: Mapping[int, Outcome], look: Mapping[str, Any]) -> None:
    """A strategy's means, and those of its best candidates; arrows for what is below the panel."""
    low, x = axes.get_ylim()[0], [budgets.index(n) for n in line]
    means = [outcome.mean for outcome in line.values()]
    axes.plot(x, [mean.mean for mean in means], linewidth=1.4, markersize=4.5, **look)
    axes.plot(x, [o.anew for o in line.values()], linewidth=1.0, linestyle=":", markersize=4.5,
              **{**look, "markerfacecolor": "white"})  # fmt: skip
    for at, outcome in zip(x, line.values(), strict=True):
        if outcome.mean.mean < low:
            axes.plot([at], [low], markersize=4.5, clip_on=False, **{**look, "marker": "v"})
        elif len(outcome.seeds) >= ENOUGH:
            axes.plot([at, at], [outcome.mean.low, outcome.mean.high], color=look["color"], linewidth=1.0, alpha=0.6)


def _rows(findings: StrategiesFindings) -> Figure:
    """With a grey line that continues the point estimate."""
    figure = returns_in_rows(findings, strategy_class, INKS)
    for axes, (plant, sensing) in zip(figure.axes, findings.plan.places, strict=True):
        for outcome in findings.line(plant.name, sensing, BASELINE).values():
            axes.axvline(outcome.mean.mean, color="0.7", linewidth=1.0, linestyle="--", zorder=1)
    return figure


def _limits(optimum: float, outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """From a little below the least that is shown, but not below LOWEST optima, to a little above the optimum."""
    least = min([optimum, *(min(o.mean.mean, o.mean.low if np.isfinite(o.mean.low) else 0.0) for o in outcomes)])
    room = 0.06 * abs(max(least, LOWEST * optimum) - optimum) + 0.02 * abs(optimum)
    return max(least - room, LOWEST * optimum), optimum + room


CAPTION = (
    "Mean return for the real rollouts that were spent, strategies of a group together, with its 95 % interval where "
    "there are three seeds. Hollow: of strategies that compare returns, their best candidate so far, evaluated anew "
    "outside the budget. Grey: the point estimate and what spends nothing. Red: the optimum. Arrows are outside the "
    "panel."
)


def account(plan: StrategiesPlan, results: TrialResults) -> Account:
    """What is told of the results."""
    found = strategies_findings(plan, results)
    return trial_account(
        found,
        strategies_sentences(found),
        (partial(returns_of_strategies, found), CAPTION),
        "strategies.html.j2",
        {"strategies": {name: strategy_class(name) for name in plan.strategies}},
    )
