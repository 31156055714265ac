"""What the paper claims beside its table, each answered in a sentence with its numbers.

rate, bias, floor   from identification alone, on many seeds (`identification_scatter`); nothing is trained for them
plateau, monotone   from the cells, there and here                  starts   from the evaluation's start states
undertraining       from the learning curves of the widest band, and from twice the training where it was run
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.formatting import MINUS, bracketed, number, percent, signed
from study.paper.agreement import OPEN
from study.paper.finished_runs import Outcomes
from study.paper.identification_scatter import Scatter
from study.paper.published_numbers import CELLS, DIFFERENCES, QUOTES, SEEDS, Spot
from study.statistics import Contrast, paired_t

HOLDS, IN_PART, FAILS = "holds", "in part", "does not hold"
NEAR_RETURN = 20.0
"""A return is 'near' another within this."""
CELL = 2.7 / 60
"""Step of the paper's grid [kg, m]."""

Curve = Sequence[tuple[int, float]]
"""(environment steps done, return) of training episodes."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, a verdict in a word or two, and the answer in a few sentences."""

    name: str
    verdict: str
    answer: str

    @property
    def quote(self) -> str:
        return QUOTES[self.name][0]

    @property
    def place(self) -> str:
        return QUOTES[self.name][1]


def rate(scatter: Scatter) -> Claim:
    """Does the identification error fall as 1/sqrt(n)?"""
    rng, last = np.random.default_rng(0), scatter.budgets[-1]
    small, large = scatter.exponent(1.0, 5, 50, rng), scatter.exponent(1.0, 100, last, rng)
    five, fifty = (percent(scatter.at_bound(1.0, n)) for n in (5, 50))
    close, open_ = max(abs(p + 0.5) for p in small) < 0.1, small[1] <= -0.5 <= small[2]
    return Claim(
        "rate",
        HOLDS if close else OPEN if open_ else FAILS,
        f"Between 5 and 50 rollouts the mean error over {scatter.seeds} seeds falls as n to the power "
        f"{bracketed(*small, 2, signed)}; 1/√n would be {MINUS}0.5. m ends at the edge of the grid in {five} of "
        f"measurements with 5 rollouts and in {fifty} with 50, and there the box bounds the error, not the data. "
        f"Between 100 and {last} rollouts the power is {bracketed(*large, 2, signed)}.",
    )


def bias(scatter: Scatter) -> Claim:
    """Does noise in the predictor's inputs bias the fit, or only scatter it?"""
    last, truth = scatter.budgets[-1], np.array(scatter.truth)
    noisy, clean = scatter.thetas(1.0, 50) - truth, scatter.thetas(1.0, 50, clean=True) - truth
    m, l = map(paired_t, noisy.T)  # noqa: E741
    sd = np.std(noisy, axis=0, ddof=1)
    share = (m.mean**2 + l.mean**2) / float(np.mean(np.sum(noisy**2, axis=1)))
    free = noisy[~scatter.edge(1.0, 50), 0]
    inputs = paired_t(noisy[:, 0], clean[:, 0])
    text = (
        f"At n = 50 m is off by {_fine(m)} kg on average and l by {_fine(l)} m, while single measurements scatter by "
        f"{sd[0]:.2f} kg and {sd[1]:.2f} m: bias is {percent(share)} of the squared error. That the "
        f"mean of m is so near is partly the grid's edge, where {percent(scatter.at_bound(1.0, 50))} of measurements "
        f"end: the median is off by {signed(np.median(noisy[:, 0]), 2)} kg, and the mean of the others by "
        f"{signed(free.mean(), 2)} kg. With the same noise "
        f"taken out of the inputs m is off by {signed(clean[:, 0].mean(), 3)} kg all the same (difference "
        f"{_fine(inputs)}): the measured speed enters the prediction with a fixed factor of one, so noise there acts "
        "as noise of the output does, and what is left comes from m standing in a denominator."
    )
    if 2.0 in scatter.sigmas:
        ends = (signed(np.mean(scatter.thetas(2.0, last, clean=c)[:, 1]) - truth[1], 2) for c in (False, True))
        text += (
            " Only through the speed limit does it bias: at sigma = 2 and n = {}, l is off by {} m, by {} m with "
            "clean inputs.".format(last, *ends)
        )
    small = max(abs(inputs.low), abs(inputs.high)) < 0.1 * sd[0]
    return Claim("bias", FAILS if small else IN_PART if inputs.significant else OPEN, text)


def error_floor(scatter: Scatter) -> Claim:
    """Is there a floor at 5 rollouts for sigma = 0.5, and at 50 for sigma = 2?"""
    last = scatter.budgets[-1]
    quiet, loud = (
        {n: float(np.mean(row)) for n, row in zip(scatter.budgets, scatter.errors(sigma), strict=True)}
        for sigma in (0.5, 2.0)
    )
    falls = (
        paired_t(scatter.errors(sigma)[scatter.budgets.index(a)], scatter.errors(sigma)[scatter.budgets.index(b)])
        for sigma, a, b in ((0.5, 5, 50), (2.0, 50, last))
    )
    returns = [number(CELLS[Spot("low_noise", n, 0.0)].mean) for n in (5, 50)]
    return Claim(
        "floor",
        FAILS if all(fall.low > 0.0 for fall in falls) else OPEN,
        f"The error goes on falling: at sigma = 0.5 it is {quiet[5]:.2f} on average with 5 rollouts, {quiet[50]:.2f} "
        f"with 50 and {quiet[last]:.2f} with {last}; at sigma = 2 it is {loud[50]:.2f} with 50 and {loud[last]:.2f} "
        f"with {last}. A floor of about {nearest_cell(scatter.truth):.2f} to {CELL:.2f}, the grid's cells about the "
        "truth, lies below all of these. What is flat from 5 rollouts on at sigma = 0.5 is the return "
        f"({returns[0]}, and {returns[1]} with 50): it asks for no better model.",
    )


def nearest_cell(truth: tuple[float, float]) -> float:
    """Distance of the truth to the nearest cell of the paper's grid."""
    axis = 0.3 + CELL * np.arange(61)
    return float(np.hypot(*(np.min(np.abs(axis - value)) for value in truth)))


def plateau(ours: Outcomes | None = None) -> Claim:
    """Does every cell from n = 10 upward sit near -340?"""
    spots = [spot for spot in CELLS if spot.point == "main" and spot.n >= 10]
    far = [spot for spot in spots if abs(CELLS[spot].mean + 340.0) > NEAR_RETURN]
    worst = min(spots, key=lambda spot: CELLS[spot].mean)
    text = (
        f"Of the paper's own {len(spots)} cells from n = 10 upward, {len(spots) - len(far)} are within "
        f"{NEAR_RETURN:.0f} of {MINUS}340; the widest bands are not (n = {worst.n}, w = {worst.w:g}: "
        f"{number(CELLS[worst].mean)})."
    )
    run = [spot for spot in spots if ours is not None and spot in ours]
    if ours is not None and run:
        near = sum(abs(ours.summary(spot).mean + 340.0) <= NEAR_RETURN for spot in run)
        text += f" Here {near} of {len(run)} are."
    return Claim("plateau", IN_PART if far else HOLDS, text)


def monotone(ours: Outcomes | None = None) -> Claim:
    """Does widening the band never improve the return?"""
    text = f"In the paper's own means {_improvements({s: c.mean for s, c in CELLS.items() if s.point == 'main'})}."
    if ours is not None:
        means = {spot: ours.summary(spot).mean for spot in ours.table if spot.point == "main"}
        if len({spot.w for spot in means}) > 1:
            text += f" Here {_improvements(means)}."
    return Claim("monotone", IN_PART, text + " Which of these are more than scatter is in the table of contrasts.")


def _improvements(means: Mapping[Spot, float]) -> str:
    """How many of a sweep's steps to the next width raise the mean, and which does most."""
    rows = [sorted(spot for spot in means if spot.n == n) for n in sorted({spot.n for spot in means})]
    steps = [pair for row in rows for pair in itertools.pairwise(row)]
    better = [(a, b) for a, b in steps if means[b] > means[a]]
    if not better:
        return f"none of {len(steps)} steps to the next width raises the return"
    a, b = max(better, key=lambda pair: means[pair[1]] - means[pair[0]])
    return (
        f"{len(better)} of {len(steps)} steps to the next width raise{'s' if len(better) == 1 else ''} the return, "
        f"most at n = {a.n} from w = {a.w:g} to {b.w:g} ({signed(means[b] - means[a])})"
    )


def starts(
    seeds: Sequence[int] = SEEDS,
    ours: Outcomes | None = None,
    main_points: Collection[str] = ("main",),
    optima: Callable[[Sequence[int]], Sequence[float]] | None = None,
) -> Claim:
    """Do seeds have start states of their own, and what changes where they do?

    main_points: operating points on the paper's main plant, of whose cells the best one is told; optima: mean return of
    the near-optimal policy there for such seeds, from the start states that they share and from those that they do not.
    """
    states, total = distinct_starts(seeds)
    text = (
        "Episode e of seed s starts from generator s + 50,000 + e, so neighbouring seeds share all but one of their "
        f"start states: {total} evaluations of a cell stand on {states} distinct ones, and an error over seeds "
        "leaves out most of what other start states would change."
    )
    if ours and (spots := [spot for spot in ours.table if np.isfinite(ours.returns(spot, fresh=True)).all()]):
        moved = [ours.summary(spot, fresh=True).mean - ours.summary(spot).mean for spot in spots]
        text += (
            f" From start states that no two seeds share, the mean moves by {signed(float(np.mean(moved)))} over "
            f"{len(spots)} cells, from {signed(min(moved))} to {signed(max(moved))}."
        )
        if there := [spot for spot in spots if spot.point in main_points]:
            text += _best(ours, max(there, key=lambda spot: ours.summary(spot).mean), optima)
        text += _changed(ours, spots)
    return Claim("starts", IN_PART if states < total else HOLDS, text)


def _best(ours: Outcomes, best: Spot, optima: Callable[[Sequence[int]], Sequence[float]] | None) -> str:
    """What the best cell returns from both kinds of start states, and how far that is from the optimum of its seeds."""
    cells = ours.summary(best), ours.summary(best, fresh=True)
    shared, fresh = (f"{number(cell.mean)} ± {cell.sem:.1f}" for cell in cells)
    text = f" The best cell (n = {best.n}, w = {best.w:g}) returns {fresh} there instead of {shared}"
    if optima is None:
        return f"{text}."
    values = optima(ours.seeds(best))
    gaps = [100.0 * (j - cell.mean) / abs(j) for j, cell in zip(values, cells, strict=True)]
    return (
        f"{text}; the optimum goes from {number(values[0])} to {number(values[1])}, and the cell is {gaps[1]:.1f} % "
        f"short of it instead of {gaps[0]:.1f} %."
    )


def _changed(ours: Outcomes, spots: Sequence[Spot]) -> str:
    """Which published contrasts say something else from start states that no two seeds share."""
    pairs = [c for c in DIFFERENCES if c.a in spots and c.b in spots]
    if not pairs:
        return ""
    changes = []
    for c in pairs:
        shared, fresh = (paired_t(*ours.pair(c.a, c.b, fresh=f)) for f in (False, True))
        if (shared.significant, shared.mean > 0.0) != (fresh.significant, fresh.mean > 0.0):
            changes.append(f"{c.label} ({shared} becomes {fresh})")
    listed = f"; these do: {', '.join(changes)}." if changes else "."
    same = len(pairs) - len(changes)
    return f" Of {len(pairs)} published contrasts {same} change neither in sign nor in significance{listed}"


def distinct_starts(seeds: Sequence[int] = SEEDS) -> tuple[int, int]:
    """(distinct start states, evaluations) of these seeds."""
    from policies.evaluation import start_states

    drawn = [state for seed in seeds for state in np.stack(start_states(seed), axis=1).tolist()]
    return len(set(map(tuple, drawn))), len(drawn)


def undertraining(
    curves: Mapping[float, Sequence[Curve]], n: int, steps: int, longer: tuple[Contrast, int] | None = None
) -> Claim:
    """Is the widest band under-trained?

    curves: by width, of the runs with n rollouts and `steps` training steps; longer: the change of the return on the
    hidden plant at the widest band when training goes on, and to how many steps.
    """
    slopes = {w: slope(group) for w, group in sorted(curves.items())}
    wide = slopes[max(slopes)]
    parts = " and ".join(f"{_fine(rise, 1)} at w = {w:g}" for w, rise in slopes.items())
    text = (
        f"Over the last third of {steps:,} steps at n = {n} the training return rises per 10,000 steps by {parts} "
        f"({wide.seeds} seeds)."
    )
    if longer is None:
        text += " Whether more steps help on the hidden plant is what --preset longer and longer-small find out."
        return Claim("undertraining", IN_PART if wide.low > 0.0 else OPEN, text)
    gain, long = longer
    text += f" With {long:,} steps the return on the hidden plant changes by {gain} at the widest band."
    return Claim("undertraining", HOLDS if gain.low > 0.0 else FAILS if gain.significant else OPEN, text)


def slope(curves: Sequence[Curve]) -> Contrast:
    """Rise of the training return per 10,000 steps over the last third of training, with its t interval over seeds."""
    return paired_t([_slope(np.array(curve, dtype=float)) for curve in curves])


def _slope(curve: NDArray[np.float64]) -> float:
    steps, returns = curve[curve[:, 0] >= (1.0 - 1.0 / 3.0) * curve[-1, 0]].T
    if len(steps) < 2:
        return 0.0
    return float(1e4 * np.polyfit(steps - steps.mean(), returns, 1)[0])


def _fine(contrast: Contrast, digits: int = 3) -> str:
    return bracketed(contrast.mean, contrast.low, contrast.high, digits, signed)
