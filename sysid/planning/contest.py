"""Contest: what signals are worth when rivals are really fitted to what the truth would show, beyond first order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.identify.gauss_newton import fit_longest, fit_windows
from sysid.planning.design import Hypothesis, Pool, foresee, tamed
from sysid.planning.rivals import Pair
from sysid.planning.signals import Limits, Signal, draw
from sysid.records import Record
from sysid.sensor import Sensor

STRUCTURAL = 1e-4
"""Share of an effect's evidence that no rival takes, below which no torque will ever tell the two apart."""

NESTED = 1e-2
"""The same where the rival was really fitted, which need not have come to its end."""

SHORTEST = 2.0
"""Length [s] of the shortest windows to which hypotheses are fitted here."""


class Contest(NamedTuple):
    """Evidence of `truth` against `rival`, were it true: on the log at hand (None: no log) and of the experiment."""

    truth: str
    rival: str
    before: float | None
    after: float


@dataclass(frozen=True, eq=False)
class Match:
    """Signals that are played to hypotheses; the last of them is the model with no rival in it."""

    hypotheses: tuple[Hypothesis, ...]
    pairs: tuple[Pair, ...]
    signals: tuple[Signal, ...]
    limits: Limits
    sensor: Sensor

    @cached_property
    def shown(self) -> dict[int, list[Record]]:
        """What each truth would show, without noise."""
        truths = {p.truth for p in self.pairs}
        return {i: foresee(self.hypotheses[i].model, self.signals, self.limits, self.sensor).records for i in truths}

    @cached_property
    def horizon(self) -> float:
        """The longest windows [s] on which the model with no rival follows each truth, as a diagnosis must; or 0."""
        base, found = self.hypotheses[-1], math.inf
        for records in self.shown.values():
            fit = fit_longest(base.model, base.names, records, self.sensor, base.p, shortest=SHORTEST)
            found = min(found, fit.horizon if fit.follows else 0.0)
        return found

    def left(self, truth: int, rival: int, horizon: float) -> float:
        """The sum of squares that the rival leaves of the truth when it is fitted to windows of that length [s]."""
        key = (truth, rival, horizon)
        if key not in self._left:
            self._left[key] = self._refitted(*key)
        return self._left[key]

    @cached_property
    def _left(self) -> dict[tuple[int, int, float], float]:
        return {}

    def _refitted(self, truth: int, rival: int, horizon: float) -> float:
        other, records = self.hypotheses[rival], self.shown[truth]
        fit = fit_windows(other.model, other.names, records, self.sensor, SHORTEST, other.p)
        if horizon > SHORTEST:
            fit = fit_windows(other.model, other.names, records, self.sensor, horizon, fit.solution.p, fit)
        return 2.0 * fit.solution.lin.cost

    def contests(self, within: float = math.inf) -> tuple[Contest, ...]:
        """The evidence of each pair; those whose first-order number is over `within` times the least keep it."""
        pool = Pool(self.hypotheses, self.signals, self.limits, self.sensor)
        linear = {p: float(pool.unlike(p.truth, p.rival).together().unexplained()[0]) for p in self.pairs}
        least, found = math.inf, []
        for p in sorted(linear, key=lambda p: linear[p]):
            after = linear[p]
            if after < within * least:
                after = self.left(p.truth, p.rival, self.horizon or SHORTEST)
                least = min(least, after)
            found.append(Contest(self.hypotheses[p.truth].name, self.hypotheses[p.rival].name, p.before, after))
        return tuple(found)

    @cached_property
    def worth(self) -> tuple[bool, float]:
        """Whether a diagnosis could begin, and the least evidence of any pair."""
        return self.horizon > 0.0, min(c.after for c in self.contests(within=1.5))


def separable(
    hypotheses: tuple[Hypothesis, ...],
    pairs: Sequence[Pair],
    limits: Limits,
    sensor: Sensor,
    rng: np.random.Generator,
) -> tuple[Pair, ...]:
    """The pairs that some torque tells apart: not those of which the rival holds the truth as a special case.

    The last hypothesis is that of no effect: what sets a pair apart is compared with what the truth does alone.
    """
    signals = tamed(hypotheses, draw(rng, limits, hypotheses[0].model.dt, 8, swings=False), limits, sensor)
    some = tuple([s for s in signals if s.kind in ("steps", "bang-bang")][:1])
    pool, match = Pool(hypotheses, signals, limits, sensor), Match(hypotheses, tuple(pairs), some, limits, sensor)
    nothing, found = len(hypotheses) - 1, []
    for p in pairs:
        if len(hypotheses[p.rival].names) > len(hypotheses[p.truth].names):
            # through a kink a tangent does not see that one is a special case of the other: a fit does
            apart = match.left(p.truth, p.rival, math.inf) > NESTED * match.left(p.truth, nothing, math.inf)
        else:
            alone, against = (pool.unlike(p.truth, k).unexplained() for k in (nothing, p.rival))
            apart = bool(np.any(against > STRUCTURAL * alone))
        if apart:
            found.append(p)
    return tuple(found)


def twins(pairs: Sequence[Pair], apart: Sequence[Pair]) -> dict[int, int]:
    """Hypotheses that no torque tells from an earlier one, by number, with that one."""
    asked, told = ({(p.truth, p.rival) for p in some} for some in (pairs, apart))
    return {j: i for i, j in sorted(asked, reverse=True) if i < j and (j, i) in asked and not {(i, j), (j, i)} & told}
