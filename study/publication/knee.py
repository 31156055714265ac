"""How many rollouts a good identifier needs: where the budget curve of each bends, and what a rollout is then worth.

    closed(n) = (J(n) - J(0)) / (J(optimal) - J(0)),   J the mean return at width w
    knee      = the least n from which on closed >= 95 %

All identifiers see the same rollouts. The points are those of the preset `identifiers`: prior, grid, least_squares,
unscented.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from study.publication.paper import Spot
from study.publication.published import Outcomes
from study.references import OPTIMAL
from study.statistics import MINUS, Contrast, paired_t

PRIOR, GRID = "prior", "grid"
IDENTIFIERS = {"grid": "grid search", "least_squares": "least squares", "unscented": "the Kalman filter"}
ENOUGH = 0.95
"""The share of the gap between no data and the optimum at which a budget curve has bent."""


@dataclass(frozen=True, eq=False)
class BudgetCurve:
    """What n rollouts came to with one identifier at width w; the first budget is 0, the prior.

    knee: None where the gap stays open; first: worth of the first rollouts; after: of all beyond the knee.
    """

    identifier: str
    w: float
    budgets: tuple[int, ...]
    returns: tuple[float, ...]
    sems: tuple[float, ...]
    errors: tuple[float, ...]
    closed: tuple[float, ...]
    knee: int | None
    first: Contrast
    after: Contrast | None

    @property
    def worth(self) -> float:
        """Mean worth of a rollout on the way to the knee, or to the last budget."""
        end = self.budgets.index(self.knee if self.knee is not None else self.budgets[-1])
        return (self.returns[end] - self.returns[0]) / max(self.budgets[end], 1)


def budget_curves(runs: Outcomes, references: Mapping[str, float], w: float = 0.0) -> dict[str, BudgetCurve]:
    """The curves of all identifiers that were run at this width, by name; empty where the prior was not."""
    start = Spot(PRIOR, 0, w)
    if start not in runs:
        return {}
    return {name: _curve(runs, name, start, references[OPTIMAL]) for name in IDENTIFIERS if name in runs.points}


def _curve(runs: Outcomes, name: str, start: Spot, optimum: float) -> BudgetCurve:
    spots = [start, *(spot for n in runs.budgets(name) if (spot := Spot(name, n, start.w)) in runs)]
    cells = [runs.summary(spot) for spot in spots]
    closed = [(cell.mean - cells[0].mean) / (optimum - cells[0].mean) for cell in cells]
    bent = 1 + max((k for k, share in enumerate(closed) if share < ENOUGH), default=-1)
    return BudgetCurve(
        identifier=name,
        w=start.w,
        budgets=tuple(spot.n for spot in spots),
        returns=tuple(cell.mean for cell in cells),
        sems=tuple(cell.sem for cell in cells),
        errors=tuple(float(np.mean(runs.id_errors(spot.point, spot.n))) for spot in spots),
        closed=tuple(closed),
        knee=spots[bent].n if bent < len(spots) else None,
        first=_gain(runs, spots[1], start),
        after=_gain(runs, spots[-1], spots[bent]) if bent < len(spots) - 1 else None,
    )


def _gain(runs: Outcomes, a: Spot, b: Spot) -> Contrast:
    seeds = runs.seeds(a, b)
    return paired_t(runs.returns(a, seeds), runs.returns(b, seeds))


def paragraph(curves: Mapping[str, BudgetCurve], references: Mapping[str, float]) -> str:
    """Where the knee of the budget curve moves with a better identifier, and what a rollout is then worth."""
    if not curves:
        return ""
    said = [_sentence(curve, references) for curve in curves.values()]
    for name in ("least_squares", "unscented"):
        if name in curves and GRID in curves:
            said.append(_closer(curves[GRID], curves[name]))
    return " ".join([*said, _conclusion(curves)]).strip()


def _sentence(curve: BudgetCurve, references: Mapping[str, float]) -> str:
    n, last = curve.budgets[1], curve.budgets[-1]
    first = "the first rollout is" if n == 1 else f"the first {n} rollouts are"
    text = f"With {IDENTIFIERS[curve.identifier]} {first} worth {curve.first}"
    gap = f"{_percent(ENOUGH)} of the gap between {_number(curve.returns[0])} without data and the optimum"
    gap += f" ({_number(references[OPTIMAL])})"
    if curve.knee is None:
        return f"{text}; {gap} stays open: n = {last} closes {_percent(curve.closed[-1])}."
    text += f"; {gap} is closed from n = {curve.knee} on, at {_number(curve.worth)} a rollout"
    if curve.after is None:
        return f"{text}."
    return f"{text}, and the other {last - curve.knee} are together worth {curve.after}."


def _closer(grid: BudgetCurve, other: BudgetCurve) -> str:
    pairs = zip(grid.budgets[1:], grid.errors[1:], strict=True)
    mine = dict(zip(other.budgets, other.errors, strict=True))
    ratios = [error / mine[n] for n, error in pairs if n in mine and mine[n] > 0.0]
    return (
        f"From the same rollouts {IDENTIFIERS[other.identifier]} finds m and l {min(ratios):.0f} to {max(ratios):.0f} "
        "times closer than the grid."
    )


def _conclusion(curves: Mapping[str, BudgetCurve]) -> str:
    if GRID not in curves or "least_squares" not in curves:
        return ""
    grid, good = curves[GRID].knee, curves["least_squares"]
    text = (
        "The difference is the sensing, not the data: the grid compares readings one step apart, where the noise of a "
        "speed is far larger than what a torque changes in it, while the others follow a rollout as a whole."
    )
    text += " " + _as_far(curves[GRID], good)
    if good.knee is None or grid is None:
        return text
    text += f" So the knee moves from n = {grid} to n = {good.knee}"
    if good.after is None or good.after.significant:
        return f"{text}."
    return f"{text}, and past it another rollout is worth nothing that these seeds could show."


def _as_far(grid: BudgetCurve, good: BudgetCurve) -> str:
    """From which budget on the grid closes as much of the gap as the first rollouts of a better identifier."""
    n, share = good.budgets[1], good.closed[1]
    within = [mean + sem >= good.returns[1] for mean, sem in zip(grid.returns, grid.sems, strict=True)]
    bent = 1 + max((k for k, reached in enumerate(within) if not reached), default=-1)
    later = f"from n = {grid.budgets[bent]} on" if bent < len(within) else "with none of these budgets"
    return (
        f"With n = {n} {IDENTIFIERS[good.identifier]} closes {_percent(share)} of the gap; "
        f"the grid comes as far, give or take a standard error, {later}."
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %".replace("-", MINUS)


def _number(value: float) -> str:
    return f"{value:.0f}".replace("-", MINUS)
