"""Whether a run of ours and the published one agree: judged cell by cell and contrast by contrast, never asserted.

    difference of a cell = mean(ours - theirs), paired over seeds where the authors' files are given and theta_hat is
                           the same (the start states are, too), else Welch's from the published mean and error
    same                   its 90 % interval lies within +- MARGIN (two one-sided tests at 5 %)
    differs                its 95 % interval excludes zero, and it is not the same
    open                   neither: these seeds cannot tell
    contrasts agree        where both are significant and of one sign, or neither is

Source of the equivalence test: Schuirmann, J. Pharmacokinet. Biopharm. 15 (1987) 657.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from study.formatting import number
from study.paper.finished_runs import TOLERANCE, Outcomes
from study.paper.presets import PAPER, Preset
from study.paper.published_numbers import BASELINE, CELLS, DIFFERENCES, POINTS, CellSummary, PublishedContrast, Spot
from study.statistics import Contrast, holm, paired_bootstrap, paired_t, student, welch

MARGIN = 20.0
"""Returns closer than this count as the same: a twentieth of what the paper's 50 rollouts were worth (434)."""
SAME, DIFFERS, OPEN = "same", "differs", "open"


@dataclass(frozen=True)
class Outlier:
    """The seed that moves a cell's difference most, its paired difference, and the interval without it."""

    seed: int
    difference: float
    rest: Contrast


@dataclass(frozen=True)
class CellAgreement:
    """A cell here, there as it is printed, and here from fresh start states. `basis` says how the difference was taken;
    `verdict` is same, differs or open."""

    spot: Spot
    ours: CellSummary
    printed: CellSummary
    fresh: CellSummary
    difference: Contrast
    verdict: str
    basis: str
    outlier: Outlier | None


@dataclass(frozen=True)
class ContrastAgreement:
    """A published contrast with its bootstrap and t intervals here and there, and Holm's p over all that are published.

    ours and ours_t are None where a cell of it was not run; change is the contrast here minus there, where runs pair.
    """

    published: PublishedContrast
    theirs: Contrast
    theirs_t: Contrast
    theirs_holm: float
    ours: Contrast | None
    ours_t: Contrast | None
    ours_holm: float
    change: Contrast | None = None

    @property
    def agrees(self) -> bool | None:
        """Both significant with one sign, or neither, by the paper's own rule; None where it was not run."""
        if self.ours is None:
            return None
        if self.ours.significant and self.theirs.significant:
            return self.ours.mean * self.theirs.mean > 0.0
        return not (self.ours.significant or self.theirs.significant)

    @property
    def survives(self) -> bool:
        """Whether a published claim of significance stands with t and Holm."""
        return self.theirs.significant and self.theirs_holm < 0.05


@dataclass(frozen=True)
class RobustnessRow:
    """A row of Table I, whose two differences are published contrasts: delta-budget and delta-wide.

    printed     mean of the best cell there; wider: whether a wider band is significantly better without data there
    best, mean  the best cell here; zero: the best one without data, and gain: over w = 0. None: not run, or w = 0
    """

    point: str
    printed: float | None
    budget: ContrastAgreement
    wide: ContrastAgreement
    wider: bool
    best: Spot | None
    mean: float | None
    zero: Spot | None
    gain: Contrast | None


@dataclass(frozen=True, eq=False)
class Agreement:
    """Our runs, of a preset, against the published ones. `theirs` is None without the authors' files: then nothing is
    paired."""

    ours: Outcomes
    theirs: Outcomes | None = None
    preset: Preset = PAPER

    @cached_property
    def cells(self) -> list[CellAgreement]:
        """Every published cell that was run here."""
        return [self._cell(spot) for spot in CELLS if spot in self.ours]

    def _cell(self, spot: Spot) -> CellAgreement:
        ours, theirs, outlier = self.ours.summary(spot), CELLS[spot].summary, None
        seeds, obstacle = self._pairs(spot)
        if self.theirs is None or obstacle:
            sides = (ours.mean, ours.sem, ours.seeds), (theirs.mean, theirs.sem, theirs.seeds)
            difference, narrow, basis = welch(*sides), welch(*sides, level=0.9), f"unpaired (Welch): {obstacle}"
        else:
            a, b = self.ours.returns(spot, seeds), self.theirs.returns(spot, seeds)
            theirs, outlier = self.theirs.summary(spot), _outlier(a - b, seeds)
            difference, narrow, basis = paired_t(a, b), paired_t(a, b, level=0.9), f"paired over {len(seeds)} seeds"
        verdict = DIFFERS if difference.significant else OPEN
        if max(abs(narrow.low), abs(narrow.high)) <= MARGIN:
            verdict = SAME
        text, fresh = CELLS[spot].printed, self.ours.summary(spot, fresh=True)
        printed = theirs if text is None else theirs._replace(mean=text)
        return CellAgreement(spot, ours, printed, fresh, difference, verdict, basis, outlier)

    def _pairs(self, spot: Spot) -> tuple[tuple[int, ...], str]:
        """The seeds to pair over, or why there is no pairing."""
        if self.theirs is None:
            return (), "without the authors' files"
        if spot not in self.theirs:
            return (), "their file is not there"
        if self.preset.episodes != PAPER.episodes:
            return (), "other start states"
        if spot not in self.ours:
            return (), "not run here"
        seeds = tuple(s for s in self.ours.seeds(spot) if s in self.theirs.table[spot])
        if len(seeds) < 2:
            return (), "fewer than two shared seeds"
        pairs = ((self.ours.table[spot][s].theta_hat, self.theirs.table[spot][s].theta_hat) for s in seeds)
        apart = [s for s, (a, b) in zip(seeds, pairs, strict=True) if math.dist(a, b) > TOLERANCE]
        return seeds, f"other theta_hat at seed {apart[0]}" if apart else ""

    @cached_property
    def contrasts(self) -> list[ContrastAgreement]:
        """Every published contrast; Holm's correction is over all of them there, over those that were run here."""
        theirs_t = {c: student(c.mean, c.error, c.seeds) for c in DIFFERENCES}
        ours = {c: self.contrast(c.a, c.b) or (None, None) for c in DIFFERENCES}
        theirs_holm = holm({c: t.p for c, t in theirs_t.items()})
        ours_holm = holm({c: t.p for c, (_, t) in ours.items() if t})
        return [
            ContrastAgreement(
                c, Contrast(c.mean, c.low, c.high, c.seeds), theirs_t[c], theirs_holm[c], *ours[c],
                ours_holm.get(c, math.nan), self._change(c),
            )
            for c in DIFFERENCES
        ]  # fmt: skip

    def _change(self, contrast: PublishedContrast) -> Contrast | None:
        (seeds_a, obstacle_a), (seeds_b, obstacle_b) = self._pairs(contrast.a), self._pairs(contrast.b)
        seeds = sorted({*seeds_a} & {*seeds_b})
        if self.theirs is None or obstacle_a or obstacle_b or len(seeds) < 2:
            return None
        here, there = (s.returns(contrast.a, seeds) - s.returns(contrast.b, seeds) for s in (self.ours, self.theirs))
        return paired_t(here, there)

    def contrast(self, a: Spot, b: Spot) -> tuple[Contrast, Contrast] | None:
        """Our bootstrap and t contrasts of two cells over the seeds they share; None where there are none."""
        if a not in self.ours or b not in self.ours or not self.ours.seeds(a, b):
            return None
        x, y = self.ours.pair(a, b)
        return paired_bootstrap(x, y, resamples=self.preset.resamples), paired_t(x, y)

    @cached_property
    def robustness(self) -> list[RobustnessRow]:
        """Table I, row by row."""
        known = {(c.published.a, c.published.b): c for c in self.contrasts}
        return [self._row(point, known) for point in POINTS if point != BASELINE.point]

    def _row(self, point: str, known: Mapping[tuple[Spot, Spot], ContrastAgreement]) -> RobustnessRow:
        full, start = Spot(point, 50, 0.0), Spot(point, 0, 0.0)
        wider = any(c.significant and c.mean > 0.0 for c in DIFFERENCES if c.b == start and c.a[:2] == start[:2])
        means = {spot: self.ours.summary(spot).mean for spot in self.ours.table if spot.point == point}
        best = max(means, key=means.__getitem__, default=None)
        zero = max((spot for spot in means if spot.n == 0), key=means.__getitem__, default=None)
        gain = self.contrast(zero, start) if zero and zero != start else None
        return RobustnessRow(
            point, CELLS[full].printed, known[full, start], known[full, Spot(point, 50, 0.5)], wider,
            best, means[best] if best else None, zero, gain[0] if gain else None,
        )  # fmt: skip

    def sentences(self) -> list[tuple[str, str]]:
        """(question, answer): do the cells, the contrasts and the claims of significance agree?"""
        said = {
            "Do the returns agree?": self._cells_in_words(),
            "Do the conclusions agree?": self._contrasts_in_words(),
            "Does covering the truth replace measuring it?": self._baseline_in_words(),
            "Which published claims of significance stand?": self.significance(),
        }
        return [(question, text) for question, text in said.items() if text]

    def _cells_in_words(self) -> str:
        if not self.cells:
            return ""
        count = {v: sum(c.verdict == v for c in self.cells) for v in (SAME, DIFFERS, OPEN)}
        median = float(np.median([abs(c.difference.mean) for c in self.cells]))
        text = (
            f"Of {len(CELLS)} published cells {len(self.cells)} were run here: {count[SAME]} are the same within "
            f"±{MARGIN:.0f}, {count[DIFFERS]} differ and {count[OPEN]} stay open, for their seeds scatter too much. "
            f"The median distance of two means is {median:.0f}."
        )
        if len(self.cells) < 1.0 / 0.05:
            return text
        return f"{text} At 95 % about {0.05 * len(self.cells):.0f} would seem to differ by chance alone."

    def _contrasts_in_words(self) -> str:
        ran = [c for c in self.contrasts if c.agrees is not None]
        if not ran:
            return ""
        apart = [c.published.label for c in ran if not c.agrees]
        return (
            f"Of {len(self.contrasts)} published contrasts {len(ran)} were run here, and {len(ran) - len(apart)} agree "
            "in significance and sign" + (f"; these do not: {'; '.join(apart)}." if apart else ".")
        )

    def _baseline_in_words(self) -> str:
        if BASELINE not in self.ours:
            return ""
        ours, theirs = self.ours.summary(BASELINE), CELLS[BASELINE]
        parts = [
            f"against n = {c.published.b.n}, w = {c.published.b.w:g} that is {c.theirs} there and {c.ours} here"
            for c in self.contrasts
            if c.published.a == BASELINE and c.ours
        ]
        return (
            f"Trained over the whole prior range, which covers the truth, and without data the agents returned "
            f"{number(theirs.printed)} ± {theirs.sem:.0f} there and {ours.with_error} here"
            f"{'; ' if parts else ''}{', '.join(parts)}."
        )

    def significance(self) -> str:
        """How many of the published claims stand with t intervals, and how many with Holm's correction."""
        claimed = [c for c in self.contrasts if c.published.significant]
        narrow = [c for c in claimed if c.published.b.w == 0.2]
        return (
            f"Over so few seeds the bootstrap is narrow. Of {len(claimed)} contrasts that the paper calls significant, "
            f"{sum(c.theirs_t.significant for c in claimed)} keep a t interval without zero and "
            f"{sum(c.survives for c in claimed)} survive Holm's correction over all {len(self.contrasts)}. Of the "
            f"{len(narrow)} 'w = 0 beats w = 0.2', {sum(c.theirs_t.significant for c in narrow)} keeps it with t and "
            f"{sum(c.survives for c in narrow) or 'none'} with Holm."
            + _ours_in_words([c.ours_t for c in narrow if c.ours_t])
        )


def _ours_in_words(narrow: Sequence[Contrast]) -> str:
    if not narrow:
        return ""
    kept = sum(t.significant for t in narrow)
    return f" Here {kept or 'none'} of the {len(narrow)} that were run keep{'s' * (kept == 1)} it with t."


def _outlier(difference: np.ndarray, seeds: Sequence[int]) -> Outlier | None:
    if len(seeds) < 3:
        return None
    k = int(np.argmax(np.abs(difference - np.median(difference))))
    rest = np.delete(difference, k)
    return Outlier(seeds[k], float(difference[k]), paired_t(rest))
