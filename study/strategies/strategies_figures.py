"""Mean returns of the strategies beside each other, a panel a plant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from study.figure_style import ACCENT, annotate_beside, faint_lines, panel_title, panels_abreast
from study.formatting import number
from study.strategies.catalogue import strategy_class
from study.strategies.strategies_findings import StrategiesFindings
from study.strategies.strategies_plan import BASELINE
from study.strategies.trial_findings import Outcome

GROUPS = {"nothing": "0.5", "identified": "#0072B2", "adapted": "#D55E00", "compared": "#009E73", "plant": "#CC79A7"}
"""Groups of strategies and their colours (Okabe and Ito), in the order of their rows."""

LOWEST = 3.0
"""What returns less than so many times the optimum is an arrow at the edge of its panel."""

ENOUGH = 3
"""Seeds from which an interval is drawn."""

SENSED = {"encoder": "angle and speed read", "speed": "speed read"}


def returns_of_strategies(findings: StrategiesFindings) -> Figure:
    """Mean returns with 95 % intervals over seeds, a row a strategy, each with the most rollouts that it was given.

    Groups stand below each other. Hollow: the best candidate so far, evaluated anew. The grey line continues the point
    estimate.
    """
    plan = findings.plan
    shown = [s for group in GROUPS for s in plan.strategies if strategy_class(s).group == group]
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
        for at, strategy in enumerate(shown):
            if strategy in last:
                _row(axes, at, last[strategy], GROUPS[strategy_class(strategy).group])
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
    axes.plot([mean.mean], [at], color=ink, marker="o", markersize=5.5, zorder=4)
    if np.isfinite(outcome.anew):
        axes.plot(
            [max(low, outcome.anew)], [at], color=ink, marker="o", markersize=5.5, zorder=4, markerfacecolor="white"
        )


def _limits(optimum: float, outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """From a little below the least that is shown, but not below LOWEST optima, to a little above the optimum."""
    least = min([optimum, *(min(o.mean.mean, o.mean.low if np.isfinite(o.mean.low) else 0.0) for o in outcomes)])
    room = 0.06 * abs(max(least, LOWEST * optimum) - optimum) + 0.02 * abs(optimum)
    return max(least - room, LOWEST * optimum), optimum + room
