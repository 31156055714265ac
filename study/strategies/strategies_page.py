"""The strategies experiment, told: answers in words, figure and page.

The figure has a panel a plant: how far strategies fall short of the optimum over the rollouts, or with one budget their
returns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from study.figure_style import ACCENT, annotate_beside, faint_lines, panel_title
from study.formatting import number, percent, signed
from study.pipeline.publication import Account
from study.strategies.catalogue import strategy_called
from study.strategies.strategies_plan import REFERENCE, StrategiesPlan
from study.strategies.strategy import GROUPS
from study.strategies.trial_figures import INTERVAL_SEEDS, SENSED, returns_in_rows
from study.strategies.trial_findings import NEAR, Outcome, TrialFindings, TrialResults, trial_account, trial_findings
from sysid.report.figure_style import BLUE, GREEN, ORANGE, YELLOW

FEWEST_SEEDS = 5
"""Seeds below which a mean says little."""


def strategies_sentences(findings: TrialFindings) -> list[tuple[str, str]]:
    """Pairs of question and answer."""
    sentences = [
        ("How many rollouts does it take?", _arrivals(findings)),
        ("Which strategy beats the point estimate?", _contrasts(findings)),
    ]
    if any(np.isfinite(o.observed).any() for o in findings.outcomes.values()):
        sentences.append(("What is the best return worth that was seen?", _curse(findings)))
    return sentences


def _arrivals(findings: TrialFindings) -> str:
    """Who comes within NEAR of the optimum first, on every plant."""
    sentences = []
    for plant, sensing in findings.plan.places:
        arrivals = {s: findings.arrived(plant.name, sensing, s) for s in findings.plan.strategies}
        there = {s: n for s, n in arrivals.items() if n is not None}
        counts = (len(o.seeds) for c, o in findings.outcomes.items() if c[:2] == (plant.name, sensing) and c.n)
        seeds = max(counts, default=len(findings.plan.seeds))
        where = f"On the plant with {plant.title}" if plant.effect else "On the paper's plant"
        where += f" ({sensing}, {seeds} seeds)"
        if not there:
            sentences.append(f"{where} no strategy comes within {percent(NEAR)} of the optimum.")
            continue
        least = min(there.values())
        first = [strategy_called(s).short for s, n in there.items() if n == least]
        sentences.append(
            f"{where} {_listed(first)} {'comes' if len(first) == 1 else 'come'} within {percent(NEAR)} of "
            f"the optimum with {least} rollout{'s' * (least != 1)}, and {len(there)} of {len(arrivals)} do so within "
            "the budgets that were run."
        )
    return " ".join(sentences) + _caution(findings)


def _contrasts(findings: TrialFindings) -> str:
    compared = findings.compared
    if not compared:
        return "No contrast was planned between these strategies."
    certain = [c for c in compared if c.certain]
    better = [c for c in certain if c.contrast.mean > 0.0]
    text = (
        f"Of {len(compared)} contrasts that were fixed beforehand, {len(better)} certainly favour the other strategy "
        f"and {len(certain) - len(better)} the point estimate, after Holm's correction over all of them."
    )
    if certain:
        most = max(certain, key=lambda c: abs(c.contrast.mean))
        short = strategy_called(most.a).short
        text += f" The largest: {short} with {most.n} rollouts on {most.plant}, {most.contrast}."
    return text


def _curse(findings: TrialFindings) -> str:
    """Observed returns of the best candidates against what these return when they are evaluated anew. Candidates are
    compared from rest and evaluated from the task's starts, so the two are no one scale; deployed is held against."""
    sentences = []
    for strategy in findings.plan.strategies:
        outcomes = [o for c, o in findings.outcomes.items() if c.strategy == strategy and np.isfinite(o.best).any()]
        if outcomes:
            gain = float(np.mean(np.concatenate([o.returns - o.best for o in outcomes])))
            sentences.append(
                f"{strategy_called(strategy).short}: what it deploys returns {signed(gain)} against its best "
                f"candidate so far, evaluated anew ({number(np.mean([o.anew for o in outcomes]))})"
            )
    return "; ".join(sentences) + "." + _caution(findings)


def _caution(findings: TrialFindings) -> str:
    seeds = len(findings.plan.seeds)
    return f" With {seeds} seed{'s' * (seeds != 1)} these are no findings yet." if seeds < FEWEST_SEEDS else ""


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


OKABE_ITO = (BLUE, ORANGE, GREEN, "#CC79A7", "#56B4E9", YELLOW, "#7F3C8D", "#222222")
"""Six of Okabe and Ito's colours, and two more."""
GROUP_COLOURS = dict(zip(GROUPS, ("0.5", *OKABE_ITO), strict=False))
"""Of the groups, where these stand in one panel."""
LOOKS = [{"color": colour, "marker": mark} for colour, mark in zip(OKABE_ITO, "osD^vPXp", strict=True)]
"""Of the lines of a group."""

FLOOR = 0.01
"""What falls short by less is drawn as if by so much."""


def returns_of_strategies(findings: TrialFindings) -> Figure:
    """Lines over the rollouts where there are several budgets, and else mean returns, a row a strategy."""
    return (_lines if findings.several else _rows)(findings)


def _lines(findings: TrialFindings) -> Figure:
    """How far the means fall short of the optimum, all panels to one scale that has the optimum above: a row a group,
    with its names at the right; grey: the point estimate and what spends nothing."""
    plan, places = findings.plan, len(findings.plan.places)
    groups = {g: [s for s in plan.strategies if strategy_called(s).group == g] for g in GROUPS}
    context = [s for s in plan.strategies if s == REFERENCE or s in groups["nothing"]]
    grey = {s: {"color": "0.6", "marker": "o" if s == REFERENCE else "x+"[k % 2]} for k, s in enumerate(context)}
    spending = {group: strategies for group, strategies in groups.items() if strategies and group != "nothing"}
    figure = Figure(figsize=(2.8 + 2.4 * places, 1.0 + 2.4 * len(spending)), layout="constrained")
    rows = figure.subplots(len(spending), places + 1, squeeze=False, sharex="col",
                           width_ratios=[2.4] * places + [1.7])  # fmt: skip
    most = max(NEAR, *(outcome.shortfall.mean for outcome in findings.outcomes.values()))
    for (group, strategies), (*panels, key) in zip(spending.items(), rows, strict=True):
        looks = grey | dict(zip(strategies, cycle(LOOKS), strict=False))
        for (plant, sensing), axes in zip(plan.places, panels, strict=True):
            axes.set_yscale("log")
            axes.set_ylim(1.3 * most, 0.85 * FLOOR)
            axes.yaxis.set_major_locator(LogLocator(10.0, subs=(1.0, 3.0)))
            axes.yaxis.set_major_formatter(lambda share, _: f"{100.0 * share:.3g} %")
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.axhline(NEAR, color=ACCENT, linewidth=1.1, zorder=1)
            axes.tick_params(labelleft=axes is panels[0])
            for strategy, look in looks.items():
                _line(axes, plan.budgets, findings.line(plant.name, sensing, strategy), look)
            faint_lines(axes, "y")
        annotate_beside(panels[0], percent(NEAR), (1.0, NEAR), (-3, 5), color=ACCENT, fontsize=8.0, ha="right",
                        xycoords=panels[0].get_yaxis_transform())  # fmt: skip
        panels[0].set_ylabel(f"{GROUPS[group]}\nshort of the optimum by")
        for strategy, look in sorted(looks.items(), key=lambda item: item[0] not in strategies):
            key.plot([], [], label=strategy_called(strategy).short, linewidth=1.4, markersize=4.5, **look)
        key.legend(loc="center left", fontsize=8.5)
        key.set_axis_off()
    for (plant, sensing), top, bottom in zip(plan.places, rows[0], rows[-1], strict=False):
        panel_title(top, plant.title, SENSED[sensing], fontsize=10.0)
        bottom.set_xticks(range(len(plan.budgets)), [str(n) for n in plan.budgets])
        bottom.set_xlabel("real rollouts")
    return figure


def _line(axes: Axes, budgets: Sequence[int], line: Mapping[int, Outcome], look: Mapping[str, Any]) -> None:
    """A strategy's shortfalls, and those of its best candidates; small where seeds are too few for an interval."""
    x, falls = [budgets.index(n) for n in line], [outcome.shortfall for outcome in line.values()]
    best = [outcome.anew / float(np.mean(outcome.optima)) - 1.0 for outcome in line.values()]
    axes.plot(x, [max(FLOOR, fall.mean) for fall in falls], linewidth=1.2, **{**look, "marker": ""})
    axes.plot(x, np.maximum(FLOOR, best), linewidth=1.0, linestyle=":", markersize=4.5,
              **{**look, "markerfacecolor": "white"})  # fmt: skip
    for at, fall in zip(x, falls, strict=True):
        axes.plot([at], [max(FLOOR, fall.mean)], markersize=5.0 if fall.seeds >= INTERVAL_SEEDS else 2.5, **look)
        if fall.seeds >= INTERVAL_SEEDS:
            axes.plot([at, at], np.maximum(FLOOR, [fall.low, fall.high]), color=look["color"], linewidth=1.0, alpha=0.6)


def _rows(findings: TrialFindings) -> Figure:
    """With a grey line that continues the point estimate."""
    figure = returns_in_rows(findings, strategy_called, GROUP_COLOURS)
    for axes, (plant, sensing) in zip(figure.axes, findings.plan.places, strict=True):
        for outcome in findings.line(plant.name, sensing, REFERENCE).values():
            axes.axvline(outcome.mean.mean, color="0.7", linewidth=1.0, linestyle="--", zorder=1)
    return figure


SHORTFALL_CAPTION = (
    "How far mean returns fall short of the optimum's, for the real rollouts that were spent, strategies of a group "
    f"together; bars: 95 % intervals over seeds. Small marks: fewer than {INTERVAL_SEEDS} seeds, which say little. "
    f"Above the red line it is less than {percent(NEAR)}; what is nearer than {percent(FLOOR)} lies at the upper edge. "
    "Hollow: of strategies that compare returns, their best candidate so far, evaluated anew outside the budget. Grey: "
    "the point estimate and what spends nothing."
)
ROWS_CAPTION = (
    "Mean return with its 95 % interval over seeds, a row a strategy. Hollow: of strategies that compare returns, "
    "their best candidate, evaluated anew outside the budget. Dashed: the point estimate. Red: the optimum."
)


def account(plan: StrategiesPlan, results: TrialResults) -> Account:
    """What is told of the results."""
    findings = trial_findings(plan, results)
    return trial_account(
        findings,
        strategies_sentences(findings),
        (partial(returns_of_strategies, findings), SHORTFALL_CAPTION if findings.several else ROWS_CAPTION),
        "strategies.html.j2",
        {"strategies": {name: strategy_called(name) for name in plan.strategies}},
    )
