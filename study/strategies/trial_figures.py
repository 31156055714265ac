"""Mean returns in rows: a row a strategy, and a panel a hidden plant."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from study.figure_style import ACCENT, annotate_beside, faint_lines, panel_title, panels_abreast
from study.formatting import number
from study.strategies.trial_findings import Outcome, TrialFindings

LOWEST = 3.0
"""What returns less than so many times the optimum is outside its panel."""

INTERVAL_SEEDS = 3
"""Seeds from which an interval is drawn."""

SENSED = {"encoder": "angle and speed read", "speed": "speed read"}


def returns_in_rows(findings: TrialFindings, describe: Callable[[str], Any], inks: Mapping[str, str]) -> Figure:
    """Mean returns with 95 % intervals over seeds, all panels to one scale but each about its own optimum (red line);
    few rollouts hollow and many filled; small upright ticks are medians.

    describe: of each strategy its `short` words, and its `group`, which has an ink and stands together
    """
    plan = findings.plan
    places, y = dict[str, float](), 0.0
    for group in inks:
        members = [strategy for strategy in plan.strategies if describe(strategy).group == group]
        places |= {strategy: y + k for k, strategy in enumerate(members)}
        y += len(members) + 0.6 * bool(members)
    count, bottom = len(plan.places), max(places.values())
    figure, panels = panels_abreast(count, min(12.0, 2.6 + 3.4 * count), 1.9 + 0.34 * bottom)
    reach = _reach(findings, describe)
    for axes, (plant, sensing) in zip(panels, plan.places, strict=True):
        optimum = findings.optimum(plant.name)
        here = {c: o for c, o in findings.outcomes.items() if c[:2] == (plant.name, sensing)}
        best = max(optimum, *(o.mean.mean for o in here.values()))
        axes.set_xlim(best - 1.12 * reach, best + 0.12 * reach)
        axes.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
        for strategy, place in places.items():
            ink, outcomes = inks[describe(strategy).group], [here[c] for c in sorted(here) if c.strategy == strategy]
            for k, outcome in enumerate(outcomes):
                shift = 0.34 * (k - 0.5 * (len(outcomes) - 1)) / max(1, len(outcomes) - 1)
                _draw(axes, outcome, place + shift, ink, last=k == len(outcomes) - 1)
        axes.axvline(optimum, color=ACCENT, linewidth=1.2, zorder=1)
        about = SENSED[sensing] * (len(plan.sensings) > 1), "not in the catalogue" * (plant.in_catalogue is False)
        panel_title(axes, plant.noun, plant.size, *about, fontsize=9.5)
        axes.tick_params(axis="y", length=0)
        faint_lines(axes, "x")
    panels[0].set_yticks(list(places.values()), [describe(strategy).short for strategy in places])
    for label, strategy in zip(panels[0].get_yticklabels(), places, strict=True):
        label.set_color(inks[describe(strategy).group])
    panels[0].set_ylim(bottom + 0.7, -0.7)
    figure.supxlabel("return on the hidden plant: mean and 95 % interval over seeds", fontsize=10.0)
    _key(figure, sorted({condition.n for condition in findings.outcomes} - {0}))
    return figure


def _reach(findings: TrialFindings, describe: Callable[[str], Any]) -> float:
    """The largest gap to the optimum of a strategy that measured, or knows; others may leave the panels."""
    gaps = {c: o.gap for c, o in findings.outcomes.items()}
    measured = [gap for c, gap in gaps.items() if describe(c.strategy).group != "nothing"]
    most = (LOWEST - 1.0) * max(abs(findings.optimum(plant.name)) for plant in findings.plan.plants)
    return min(most, max(1.0, *(measured or gaps.values())))


def _draw(axes: Axes, outcome: Outcome, y: float, ink: str, last: bool) -> None:
    """A dot with its interval and median, and its best candidate, hollow; a number where the dot would be cut off."""
    mean, (low, high) = outcome.mean, axes.get_xlim()
    if mean.mean < low + 0.04 * (high - low):
        annotate_beside(axes, f"◂ {number(mean.mean)}", (low, y), (3, 0), color=ink, fontsize=8.5)
        return
    if mean.seeds >= INTERVAL_SEEDS:
        axes.plot([mean.low, mean.high], [y, y], color=ink, linewidth=1.3, zorder=2)
    axes.plot([outcome.median], [y], color=ink, marker="|", markersize=8, markeredgewidth=1.3, zorder=3)
    for value, filled in ((mean.mean, last), (outcome.anew, False)):
        if math.isfinite(value):
            axes.plot([value], [y], color=ink, marker="o", markersize=5, zorder=4, markeredgewidth=1.2,
                      markerfacecolor=ink if filled else "white")  # fmt: skip


def _key(figure: Figure, budgets: Sequence[int]) -> None:
    """What the marks mean, in one line above the panels."""

    def mark(**style: Any) -> Line2D:
        return Line2D([], [], color="0.2", **style)

    handles = [
        mark(marker="o", markersize=5, linewidth=1.3, markerfacecolor="0.2" if n == budgets[-1] else "white",
             label=f"{n} rollouts")
        for n in budgets
    ]  # fmt: skip
    handles.append(mark(marker="|", markersize=8, linestyle="none", label="median"))
    handles.append(Line2D([], [], color=ACCENT, linewidth=1.2, label="optimum"))
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=9.0)
