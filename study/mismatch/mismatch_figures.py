"""The mismatch experiment on two pages: what every strategy returns, and the ladder from the prior to the oracle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from study.figure_style import ACCENT, annotate_beside, faint_lines, panel_title, panels_abreast
from study.formatting import capital, number
from study.mismatch.mismatch_findings import MismatchFindings, Split
from study.mismatch.mismatch_plan import LADDER, SPLIT, STRATEGIES
from study.statistics import Contrast
from study.strategies.trial_plan import Condition
from study.trials.hidden_plant import HiddenPlant

INKS = {"nothing": "0.45", "plain": "#0072B2", "mended": "#D55E00", "oracle": "0.1"}
"""Of the groups of strategies (Okabe and Ito)."""

PARTS = {"structure": "#D55E00", "identification": "#56B4E9", "training": "0.72"}
"""Colours of the parts of a gap."""


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


def ladder_of_strategies(findings: MismatchFindings) -> Figure:
    """Left: from the prior to the oracle at the largest budget, a line a hidden plant, as a share of the optimum,
    J* / J. Right: what the gaps of the fitted and the mended model consist of."""
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    _climb(left, findings)
    _splits(right, findings)
    return figure


def _climb(axes: Axes, findings: MismatchFindings) -> None:
    rungs = [strategy for strategy in LADDER if strategy in findings.plan.strategies]
    inks = _plant_inks(findings)
    for k, plant in enumerate(findings.plan.plants):
        means = [findings.outcomes[_at_most(findings, plant, strategy)].mean for strategy in rungs]
        optimum, x = findings.optimum(plant.name), np.arange(len(rungs)) + 0.05 * (k - 0.5 * (len(inks) - 1))
        shares = [_share(optimum, mean.mean) for mean in means]
        bars = [_reach(optimum, mean) for mean in means]
        axes.errorbar(x, shares, np.transpose(bars), color=inks[plant.name], marker="o", markersize=5, linewidth=1.8,
                      elinewidth=1.1, zorder=3, label=plant.title)  # fmt: skip
    axes.axhline(100.0, color=ACCENT, linewidth=1.1, zorder=1)
    axes.set_xticks(range(len(rungs)), rungs)
    axes.set_ylim(0.0, 106.0)
    axes.set_ylabel("share of the optimum, J* / J [%]")
    axes.set_title(f"From the prior to the oracle, {max(findings.plan.budgets)} rollouts")
    axes.legend(loc="lower right", fontsize=9.5, labelcolor="linecolor", title="what is missing", alignment="left")


def _share(optimum: float, value: float) -> float:
    """J* / J in percent: returns are negative, and 100 is the optimum; beyond -1 it is that of -1."""
    return 100.0 * optimum / min(value, -1.0)


def _reach(optimum: float, mean: Contrast) -> tuple[float, float]:
    """How far the interval of the share reaches down and up; nan for that of one seed, which is everything."""
    if not math.isfinite(mean.low):
        return math.nan, math.nan
    low, share, high = (_share(optimum, value) for value in (mean.low, mean.mean, mean.high))
    return share - low, high - share


def _at_most(findings: MismatchFindings, plant: HiddenPlant, strategy: str) -> Condition:
    return findings.condition(plant.name, strategy, max(findings.plan.budgets))


def _plant_inks(findings: MismatchFindings) -> dict[str, str]:
    """A colour a plant: grey for the plain one, then Okabe and Ito's."""
    inks = iter(("#009E73", "#56B4E9", "#0072B2", "#D55E00", "#CC79A7", "#E69F00", "#000000"))
    return {p.name: "0.55" if p.effect is None else next(inks) for p in findings.plan.plants}


def _splits(axes: Axes, findings: MismatchFindings) -> None:
    """Bars from the optimum: parts of a gap end to end; a part below zero stands left of it."""
    strategies = [s for s in SPLIT if s in findings.plan.strategies]
    y, ticks = 0.0, []
    for plant in findings.plan.plants:
        annotate_beside(axes, capital(plant.title), (0.0, y - 0.5), (4, 3), va="baseline", color="0.3")
        for strategy in strategies:
            split = findings.splits[_at_most(findings, plant, strategy)]
            if split is None:
                axes.text(0.0, y, " no table stands for this model", va="center", fontsize=8.0, color="0.5")
            else:
                _stack(axes, split, y)
            ticks.append((y, strategy))
            y += 1.0
        y += 1.1
    axes.axvline(0.0, color=ACCENT, linewidth=1.1, zorder=3)
    axes.set_yticks(*zip(*ticks, strict=True), fontsize=8.5)
    axes.set_ylim(y - 1.5, -1.5)
    axes.margins(x=0.08)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("return lost against the optimum")
    axes.set_title("What the gap is made of", pad=26)
    handles = [Patch(color=ink, label=name) for name, ink in PARTS.items()]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(-0.02, 0.985), ncols=3, fontsize=9.0)


def _stack(axes: Axes, split: Split, y: float) -> None:
    plus = minus = 0.0
    for name, ink in PARTS.items():
        part = getattr(split, name)
        axes.barh(y, part, left=plus if part >= 0.0 else minus, color=ink, height=0.8, zorder=2)
        plus, minus = plus + max(part, 0.0), minus + min(part, 0.0)
    annotate_beside(axes, number(split.gap), (plus, y), fontsize=8.0)
