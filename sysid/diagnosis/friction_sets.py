"""Friction sets: all sets of common frictions in place of those that were named, and how likely they are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from sysid.diagnosis.criteria import excess_of, is_lowered, is_plausible, squared_size
from sysid.diagnosis.explanation import Explanation
from sysid.diagnosis.search import Addition
from sysid.estimation.energy_balance import FRICTIONS
from sysid.estimation.likelihood import p_value
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import balanced, settled


@dataclass(frozen=True, eq=False)
class FrictionSets:
    """The sets of common frictions that may take the place of those in an explanation.

    A search adds one friction after the other, and stays with the first one where two explain more together.

    named  the explanation whose frictions are compared to others
    """

    named: Explanation

    @property
    def frictions(self) -> dict[str, Addition]:
        """The common frictions that are named."""
        return {a.name: a for a in self.named.additions if a.name in FRICTIONS}

    @property
    def beside(self) -> list[Addition]:
        """The other additions."""
        return [a for a in self.named.additions if a.name not in FRICTIONS]

    @property
    def comparable(self) -> bool:
        """Whether there are others. A free swing has them even if no friction is named, since it always loses energy.
        A driven log has none where likelihood has decided, since the model needs no random torque."""
        return not self.named.fit.samples.driven or bool(self.frictions and not self.named.fit.undisturbed)

    def others(self, without: Fit) -> Iterator[tuple[Sequence[Addition], Fit]]:
        """The additions with each other set, and their fit; `without` is the fit without the named frictions."""
        search, known, beside = self.named.evidence.search, self.frictions, self.beside
        first = min(map(self.named.additions.index, known.values()), default=len(beside))
        fewer = balanced(without, self.named.fit.balance)
        tested = search.tested(fewer)
        possible = [n for n in FRICTIONS if n in known or (n in tested and tested[n].visible)]
        sets = (names for k in range(1, len(possible) + 1) for names in combinations(possible, k))
        for names in (n for n in sets if set(n) != set(known)):
            for trial in search.trial(fewer, names):
                fit = settled(trial.fit)
                p = p_value(fewer.deviance - fit.deviance, len(names))
                new = [known.get(n) or Addition(n, search.inseparable(n), (), p) for n in names]
                yield (*beside[:first], *new, *beside[first:]), fit

    def loss(self, other: Explanation) -> float:
        """By how much another set is less likely than the named one: the rise of the deviance, divided by the larger
        excess of the two, and the price of its numbers. All of FRICTIONS are as common here."""
        excess = max(excess_of(e.fit, FRICTIONS) for e in (other, self.named))
        more = len(other.additions) - len(self.named.additions)
        return (other.fit.deviance - self.named.fit.deviance) / excess + self.named.evidence.settings.price * more


def least_size(explanation: Explanation) -> float:
    """The least squared size of the common frictions of an explanation; 0 if it has none, or one is not determined."""
    sizes = (squared_size(explanation.fit, n) for n in explanation.names if n in FRICTIONS)
    return float(min(map(np.nan_to_num, sizes), default=0.0))


def is_as_good(other: Explanation, named: Explanation) -> bool:
    """Whether another set of frictions is plausible, with sizes beyond their standard deviations, and predicts held-out
    data no worse by what matters."""
    worse = is_lowered(named.error.ratio, other.error.ratio, named.evidence.settings.tolerance)
    return least_size(other) > 1.0 and is_plausible(other.fit, other.names) and not worse
