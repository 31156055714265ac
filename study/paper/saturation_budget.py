"""How many rollouts a good identifier needs: where the budget curve of each bends, and what a rollout is then worth.

    closed(n) = (J(n) - J(0)) / (J_known - J(0)),   J the mean return at width w
    saturation budget = the least n from which on closed >= 95 %, give or take a standard error of J(n)

J_known is the best return that an identifier ends at: what agents so trained reach on a plant that is known. The
optimum would be no measure, for no number of rollouts closes what training leaves open. All identifiers see the same
rollouts. The points are those of the preset `identifiers`: prior, grid, least_squares,
unscented.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from study.formatting import number, percent
from study.paper.finished_runs import Outcomes
from study.paper.published_numbers import Spot
from study.paper.reference_controllers import OPTIMAL
from study.statistics import Contrast, paired_t

PRIOR_POINT, GRID = "prior", "grid"
LABELS = {"grid": "grid search", "least_squares": "least squares", "unscented": "the Kalman filter"}
SATURATED_SHARE = 0.95
"""The share of the gap between no data and a known plant at which a budget curve has bent."""


@dataclass(frozen=True, eq=False)
class BudgetCurve:
    """What n rollouts came to with one identifier at width w; the first budget is 0, the prior.

    known: J_known; saturation: the saturation budget, None where the gap stays open
    first: worth of the first rollouts; after: of all beyond the saturation budget
    """

    identifier: str
    w: float
    budgets: tuple[int, ...]
    returns: tuple[float, ...]
    sems: tuple[float, ...]
    errors: tuple[float, ...]
    known: float
    closed: tuple[float, ...]
    saturation: int | None
    first: Contrast
    after: Contrast | None

    @property
    def worth(self) -> float:
        """Mean worth of a rollout on the way to saturation, or to the last budget."""
        end = self.budgets.index(self.saturation if self.saturation is not None else self.budgets[-1])
        return (self.returns[end] - self.returns[0]) / max(self.budgets[end], 1)


def budget_curves(runs: Outcomes, w: float = 0.0) -> dict[str, BudgetCurve]:
    """The curves of all identifiers that were run at this width, by name; empty where the prior was not."""
    start = Spot(PRIOR_POINT, 0, w)
    names = [name for name in LABELS if name in runs.points]
    spots = {name: [start, *(s for n in runs.budgets(name) if (s := Spot(name, n, w)) in runs)] for name in names}
    if start not in runs or not names:
        return {}
    known = max(runs.summary(curve_spots[-1]).mean for curve_spots in spots.values())
    return {name: _curve(runs, name, curve_spots, known) for name, curve_spots in spots.items()}


def _curve(runs: Outcomes, name: str, spots: Sequence[Spot], known: float) -> BudgetCurve:
    start, cells = spots[0], [runs.summary(spot) for spot in spots]
    gap = known - cells[0].mean
    closed = [(cell.mean - cells[0].mean) / gap for cell in cells]
    short = [k for k, cell in enumerate(cells) if closed[k] + cell.sem / gap < SATURATED_SHARE]
    bent = 1 + max(short, default=-1)
    return BudgetCurve(
        identifier=name,
        w=start.w,
        budgets=tuple(spot.n for spot in spots),
        returns=tuple(cell.mean for cell in cells),
        sems=tuple(cell.sem for cell in cells),
        errors=tuple(float(np.mean(runs.id_errors(spot.point, spot.n))) for spot in spots),
        known=known,
        closed=tuple(closed),
        saturation=spots[bent].n if bent < len(spots) else None,
        first=paired_t(*runs.pair(spots[1], start)),
        after=paired_t(*runs.pair(spots[-1], spots[bent])) if bent < len(spots) - 1 else None,
    )


def paragraph(
    curves: Mapping[str, BudgetCurve], wider: Mapping[str, BudgetCurve], references: Mapping[str, float]
) -> str:
    """Where the saturation budget is with each identifier, and what a rollout is then worth; wider: the curves at
    another width."""
    if not curves:
        return ""
    any_, grid = next(iter(curves.values())), curves.get(GRID)
    said = [
        f"Without data agents return {number(any_.returns[0])}, on a plant that is known {number(any_.known)}, and "
        f"the optimum is {number(references[OPTIMAL])}."
    ]
    said += map(_sentence, curves.values())
    if grid:
        said += [_closer(grid, curve) for name, curve in curves.items() if name != GRID]
    if wider:
        bent = {LABELS[name]: f"n = {c.saturation}" if c.saturation else "none" for name, c in wider.items()}
        budgets = [f"{n} with {label}" for label, n in bent.items()]
        said.append(f"In a band of w = {next(iter(wider.values())).w:g} the saturation budget is {', '.join(budgets)}.")
    return " ".join(said)


def _sentence(curve: BudgetCurve) -> str:
    n, last = curve.budgets[1], curve.budgets[-1]
    first = "the first rollout is" if n == 1 else f"the first {n} rollouts are"
    text = f"With {LABELS[curve.identifier]} {first} worth {curve.first}"
    if curve.saturation is None:
        return f"{text}; n = {last} closes {percent(curve.closed[-1])} of that gap."
    text += (
        f"; {percent(SATURATED_SHARE)} of that gap are closed, give or take a standard error, from n = "
        f"{curve.saturation} on, at {number(curve.worth)} a rollout"
    )
    rest = f", and the other {last - curve.saturation} are together worth {curve.after}" if curve.after else ""
    return f"{text}{rest}."


def _closer(grid: BudgetCurve, other: BudgetCurve) -> str:
    mine = dict(zip(other.budgets, other.errors, strict=True))
    pairs = zip(grid.budgets[1:], grid.errors[1:], strict=True)
    ratios = [error / mine[n] for n, error in pairs if mine.get(n, 0.0) > 0.0]
    return (
        f"From the same rollouts {LABELS[other.identifier]} finds m and l {min(ratios):.0f} to {max(ratios):.0f} "
        "times closer than the grid."
    )
