"""The study's answer: what rollouts were worth, what width cost, how far from optimal and why.

Everything is computed from per-seed mean returns J_s; contrasts and gaps are paired over seeds.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from study.formatting import number
from study.paper.finished_runs import Outcomes, Run, outcomes
from study.paper.presets import Point, Preset, Theta
from study.paper.published_numbers import CellSummary, Spot
from study.paper.reference_controllers import CONTROLLERS, OPTIMAL, Reference
from study.statistics import Contrast, bootstrap_coverage, holm, paired_bootstrap, paired_t, sem
from sysid.physics.ops import Array

Key = tuple[int, float]
"""(n, w) of a cell."""


@dataclass(frozen=True)
class Gap:
    """How far a cell is below the optimum of the hidden plant, and its two parts, which add up to it."""

    total: Contrast
    identification: Contrast
    training: Contrast


@dataclass(frozen=True, eq=False)
class PointFindings:
    """What the finished runs of an operating point say; of `runs` and `references` it keeps those of its point, the
    runs sorted by their cells.
    """

    preset: Preset
    point: Point
    runs: Sequence[Run]
    references: Sequence[Reference]

    def __post_init__(self) -> None:
        cells = set(self.point.cells)
        runs = sorted((run for run in self.runs if run.cell in cells), key=lambda run: run.cell)
        object.__setattr__(self, "runs", runs)
        object.__setattr__(self, "references", [r for r in self.references if r.truth == self.point.truth])

    @cached_property
    def cells(self) -> dict[Key, list[Run]]:
        """The runs of every cell, sorted by seed."""
        table: dict[Key, list[Run]] = {(n, w): [] for n in self.point.budgets for w in self.point.widths}
        for run in self.runs:
            table[run.cell.n, run.cell.w].append(run)
        return table

    @cached_property
    def outcomes(self) -> Outcomes:
        """The runs by cell and seed."""
        return outcomes(self.runs)

    def returns(self, key: Key) -> Array:
        """Mean returns (S,) of a cell's runs, sorted by seed."""
        return self.outcomes.returns(Spot(self.point.name, *key))

    @cached_property
    def summaries(self) -> dict[Key, CellSummary]:
        """Mean return of every cell, its error and its median over seeds."""
        return {key: self.outcomes.summary(Spot(self.point.name, *key)) for key in self.cells}

    def mean(self, key: Key) -> float:
        """Mean return of a cell over its seeds."""
        return self.summaries[key].mean

    def id_error(self, n: int) -> float:
        """Mean ||theta_hat - truth|| of a budget."""
        return float(np.mean(self.outcomes.id_errors(self.point.name, n)))

    def reference(self, controller: str, seeds: Sequence[int] | None = None, *, fresh: bool = False) -> Array:
        """Mean returns (S,) of a controller designed at the truth, by default from the study's seeds."""
        seeds = self.point.seeds if seeds is None else seeds
        references = [self._known[controller, self.point.truth, seed] for seed in sorted(seeds)]
        return np.array([r.fresh_mean if fresh else r.return_mean for r in references])

    @cached_property
    def _known(self) -> dict[tuple[str, Theta, int], Reference]:
        return {(r.controller, r.theta, r.seed): r for r in self.references}

    def rating(self, controller: str, seeds: Sequence[int] | None = None) -> tuple[float, float]:
        """Mean return and SEM over seeds of a controller designed at the truth, by default from the study's seeds."""
        returns = self.reference(controller, seeds=seeds)
        return float(np.mean(returns)), sem(returns)

    def allowed(self, seeds: Sequence[int] | None = None) -> dict[str, float]:
        """Mean return of every reference controller at the truth, by default from the study's own seeds."""
        return {controller: self.rating(controller, seeds)[0] for controller in CONTROLLERS}

    @property
    def figure_references(self) -> dict[str, float]:
        """Mean return of every reference controller from the start states of the preset's reference seeds.

        Heat maps and best widths of a report show these, so that they share an optimum with the published sweep.
        """
        return self.allowed(self.preset.reference_seeds)

    def design(self, key: Key) -> Array:
        """Returns (S,) on the hidden plant of the controller that is optimal for each seed's estimate."""
        return np.array([self._known[OPTIMAL, run.theta_hat, run.cell.seed].return_mean for run in self.cells[key]])

    def _paired(self, a: Array, b: Array) -> Contrast:
        return paired_bootstrap(a, b, resamples=self.preset.resamples)

    def contrast(self, a: Key, b: Key) -> Contrast:
        """J(a) - J(b) of two cells, paired over seeds, by the bootstrap."""
        return self._paired(self.returns(a), self.returns(b))

    def contrasts(self) -> list[tuple[str, Contrast, Contrast, float]]:
        """Every step of the budget at the least width, and every width against the least: the paired bootstrap,
        Student's t and its p after Holm's correction over the table."""
        (n_0, *_, n_last), (w_0, *wider) = (*self.point.budgets, self.point.budgets[-1]), self.point.widths
        pairs = {
            f"n = {a} → {b}, w = {w_0:g}": ((b, w_0), (a, w_0))
            for a, b in [*itertools.pairwise(self.point.budgets), (n_0, n_last)]
            if a != b
        }
        pairs |= {f"w = {w_0:g} → {w:g}, n = {n}": ((n, w), (n, w_0)) for n in self.point.budgets for w in wider}
        t_tests = {label: paired_t(self.returns(a), self.returns(b)) for label, (a, b) in pairs.items()}
        adjusted = holm({label: t.p for label, t in t_tests.items()})
        return [(label, self.contrast(*pairs[label]), t, adjusted[label]) for label, t in t_tests.items()]

    def gap(self, key: Key) -> Gap:
        """How far a cell is below the optimum, and why."""
        optimum, design, agent = self.reference(OPTIMAL), self.design(key), self.returns(key)
        return Gap(self._paired(optimum, agent), self._paired(optimum, design), self._paired(design, agent))

    @property
    def optimum(self) -> float:
        """The near-optimal mean return on the hidden plant from the same start states."""
        return float(np.mean(self.reference(OPTIMAL)))

    @property
    def best(self) -> Key:
        return max(self.cells, key=self.mean)

    def sentences(self) -> list[tuple[str, str]]:
        """(question, answer) in plain words, the most important first."""
        sentences = [("How far from optimal, and why?", self._short_of_optimal())]
        if len(self.point.widths) > 1:
            sentences.insert(0, ("What did width cost?", self._width()))
        if len(self.point.budgets) > 1:
            sentences.insert(0, ("What were the first rollouts worth?", self._first_rollouts()))
        return sentences

    def label(self, w: float) -> str:
        """A width as it is printed; at the prior range it is no more than a number in a table."""
        return f"w = {w:g}" if self.point.randomization == "band" else "prior range"

    def _first_rollouts(self) -> str:
        budgets, w = self.point.budgets, self.point.widths[0]
        n_0, n_1, n_last = budgets[0], budgets[1], budgets[-1]
        first = self.contrast((n_1, w), (n_0, w))
        begun = f"The first {n_1} rollouts were" if n_0 == 0 else f"To go from n = {n_0} to n = {n_1} was"
        text = (
            f"{begun} worth {first} in return, from {number(self.mean((n_0, w)))} to "
            f"{number(self.mean((n_1, w)))} at w = {w:g}{_doubt(first)}."
        )
        if n_last != n_1:
            rest = self.contrast((n_last, w), (n_1, w))
            text += f" The next {n_last - n_1} were worth {rest}, to {number(self.mean((n_last, w)))}{_doubt(rest)}."
        return text

    def _width(self) -> str:
        widths = self.point.widths
        narrow, wide = widths[0], widths[-1]
        changes = {n: self.contrast((n, wide), (n, narrow)) for n in reversed(self.point.budgets)}
        *parts, last = (f"{change} at n = {n}{_doubt(change)}" for n, change in changes.items())
        return (
            f"Training over a band of ±{100 * wide:.0f} % instead of "
            f"{'at the estimate' if narrow == 0 else f'±{100 * narrow:.0f} %'} changed the return by "
            f"{', '.join(parts)}{' and ' * bool(parts)}{last}."
        )

    def _short_of_optimal(self) -> str:
        gap, (n, w) = self.gap(self.best), self.best
        start = (self.point.budgets[0], self.point.widths[0])
        text = (
            f"The best cell (n = {n}, {self.label(w)}) returned {number(self.mean(self.best))}; the optimum of the "
            f"hidden plant from the same start states is {number(self.optimum)}, which leaves {gap.total.level} "
            f"({100.0 * gap.total.mean / abs(self.optimum):.1f} %): {_parts(gap)}."
        )
        if start != self.best:
            gap = self.gap(start)
            text += f" At n = {start[0]}, w = {start[1]:g} it was {gap.total.level}: {_parts(gap)}."
        return text

    def caveat(self) -> str:
        """How far the intervals can be trusted."""
        seeds = len(self.point.seeds)
        if seeds == 1:
            return "A single seed says nothing of how returns scatter: no interval is finite, no difference stands."
        coverage = bootstrap_coverage(seeds, np.random.default_rng(0))
        return (
            f"Brackets are 95 % intervals of a paired bootstrap over {seeds} seeds. With {seeds} seeds such an "
            f"interval holds the true mean in about {100 * coverage:.0f} % of cases rather than 95 % "
            "(simulated, normal differences)."
        )


def _parts(gap: Gap) -> str:
    text = f"{gap.identification.level} because the model is off, {gap.training.level} because of training"
    if gap.training.high < 0.0:
        text += " (agents forgive a wrong model more than a controller that trusts it)"
    return text


def _doubt(contrast: Contrast) -> str:
    return "" if contrast.significant else " (not distinguishable from zero)"
