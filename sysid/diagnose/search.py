"""The search: screen, confirm by refit, add, try to drop and to swap, until nothing more is warranted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from sysid.diagnose.directions import Directions
from sysid.diagnose.flexible import Dependence, bases, dependences
from sysid.diagnose.refits import at_horizon, extend, gain, grow, reduce_by
from sysid.diagnose.screen import Score, alikeness, screen
from sysid.effects import CATALOGUE
from sysid.holm import holm
from sysid.identify.gauss_newton import Fit
from sysid.records import Record

LEVEL = 0.05
"""Family-wise error rate over all candidates and flexible probes of a round."""

SAME = 1.0 - 1e-6
"""Alikeness from which two effects are the same to any log of this kind; only the first of them is fitted."""

ALIKE = 0.995
"""Alikeness from which it takes 100 times the evidence to tell two effects that it takes to find one."""

PREFERRED = ("stamp", "tilt", "viscous", "delay")
"""Where effects are the same to a log, these stand for their class: the log's own convention before any machine's."""

CLOSE = 3.0
"""Difference of -2 log likelihood below which two effects explain a log equally well."""

EXPLAINS = 0.35
"""Share of what flexible torques explain that an effect must explain; below, it only imitates something unknown."""

MOST = 0.8
"""Share of the same from which an effect is more than an imitation: it may gain unevenly, and stands beside what is
unknown."""

MOST_STEPS = 6
MOST_REFITS = 4


@dataclass(frozen=True, eq=False)
class Round:
    """One screen about one fit: scores, Holm's p-values, and what flexible torques say."""

    fit: Fit
    scores: dict[str, Score]
    flexible: dict[str, Dependence]
    adjusted: dict[str, float]

    @classmethod
    def of(cls, fit: Fit, names: Iterable[str] | None) -> Round:
        """All candidates and all flexible probes, one family."""
        scores, directions = screen(fit, names)
        flexible = dependences(directions, fit.response.clusters())
        family = {name: s.p_value for name, s in scores.items() if s.visible}
        family |= {f"~{name}": d.p_value for name, d in flexible.items()}
        return cls(fit, scores, flexible, holm(family))

    @property
    def warranted(self) -> list[str]:
        """Candidates that are significant, best first."""
        found = [n for n, p in self.adjusted.items() if p < LEVEL and not n.startswith("~")]
        return sorted(found, key=self.merit, reverse=True)

    @property
    def structured(self) -> list[str]:
        """Quantities on which flexible torques find that the residual depends, the most telling first."""
        found = [n[1:] for n, p in self.adjusted.items() if p < LEVEL and n.startswith("~")]
        return sorted(found, key=lambda n: self.flexible[n].gain, reverse=True)

    @property
    def left(self) -> bool:
        """Whether anything is significant."""
        return any(p < LEVEL for p in self.adjusted.values())

    def merit(self, name: str) -> float:
        """Expected decrease of -2 log likelihood, less the price of the magnitudes."""
        score = self.scores[name]
        return score.lm - len(score.sizes) * math.log(self.fit.degrees)


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate that was fitted: its alternative models compare by `merit`, -2 log likelihood and price."""

    name: str
    fit: Fit
    score: Score
    p_value: float

    def merit(self, variance: float) -> float:
        """-(2 cost / s^2 + P log n): larger is better."""
        return -(2.0 * self.fit.solution.lin.cost / variance + len(self.fit.names) * math.log(self.fit.degrees))


@dataclass(frozen=True, eq=False)
class Addition:
    """An effect that was added: its name, those that this log cannot tell from it, its Holm p-value, the fit with it.

    same   effects whose readings are its own on this log, whatever the sizes
    close  effects that explain the log about as well and are something else
    """

    name: str
    same: tuple[str, ...]
    close: tuple[str, ...]
    p_value: float
    fit: Fit


@dataclass(eq=False)
class Search:
    """Forward, backward and swap over effects. `names`: which of the catalogue may be used (None: all)."""

    records: Sequence[Record]
    names: Iterable[str] | None = None
    additions: list[Addition] = field(default_factory=list)
    rounds: list[Round] = field(default_factory=list)
    taken_back: set[str] = field(default_factory=set)
    first_trials: list[Trial] = field(default_factory=list)
    first_choice: str = ""
    reviewed_at: float = math.inf

    def run(self, fit: Fit) -> Fit:
        """The fit at the end of the loop; `additions` and `rounds` tell the way."""
        self.reviewed_at = fit.horizon
        for _ in range(MOST_STEPS):
            now = Round.of(fit, self.names)
            self.rounds.append(now)
            trials = self.trials(now)
            chosen = self._choose(now, trials)
            if len(self.rounds) == 1:
                self.first_trials, self.first_choice = trials, chosen.name if chosen else ""
            if chosen is None:
                reviewed = self._review(now)
                if reviewed is fit:
                    reviewed = self._prune(now)
                if reviewed is fit:
                    break
                fit = reviewed
                continue
            self.additions.append(self._addition(chosen, trials, now))
            fit = grow(chosen.fit)
        else:
            self.rounds.append(Round.of(fit, self.names))
        return fit

    def trials(self, now: Round, full: Fit | None = None) -> list[Trial]:
        """The most promising candidates, refitted at the round's horizon; of those that are the same, the first whose
        bounds let it act as the log asks.

        Where the round leaves an effect out of a `full` fit, that fit's numbers are where the others begin too.
        """
        found: list[Trial] = []
        warranted = now.warranted
        if not warranted:
            return found
        best = now.scores[warranted[0]].lm
        for name in warranted:
            score = now.scores[name]
            if len(found) >= MOST_REFITS or (found and score.lm < 0.5 * best):
                break
            if name in self.taken_back or any(twins(score, t.score) and not confined(t) for t in found):
                continue
            for own in (self._representative(score, now), score):
                if all(own.name != t.name for t in found):
                    found.append(Trial(own.name, extend(now.fit, own, full), own, now.adjusted[own.name]))
                    if not confined(found[-1]):
                        break
        for simpler in self._simpler(found, warranted, now):
            found.append(Trial(simpler.name, extend(now.fit, simpler, full), simpler, now.adjusted[simpler.name]))
        return found

    @staticmethod
    def _simpler(found: Sequence[Trial], warranted: Sequence[str], now: Round) -> list[Score]:
        """Warranted relatives of what was tried that have fewer magnitudes: Coulomb's beside Stribeck's friction."""
        tried = {t.name for t in found}
        relatives = {r for t in found if len(t.score.sizes) > 1 for r in CATALOGUE[t.name].confused}
        scores = [now.scores[n] for n in warranted if n in relatives and n not in tried]
        return [s for s in scores if len(s.sizes) == 1 and not any(twins(s, t.score) for t in found)][:2]

    @staticmethod
    def _representative(score: Score, now: Round) -> Score:
        for name in PREFERRED:
            if name in now.scores and now.scores[name].visible and twins(now.scores[name], score):
                return now.scores[name]
        return score

    def _choose(self, now: Round, trials: list[Trial]) -> Trial | None:
        if not trials:
            return None
        fit, unknown = now.fit, max((now.flexible[n].share for n in now.structured), default=0.0)
        variance = min(t.fit.variance for t in trials)
        ranked = sorted(trials, key=lambda t: t.merit(variance), reverse=True)
        preferred = [t for t in ranked if t.name in PREFERRED and alike(t, ranked[0], variance)]
        preferred.sort(key=lambda t: PREFERRED.index(t.name))
        for trial in (*preferred, *ranked):
            explained = 1.0 - trial.fit.solution.lin.cost / fit.solution.lin.cost
            wary = explained < MOST * unknown  # what explains most may gain most of it in one record
            if explained > max(0.0, EXPLAINS * unknown) and gain(fit, trial.fit, wary) > 0.0:
                return trial
        return None

    def _addition(self, chosen: Trial, trials: list[Trial], now: Round) -> Addition:
        variance = chosen.fit.variance
        apart = {chosen.name, *(t.name for t in trials if confined(t))}
        same = [n for n, s in now.scores.items() if n not in apart and s.visible and twins(s, chosen.score)]
        same += [t.name for t in trials if t.name not in (chosen.name, *same) and alike(t, chosen, variance)]
        close = tuple(
            t.name
            for t in trials
            if t.name not in (chosen.name, *same)
            and len(t.fit.names) <= len(chosen.fit.names)
            and 2.0 * (t.fit.solution.lin.cost - chosen.fit.solution.lin.cost) / variance < CLOSE
        )
        return Addition(chosen.name, tuple(same), close, chosen.p_value, chosen.fit)

    def _review(self, now: Round) -> Fit:
        """Drop what has become idle; swap what has a simpler rival, or where something is left, a better one.

        At the horizon at which the model without any addition could follow the log: there both sides can be fitted.
        """
        fit = now.fit
        for addition in self.additions:
            if not holds(fit, addition.name):
                self.additions.remove(addition)
                self.taken_back.add(addition.name)
                return grow(reduce_by(fit, addition.name))
        for addition in list(self.additions):
            first = len(self.additions) == 1 and len(fit.names) == len(self.rounds[0].fit.names) + 1
            if first:
                continue  # nothing has changed since it was chosen
            full = at_horizon(fit, self.reviewed_at)
            without = reduce_by(full, addition.name)
            price = (len(full.names) - len(without.names)) * math.log(full.degrees)
            if 2.0 * (without.solution.lin.cost - full.solution.lin.cost) / full.variance < price:
                self.additions.remove(addition)
                return grow(without)
            if not (now.left or _has_simpler(addition.name)):
                continue  # a swap can gain nothing
            bare = Round.of(without, self.names)
            trials = [t for t in self.trials(bare, full) if t.name != addition.name]
            if not trials:
                continue
            rival = self._rival(fit, full, addition, trials)
            if rival is not None:
                self.additions[self.additions.index(addition)] = self._addition(rival, trials, bare)
                return rival.fit
        return fit

    @staticmethod
    def _rival(fit: Fit, full: Fit, addition: Addition, trials: Sequence[Trial]) -> Trial | None:
        """The best of the effects that explain more, or as much with fewer numbers, in an addition's place.

        Those that come near are fitted at the full horizon: short windows that begin at rest have many optima.
        """
        near = [t for t in trials if t.fit.variance < 1.5 * full.variance]
        grown = [Trial(t.name, grow(t.fit), t.score, t.p_value) for t in near]
        best, most = None, CLOSE
        for trial in grown:
            here = fit if trial.fit.horizon == fit.horizon else at_horizon(fit, trial.fit.horizon)
            variance = min(here.variance, trial.fit.variance)
            margin = trial.merit(variance) - Trial(addition.name, here, trial.score, 0.0).merit(variance)
            if margin > most:
                best, most = trial, margin
        return best

    def _prune(self, now: Round) -> Fit:
        """Where something unknown remains: take back the effects that only imitated it.

        Those are the ones that differ from neutral no longer once a flexible torque of the unknown's kind acts too, and
        that explain less than most of what such a torque would explain in their place.
        """
        if not now.structured:
            return now.fit
        kind = now.structured[0]
        directions = Directions(now.fit)
        torque = bases(directions)[kind]
        for addition in reversed(self.additions):
            magnitudes = CATALOGUE[addition.name]().parameters.values()
            own = [f"{addition.name}.{p.name}" for p in magnitudes if p.neutral is not None]
            if chi2.sf(directions.beside(torque, own), len(own)) < LEVEL / 10.0:
                continue
            without = reduce_by(now.fit, addition.name)
            explained = 1.0 - now.fit.solution.lin.cost / without.solution.lin.cost
            if explained < MOST * Round.of(without, ()).flexible[kind].share:
                self.additions.remove(addition)
                self.taken_back.add(addition.name)
                return grow(without)
        return now.fit


def _has_simpler(name: str) -> bool:
    """Whether the catalogue holds a relative of an effect that has fewer magnitudes."""

    def magnitudes(kind: str) -> int:
        return sum(p.neutral is not None for p in CATALOGUE[kind]().parameters.values())

    relatives = [r for r in CATALOGUE[name].confused if r in CATALOGUE]
    return any(magnitudes(r) < magnitudes(name) for r in relatives)


def holds(fit: Fit, name: str) -> bool:
    """Whether an effect's magnitudes differ from neutral by the covariance of the fit, coloured residuals included.

    One that ended at its bound, or whose direction is not determined, is judged by its cost alone.
    """
    own = [p.name for p in CATALOGUE[name]().parameters.values() if p.neutral is not None and not p.never]
    at = [fit.names.index(f"{name}.{k}") for k in own if f"{name}.{k}" in fit.names]
    covariance = fit.covariance[np.ix_(at, at)]
    if not at or not np.all(np.isfinite(covariance)):
        return True
    neutral = [fit.model.parameters[fit.names[i]].neutral or 0.0 for i in at]
    apart = fit.solution.p[at] - np.array(neutral)
    return bool(chi2.sf(apart @ np.linalg.pinv(covariance) @ apart, len(at)) < LEVEL / 10.0)


def confined(trial: Trial) -> bool:
    """Whether one of the effect's numbers ended at a bound that is not its neutral value."""
    fit = trial.fit
    for name, number in zip(fit.names, fit.solution.p.tolist(), strict=True):
        p = fit.model.parameters[name]
        if name.startswith(f"{trial.name}.") and number in p.bounds and number != p.neutral:
            return True
    return False


def alike(a: Trial, b: Trial, variance: float) -> bool:
    """Whether two fitted effects move this log's readings alike and explain it about as well."""
    apart = abs(a.merit(variance) - b.merit(variance))
    return apart < 3.0 * CLOSE and len(a.score.sizes) == len(b.score.sizes) and alikeness(a.score, b.score) > ALIKE


def twins(a: Score, b: Score) -> bool:
    """Whether two effects with equally many magnitudes move the readings of this log alike."""
    return len(a.sizes) == len(b.sizes) and alikeness(a, b) > SAME
