"""Discrimination: what signals are worth when hypotheses are really fitted to what the truth would show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.solver import fit_parameters
from sysid.planning.design import KNOWN, Conditions, Hypothesis, Pool, predict, within_limits
from sysid.planning.hypotheses import NOTHING, Pair
from sysid.planning.signals import random_signals

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


class Match:
    """Pairs of hypotheses, each fitted to what the other would show under the signals of a pool."""

    def __init__(self, pool: Pool, pairs: Sequence[Pair]) -> None:
        self.pool, self.pairs, self.disturbances = pool, tuple(pairs), pool.conditions.disturbances
        self._followed: dict[str, Fit] = {}
        self._left: dict[tuple[str, str], float] = {}

    def followed(self, truth: str) -> Fit:
        """What a truth would show, without noise and disturbances, and its motion."""
        if truth not in self._followed:
            model, conditions = self.pool.hypotheses[truth].model, self.pool.conditions
            samples = Samples(model, predict(model, self.pool.signals, conditions), conditions.sensor)
            self._followed[truth] = fit_parameters(samples, model, (), None, self.disturbances, KNOWN)
        return self._followed[truth]

    def left(self, truth: str, rival: str) -> float:
        """The sum of squared innovations that the rival leaves of the truth when it is fitted to what that shows."""
        if (truth, rival) not in self._left:
            other, near = self.pool.hypotheses[rival], self.followed(truth)
            found = fit_parameters(near.samples, other.model, other.names, near, self.disturbances, KNOWN)
            self._left[truth, rival] = float(np.sum(found.e**2))
        return self._left[truth, rival]

    def contests(self, within: float = math.inf) -> tuple[Discrimination, ...]:
        """The evidence of each pair; those whose first-order number is over `within` times the least keep it."""
        linear = {p: float(self.pool.unlike(p.truth, p.rival).together().unexplained()[0]) for p in self.pairs}
        least, found = math.inf, []
        for p in sorted(linear, key=lambda p: linear[p]):
            after = linear[p]
            if after < within * least:
                after = self.left(p.truth, p.rival)
                least = min(least, after)
            found.append(Discrimination(p.truth, p.rival, p.before, after))
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

    What sets a pair apart is compared with what the truth does alone, beside the hypothesis of no effect.
    """
    signals = random_signals(rng, conditions.limits, hypotheses[0].model.dt, 8, swings=False)
    signals = within_limits(hypotheses, signals, conditions)
    some = [s for s in signals if s.kind in ("steps", "bang-bang")][:1]
    pool, match, found = Pool(hypotheses, signals, conditions), Match(Pool(hypotheses, some, conditions), pairs), []
    for p in pairs:
        if len(pool.hypotheses[p.rival].names) > len(pool.hypotheses[p.truth].names):
            # through a kink a tangent does not see that one is a special case of the other: a fit does
            apart = match.left(p.truth, p.rival) > NESTED * match.left(p.truth, NOTHING)
        else:
            alone, against = (pool.unlike(p.truth, other).unexplained() for other in (NOTHING, p.rival))
            apart = bool(np.any(against > STRUCTURAL * alone))
        if apart:
            found.append(p)
    return tuple(found)


def indistinguishable(pairs: Sequence[Pair], apart: Sequence[Pair]) -> dict[str, str]:
    """Hypotheses that no torque tells from an earlier one, with that one."""
    order, told = list(dict.fromkeys(p.truth for p in pairs)), {frozenset((p.truth, p.rival)) for p in apart}
    alike = (p for p in reversed(pairs) if frozenset((p.truth, p.rival)) not in told)
    return {p.truth: p.rival for p in alike if p.rival in order[: order.index(p.truth)]}
