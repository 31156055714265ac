"""The mismatch experiment, told: figure and page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from study.figure_style import ACCENT, annotate_beside, faint_lines, panel_title, panels_abreast
from study.formatting import number
from study.mismatch.mismatch_findings import MismatchFindings, mismatch_findings, mismatch_sentences
from study.mismatch.mismatch_plan import STRATEGIES, MismatchPlan
from study.pipeline.publication import Account
from study.strategies.trial_findings import TrialResults, trial_account
from study.trials.hidden_plant import HiddenPlant

INKS = {"nothing": "0.45", "plain": "#0072B2", "mended": "#D55E00", "oracle": "0.1"}
"""Of the groups of strategies (Okabe and Ito)."""


def strategy_returns(findings: MismatchFindings) -> Figure:
    """Mean return of every strategy with its interval over seeds, a panel a hidden plant, all to one scale but each
    about its own optimum (red line); few rollouts hollow and many filled; small upright ticks are medians."""
    plan = findings.plan
    rows = _rows(plan.strategies)
    figure, panels = panels_abreast(len(plan.plants), 12.0, 1.9 + 0.34 * max(rows.values()))
    reach = _reach_of_panels(findings)
    for axes, plant in zip(panels, plan.plants, strict=True):
        optimum = findings.optimum(plant.name)
        best = max(optimum, *(o.mean.mean for c, o in findings.outcomes.items() if c.plant == plant.name))
        axes.set_xlim(best - 1.12 * reach, best + 0.12 * reach)
        axes.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
        for strategy, y in rows.items():
            _strategy(axes, findings, plant, strategy, y)
        axes.axvline(optimum, color=ACCENT, linewidth=1.2, zorder=1)
        panel_title(axes, plant.noun, plant.size, "not in the catalogue" * (plant.in_catalogue is False), fontsize=9.5)
        axes.tick_params(axis="y", length=0)
        faint_lines(axes, "x")
    first = panels[0]
    first.set_yticks(list(rows.values()), [STRATEGIES[strategy].short for strategy in rows])
    for label, strategy in zip(first.get_yticklabels(), rows, strict=True):
        label.set_color(_ink(strategy))
    first.set_ylim(max(rows.values()) + 0.7, -0.7)
    figure.supxlabel("return on the hidden plant: mean and 95 % interval over seeds", fontsize=10.0)
    _key(figure, plan.contrasted)
    return figure


def _rows(strategies: Sequence[str]) -> dict[str, float]:
    """Places of the strategies, in the groups' order with a gap between groups."""
    places, y = dict[str, float](), 0.0
    for group in INKS:
        own = [key for key, strategy in STRATEGIES.items() if strategy.group == group and key in strategies]
        for strategy in own:
            places[strategy], y = y, y + 1.0
        y += 0.6 * bool(own)
    return places


def _ink(strategy: str) -> str:
    return INKS[STRATEGIES[strategy].group]


def _strategy(axes: Axes, findings: MismatchFindings, plant: HiddenPlant, strategy: str, y: float) -> None:
    """The dots of a strategy: one without rollouts, one a budget with them; a number where a dot would be cut off."""
    budgets, ink, (low, high) = findings.plan.budgets_of(strategy, "encoder"), _ink(strategy), axes.get_xlim()
    for k, n in enumerate(budgets):
        outcome = findings.outcomes[findings.condition(plant.name, strategy, n)]
        place = y + 0.34 * (k - 0.5 * (len(budgets) - 1)) / max(1, len(budgets) - 1)
        if outcome.mean.mean < low + 0.04 * (high - low):
            annotate_beside(axes, f"◂ {number(outcome.mean.mean)}", (low, place), (3, 0), color=ink, fontsize=8.5)
            continue
        if math.isfinite(outcome.mean.low):
            axes.plot([outcome.mean.low, outcome.mean.high], [place, place], color=ink, linewidth=1.3, zorder=2)
        axes.plot([outcome.median], [place], color=ink, marker="|", markersize=8, markeredgewidth=1.3, zorder=3)
        axes.plot([outcome.mean.mean], [place], color=ink, marker="o", markersize=5, zorder=4, markeredgewidth=1.2,
                  markerfacecolor="white" if k < len(budgets) - 1 else ink)  # fmt: skip


def _reach_of_panels(findings: MismatchFindings) -> float:
    """The largest gap to the optimum of a strategy that measured, or knows; others may leave the panels."""
    gaps = {c: findings.optimum(c.plant) - o.mean.mean for c, o in findings.outcomes.items()}
    told = [gap for c, gap in gaps.items() if STRATEGIES[c.strategy].group != "nothing"]
    return max(1.0, *(told or gaps.values()))


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
    handles.append(Line2D([], [], color=ACCENT, linewidth=1.2, label="optimum (dynamic programming)"))
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), fontsize=9.0)


PARTS = ("structure", "identification", "training", "tables")
"""Of the gap to the optimum, over as many seeds as there are tables for."""

CAPTION = (
    "Every strategy at every hidden plant: mean return with its 95 % interval over seeds, hollow for few rollouts, "
    "filled for many. All panels have one scale, each about its own optimum; a number at the left edge is a mean left "
    "of the panel."
)


def account(plan: MismatchPlan, results: TrialResults) -> Account:
    """What is told of the results."""
    return mismatch_account(mismatch_findings(plan, results))


def mismatch_account(found: MismatchFindings) -> Account:
    """What is told of the findings."""
    nothing = dict(zip(PARTS, (math.nan, math.nan, math.nan, 0), strict=True))
    return trial_account(
        found,
        mismatch_sentences(found),
        (partial(strategy_returns, found), CAPTION),
        "mismatch.html.j2",
        {"strategies": STRATEGIES},
        {condition: vars(split) if split else nothing for condition, split in found.splits.items()},
    )
