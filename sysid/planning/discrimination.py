"""Discrimination: what signals are worth when hypotheses are really fitted to what the truth would show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.solver import fit
from sysid.planning.design import KNOWN, Conditions, Hypothesis, Pool, predict, within_limits
from sysid.planning.hypotheses import Pair
from sysid.planning.signals import Signal, draw

STRUCTURAL = 1e-4
"""Share of an effect's evidence that no rival takes, below which no torque will ever tell the two apart."""

NESTED = 1e-2
"""The same where the rival was really fitted, which need not have come to its end."""


class Discrimination(NamedTuple):
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
    conditions: Conditions

    def followed(self, truth: int) -> Fit:
        """What a truth would show, without noise and disturbances, and its motion."""
        if truth not in self._followed:
            model, conditions = self.hypotheses[truth].model, self.conditions
            samples = Samples(model, predict(model, self.signals, conditions), conditions.sensor)
            self._followed[truth] = fit(samples, model, (), None, conditions.disturbances, KNOWN)
        return self._followed[truth]

    def left(self, truth: int, rival: int) -> float:
        """The sum of squared innovations that the rival leaves of the truth when it is fitted to what that shows."""
        if (truth, rival) not in self._left:
            other, near = self.hypotheses[rival], self.followed(truth)
            found = fit(near.samples, other.model, other.names, near, self.conditions.disturbances, KNOWN)
            self._left[truth, rival] = float(np.sum(found.e**2))
        return self._left[truth, rival]

    @cached_property
    def _followed(self) -> dict[int, Fit]:
        return {}

    @cached_property
    def _left(self) -> dict[tuple[int, int], float]:
        return {}

    def contests(self, within: float = math.inf) -> tuple[Discrimination, ...]:
        """The evidence of each pair; those whose first-order number is over `within` times the least keep it."""
        pool = Pool(self.hypotheses, self.signals, self.conditions)
        linear = {p: float(pool.unlike(p.truth, p.rival).together().unexplained()[0]) for p in self.pairs}
        least, found = math.inf, []
        for p in sorted(linear, key=lambda p: linear[p]):
            after = linear[p]
            if after < within * least:
                after = self.left(p.truth, p.rival)
                least = min(least, after)
            found.append(Discrimination(self.hypotheses[p.truth].name, self.hypotheses[p.rival].name, p.before, after))
        return tuple(found)

    @cached_property
    def worth(self) -> float:
        """The least evidence of any pair."""
        return min(c.after for c in self.contests(within=1.5))


def separable(
    hypotheses: tuple[Hypothesis, ...],
    pairs: Sequence[Pair],
    conditions: Conditions,
    rng: np.random.Generator,
) -> tuple[Pair, ...]:
    """The pairs that some torque tells apart: not those of which the rival holds the truth as a special case.

    The last hypothesis is that of no effect: what sets a pair apart is compared with what the truth does alone.
    """
    signals = draw(rng, conditions.limits, hypotheses[0].model.dt, 8, swings=False)
    signals = within_limits(hypotheses, signals, conditions)
    some = tuple([s for s in signals if s.kind in ("steps", "bang-bang")][:1])
    pool, match = Pool(hypotheses, signals, conditions), Match(hypotheses, tuple(pairs), some, conditions)
    nothing, found = len(hypotheses) - 1, []
    for p in pairs:
        if len(hypotheses[p.rival].names) > len(hypotheses[p.truth].names):
            # through a kink a tangent does not see that one is a special case of the other: a fit does
            apart = match.left(p.truth, p.rival) > NESTED * match.left(p.truth, nothing)
        else:
            alone, against = (pool.unlike(p.truth, k).unexplained() for k in (nothing, p.rival))
            apart = bool(np.any(against > STRUCTURAL * alone))
        if apart:
            found.append(p)
    return tuple(found)


def indistinguishable(pairs: Sequence[Pair], apart: Sequence[Pair]) -> dict[int, int]:
    """Hypotheses that no torque tells from an earlier one, by number, with that one."""
    asked, told = ({(p.truth, p.rival) for p in some} for some in (pairs, apart))
    return {j: i for i, j in sorted(asked, reverse=True) if i < j and (j, i) in asked and not {(i, j), (j, i)} & told}
