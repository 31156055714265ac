"""The search: from a model and a log to the effects that are missing, one addition at a time."""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.diagnosis.criteria import (
    at_bound,
    gain,
    is_determined,
    is_plausible,
    matters,
    recurs,
    shows_in_balance,
    squared_size,
)
from sysid.diagnosis.search_settings import DEFAULT, SearchSettings
from sysid.errors import InvalidInput
from sysid.estimation.first_fit import first_fits, without_common
from sysid.estimation.held_out import lead_of
from sysid.estimation.likelihood import p_value
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import PredictionErrors, left_out_errors
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import (
    balanced,
    continued,
    exchanged,
    extended,
    reduced,
    settled,
    with_energy_balance,
    without_free,
)
from sysid.estimation.scores import Score, collinearity, price, scores
from sysid.estimation.solver import HELD, QUICK, THOROUGH, Settings, fit_parameters
from sysid.physics.effects import CATALOGUE, Effect, effect, preferred
from sysid.physics.effects.disturbance import TorqueBias
from sysid.physics.effects.friction import Coulomb
from sysid.physics.effects.load import LoadFriction
from sysid.physics.model import Model

logger = logging.getLogger(__name__)

LEAST_SHARE = 0.5
"""Least share of an inertia that is left without a block: that the block alone shows it says nothing of a candidate."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate, one effect or several, with its fit; merit is its `gain` of the deviance less its price."""

    effects: tuple[str, ...]
    fit: Fit
    merit: float

    @property
    def single(self) -> str | None:
        """The effect, if it is one alone."""
        return self.effects[0] if len(self.effects) == 1 else None


@dataclass(frozen=True, eq=False)
class Addition:
    """An effect that was added.

    same      effects that this log cannot tell from it, whatever their sizes
    close     effects that explain the log about as well
    p_value   of the likelihood ratio when it was added
    replaced  additions that it contains, whose place it took
    """

    name: str
    same: tuple[str, ...]
    close: tuple[str, ...]
    p_value: float
    replaced: tuple[Addition, ...] = ()


def all_but(left: Addition, additions: Sequence[Addition], instead: Sequence[Addition] | None = None) -> list[Addition]:
    """The additions without one of them, which makes place for those that it had replaced, or for others `instead`."""
    back = left.replaced if instead is None else instead
    return [b for a in additions for b in (back if a is left else (a,))]


def contained_in(effects: Iterable[Effect]) -> set[str]:
    """The names of the effects that one of these contains: beside it their numbers would mean nothing."""
    return {name for e in effects for name in e.contains}


@dataclass(eq=False)
class Search:
    """A stepwise search: forward over effects and composites of them, backward after every addition.

    effects      names of the effects that may be used (None: the whole catalogue)
    trials       the candidates that were fitted in the first round
    first, last  score tests in the first round and in the last one
    negligible   effects that pay and do not matter
    stages       additions and fit at the end of each round
    given        the effects of the model as it came
    """

    records: Sequence[Record]
    sensor: Sensor
    effects: Iterable[str] | None = None
    settings: SearchSettings = DEFAULT
    additions: list[Addition] = field(default_factory=list)
    trials: list[Trial] = field(default_factory=list)
    first: dict[str, Score] = field(default_factory=dict)
    last: dict[str, Score] = field(default_factory=dict)
    negligible: list[str] = field(default_factory=list)
    stages: list[tuple[tuple[Addition, ...], Fit]] = field(default_factory=list)
    given: tuple[Effect, ...] = ()
    left: dict[tuple[Fit, float], PredictionErrors] = field(default_factory=dict)

    def run(self, model: Model, names: Sequence[str], helped: Fit | None = None) -> tuple[Fit, Fit]:
        """Run the search, and return the fit of the model as it came and the final fit. The search begins at `helped`,
        a first fit beside common effects; by default at the one that a regression leads to."""
        logger.debug("fitting the model as it came")
        if helped is None:
            helped = first_fits(Samples(model, self.records, self.sensor), model, names)[0]
        base = now = without_common(helped, model, names)
        self.given = base.model.effects
        for k in range(self.settings.steps):
            before = self.names
            now, stays = self._round(now, helped if k == 0 else None)
            if not stays:
                return base, now
            if self.names == before:  # what was added was pruned again, but left a better fit of the others
                self.stages.pop()
            elif any({a.name for a in additions} == self.names for additions, _ in self.stages):
                break  # it would go round in a circle
            self.stages.append((tuple(self.additions), now))
        self.last = self.tested(now)
        return base, now

    def _round(self, now: Fit, helped: Fit | None) -> tuple[Fit, bool]:
        """Try candidates, kind after kind, until one is added and stays. Returned are the fit then, and whether one
        stays. In the first round the effects of the first fit `helped` are candidates, too."""
        logger.debug(f"testing {len(CATALOGUE)} effects" if helped else "testing what else is missing")
        now = with_energy_balance(now)
        self.last = self.tested(now)
        self.left.clear()
        self.first = self.first or self.last
        tried = self._trials(now)
        if helped is not None:
            tried = sorted([*tried, *self._common(now, helped)], key=lambda t: t.merit, reverse=True)
        before, least = self.names, now.deviance - self.settings.close_deviance
        nothing: list[tuple[str, ...]] = []  # what was added, and turned out to be nothing
        kinds = (
            lambda: self._others(now, tried),
            lambda: self._simulated(now),
            lambda: self._composites(now),
            lambda: self._finished(now, tried),
        )
        among, more = tried, iter(kinds)
        while True:
            while (chosen := self._chosen(now, tried, among, nothing)) is not None:
                end = self._pruned(self._added(now, chosen, tried))
                if self.names != before or (before and end.deviance < least):
                    self.trials = self.trials or tried
                    return end, True
                now = min(now, end, key=lambda fit: fit.deviance)
                nothing.append(chosen.effects)
            others = None if now.undisturbed else next(more, None)
            if others is None:
                self.trials = self.trials or tried
                return now, False
            among = others()
            tried = [*tried, *among]

    @property
    def names(self) -> set[str]:
        """The names of what was added."""
        return {a.name for a in self.additions}

    def end(self, base: Fit) -> Fit:
        """The fit at which the search ended: `base` if nothing was added."""
        return self.stages[-1][1] if self.stages else base

    # candidates ----------------------------------------------------------------------------------------------

    def _trials(self, now: Fit) -> list[Trial]:
        """Fit the candidates of the largest expected merit; and, if a random torque may hide them, common effects.

        If one of them leaves nothing to explain, refinements of it that promise less are not tried, nor are hidden
        effects. The simpler forms of a refinement are fitted, too.
        """
        hidden = now.disturbances.s * now.inertia > 0.0 and not now.undisturbed
        promise, least = self.promise(self.last), self.settings.least_promise
        best = max(promise.values(), default=0.0)
        single = [n for n, merit in promise.items() if merit > max(0.0, least * best)][: self.settings.trials]
        tried, enough = list[Trial](), set[tuple[str, ...]]()
        for name in single:
            if enough.isdisjoint(CATALOGUE[name].refines):
                self._try_class(now, name, tried)
                enough = {t.effects for t in tried if t.fit.undisturbed}
        for name in self.settings.always_tried:
            if hidden and not enough and name in promise and name not in single:
                self._try_class(now, name, tried)
        for simpler in dict.fromkeys(names for t in tried for names in CATALOGUE[t.effects[0]].refines):
            if all(n in promise for n in simpler) and all(set(simpler) != set(t.effects) for t in tried):
                tried += self.trial(now, simpler)
        self._try_balanced(now, tried)
        return sorted(tried, key=lambda t: t.merit, reverse=True)

    def _try_balanced(self, now: Fit, tried: list[Trial]) -> None:
        """Fit the frictions that explain the losses of a free swing best, beginning at their sizes; if the same ones
        were fitted from elsewhere, the better fit counts."""
        begin = [e for e in now.balance.frictions if e.name in self.last] if now.balance else []
        new = tuple(e.name for e in begin)
        if new and all(self.last[name].visible for name in new):
            same = [t for t in tried if set(t.effects) == set(new)]
            same += self.trial(now, new, begin)
            best = max(same, key=lambda t: t.merit, default=None)
            tried[:] = [*(t for t in tried if t not in same), *([best] if best else [])]

    def tested(self, now: Fit) -> dict[str, Score]:
        """The score tests of the effects that may be used, without those that a present effect contains, or beside
        which it would be a second form of the same: of two dry frictions that give or fall with speed, say, a log tells
        neither's number."""
        present, contained = set(now.model.effect_names), contained_in(now.model.effects)
        taken = {n for n, kind in CATALOGUE.items() if not contained.isdisjoint(kind.contains)}
        second = {n for n in taken if present.isdisjoint(CATALOGUE[n].contains)}
        return {n: score for n, score in scores(now, self.effects).items() if n not in contained | second}

    def promise(self, tested: Mapping[str, Score]) -> dict[str, float]:
        """The expected merit of each visible effect (its score less its price), the largest first."""
        promise = {n: s.merit(self.settings.price) for n, s in tested.items() if s.visible}
        return dict(sorted(promise.items(), key=lambda item: item[1], reverse=True))

    def _others(self, now: Fit, trials: Sequence[Trial]) -> list[Trial]:
        """Fit effects of smaller expected merit, but no refinements of present ones, after the first trials kept less
        than they promised. Returned are those that predict left-out stretches better by more than chance."""
        known, present = {t.effects for t in trials}, set(now.model.effect_names)
        tried = list(trials)
        names = [n for n, merit in self.promise(self.last).items() if merit > 0.0 and (n,) not in known]
        names = [n for n in names if not any(present.issuperset(simpler) for simpler in CATALOGUE[n].refines)]
        for name in names[: self.settings.trials]:
            self._try_class(now, name, tried)
        better = (t for t in tried[len(trials) :] if t.merit > 0.0 and self._predicts_better(now, t.fit))
        return sorted(better, key=lambda t: t.merit, reverse=True)

    def _common(self, now: Fit, helped: Fit) -> list[Trial]:
        """Trials with the first fit's friction and offset: where these dominate, nothing else shows without them."""
        names = tuple(name for name in helped.model.effect_names if name not in now.model.effect_names)
        if now.undisturbed or any(n not in self.last or not self.last[n].visible for n in names):
            return []
        fit, tried = balanced(helped, now.balance), list[Trial]()
        for name in reversed(names):
            tried.append(Trial(names, fit, gain(fit, now, names) - self._price(names)))
            if len(names) < 3:
                break
            names, fit = tuple(n for n in names if n != name), reduced(fit, name)
        return [*tried, *self._loaded(now, helped)]

    def _loaded(self, now: Fit, helped: Fit) -> list[Trial]:
        """The trial of a friction that grows with the load in the place of the first fit's dry friction and offset,
        begun at its numbers. Where friction holds the joint no slope leads from none to it."""
        score, dry = self.last.get(LoadFriction.name), Coulomb.name in helped.model.effect_names
        if not (now.samples.driven and dry and score is not None and score.visible):
            return []
        start = LoadFriction().at_beginning(now.samples.extent(now.model))
        try:
            fit = exchanged(helped, (Coulomb.name, TorqueBias.name), start)
        except InvalidInput:
            return []
        names = tuple(n for n in fit.model.effect_names if n not in now.model.effect_names)
        return [Trial(names, fit, gain(fit, now, names) - self._price(names))]

    def _price(self, names: Iterable[str]) -> float:
        """The decrease of the deviance that effects have to bring together."""
        return sum(price(n, self.settings.price, self.last[n].shapes if n in self.last else 1) for n in names)

    def _simulated(self, now: Fit) -> list[Trial]:
        """Trials of the effects that best explain the errors of a simulation, beside next to no disturbances. Beside a
        large random torque the motion follows its readings wherever they go, and hides a sensor that reads wrong."""
        quiet = now.disturbances.scaled(self.settings.simulated_share)
        simulated = continued(now, quiet, HELD)
        tested = scores(simulated, [n for n, s in self.last.items() if s.visible])
        best = sorted(tested.values(), key=lambda s: s.lm - self._price([s.name]), reverse=True)
        tried: list[Trial] = []
        for score in best[: self.settings.simulated_trials]:
            begin = [score.best.at(score.sizes)]
            tried += self.trial(now, (score.name,), begin, simulated)
            if all(t.effects != (score.name,) or t.merit <= 0.0 for t in tried):
                tried += self.trial(now, (score.name,), begin)  # a fit from the simulation may have lost its way
        return sorted(tried, key=lambda t: t.merit, reverse=True)

    def _composites(self, now: Fit) -> list[Trial]:
        """Trials of effects that come together and may not pay alone."""
        tried: list[Trial] = []
        for composite in self.settings.composites:
            new = tuple(n for n in composite if n in self.last and self.last[n].visible)
            if len(new) > 1 and all(set(new) != set(t.effects) for t in tried):
                tried += self.trial(now, new)
        return sorted(tried, key=lambda t: t.merit, reverse=True)

    def _finished(self, now: Fit, trials: Sequence[Trial]) -> list[Trial]:
        """The sound trial of the largest merit among those whose quick fit has not ended, fitted to its end: its
        predictions may have failed for that."""
        unfinished = [t for t in trials if t.merit > 0.0 and not t.fit.converged]
        for best in sorted(unfinished, key=lambda t: t.merit, reverse=True):
            if self._is_sound(best, now, trials):
                fit = settled(best.fit)
                return [replace(best, fit=fit, merit=best.merit + gain(fit, best.fit, best.effects))]
        return []

    def _try_class(self, now: Fit, name: str, tried: list[Trial]) -> None:
        """Fit an effect by the preferred member of its class, the effects that the log cannot tell from it; and, while
        a member's fit ends at a bound, by the next one. The effect itself is the last."""
        score = self.last[name]
        others = [n for n in preferred() if n in self.last and n != name and self._same(self.last[n], score)]
        for chosen in (*others, name):
            same = [t for t in tried if t.single and self._same(self.last[t.single], self.last[chosen])]
            if any(not at_bound(t.fit, t.effects[0]) for t in same):
                return
            if all(t.single != chosen for t in same):
                tried += self.trial(now, (chosen,))

    def _same(self, a: Score, b: Score) -> bool:
        return a.name == b.name or collinearity(a, b) > self.settings.same_collinearity

    def inseparable(self, name: str) -> tuple[str, ...]:
        """The effects that the log cannot tell from this one in the first round, whatever their sizes."""
        score = self.first[name]
        others = {n: s for n, s in self.first.items() if n != name and s.visible and len(s.sizes) == len(score.sizes)}
        return tuple(n for n, s in others.items() if self._same(s, score))

    def trial(
        self,
        now: Fit,
        names: tuple[str, ...],
        begin: Sequence[Effect] | None = None,
        near: Fit | None = None,
    ) -> list[Trial]:
        """The trial of these effects, begun where the fit `near` ended; none if two effects exclude each other, if the
        model runs away, or if it cannot use most readings. Effects of the model make place for one that contains
        them."""
        logger.debug(f"fitting {' and '.join(names)}")
        present = (near or now).model.effect_names
        refined = {n: parts for n in names if (parts := [c for c in CATALOGUE[n].contains if c in present])}
        try:
            begun = near or now
            for parts in refined.values():
                begun = without_free(begun, parts, QUICK)
            tested = self.last | (scores(begun, refined) if refined else {})
            start = begin or [self._start(now, n, len(names) == 1, tested) for n in names]
            fit = extended(begun, start, QUICK)
            for roomy in (e for name in names for e in fit.model.effect_named(name).with_room()):
                other = extended(begun, [roomy if e.name == roomy.name else e for e in start], QUICK)
                fit = min(fit, other, key=lambda f: f.deviance)
        except InvalidInput:
            return []
        merit = gain(fit, now, names) - self._price(names)
        present = fit.model.effect_names
        merit += self._price(e.name for e in now.model.effects if e.name not in present)
        usable = math.isfinite(merit) and 2 * fit.linearised.unused <= fit.samples.readings
        return [Trial(names, fit, merit)] if usable else []

    def _start(self, now: Fit, name: str, alone: bool, tested: Mapping[str, Score]) -> Effect:
        """The effect at the size that its score predicts, or at a small size if it is one of several."""
        score = tested.get(name) or self.first[name]
        if alone and score.lm > 0.0:
            return score.best.at(score.sizes)
        if any(CATALOGUE[name].begins.values()):
            begun: Effect = effect(name).at_beginning(now.samples.extent(now.model))
            return begun
        return score.best.at(tuple(0.1 * s for s in score.sizes))

    # choosing ------------------------------------------------------------------------------------------------

    def _chosen(
        self, now: Fit, trials: Sequence[Trial], among: Sequence[Trial], rejected: Collection[tuple[str, ...]]
    ) -> Trial | None:
        """The best trial `among` these that pays, is sound, predicts left-out stretches no worse, and matters. Another
        that is `nearly_as_good` is chosen if it predicts better by more than chance. What was `rejected` before is not
        tried again."""
        ranked = [t for t in among if t.merit > 0.0 and t.effects not in rejected]
        if not ranked:
            return None
        first: Trial | None = None
        for trial in (*(t for t in self._preferred(now, ranked[0]) if t.effects not in rejected), *ranked):
            if not self._is_sound(trial, now, trials):
                continue
            if first is not None:
                near = trial.merit > self.settings.nearly_as_good * first.merit
                if near and self._matters(now, trial) and self._predicts_better(first.fit, trial.fit):
                    return trial
            elif self._predicts(now, trial.fit) and self._matters(now, trial):
                if trial.fit.undisturbed:
                    return trial
                first = trial
            elif trial.single and trial.single not in self.negligible:
                self.negligible.append(trial.single)
        return first

    def _is_sound(self, trial: Trial, now: Fit, trials: Sequence[Trial]) -> bool:
        """Whether a machine may have the effects with their numbers, the log determines these, a pattern comes back,
        and a refinement beats its simpler forms."""
        real = is_plausible(trial.fit, trial.effects) and is_determined(trial.fit, now, self.names)
        back = recurs(trial.fit, trial.effects, self.settings)
        return real and back and self._beats_its_simpler_forms(trial, trials)

    def _matters(self, now: Fit, trial: Trial) -> bool:
        return matters(now.model, trial.fit, self.settings)

    def _predicts_better(self, before: Fit, after: Fit) -> bool:
        """Whether left-out stretches are predicted better by more than the standard error. If the model lacks several
        effects, likelihood alone does not decide between two candidates that explain about as much."""
        better, sd = self._left_out_gain(before, after)
        return math.isfinite(better) and better > sd

    def _beats_its_simpler_forms(self, trial: Trial, trials: Sequence[Trial]) -> bool:
        """Whether a refinement predicts left-out stretches better than its simpler forms do, by enough to matter."""
        simpler = {frozenset(names) for name in trial.effects for names in CATALOGUE[name].refines}
        return all(
            self._predicts(other.fit, trial.fit) and matters(other.fit.model, trial.fit, self.settings)
            for other in trials
            if frozenset(other.effects) in simpler and other.merit > 0.0
        )

    def _predicts(self, before: Fit, after: Fit) -> bool:
        """Whether left-out stretches are predicted better; or no worse, if the model needs no random torque any more or
        the energy balance shows what is added. Beside a random torque likelihood alone believes too much."""
        better, sd = self._left_out_gain(before, after)
        shown = after.undisturbed or shows_in_balance(before.model, after, self.settings)
        return math.isfinite(better) and better > (-sd if shown else 0.0)

    def _left_out_gain(self, before: Fit, after: Fit) -> tuple[float, float]:
        """How much better left-out stretches are predicted over the same windows, with the standard error."""
        lead = max(lead_of(before.model), lead_of(after.model))
        return self.left_out(after, lead).gain(self.left_out(before, lead))

    def left_out(self, fit: Fit, lead: float) -> PredictionErrors:
        """The errors on left-out stretches; they are kept for a round, which needs them several times."""
        if (fit, lead) not in self.left:
            settings = self.settings
            self.left[fit, lead] = left_out_errors(fit, settings.ahead, settings.blocks, lead, LEAST_SHARE)
        return self.left[fit, lead]

    def _preferred(self, now: Fit, best: Trial) -> list[Trial]:
        """Trials of commoner effects that explain the log about as well as the best trial, begun where that ended."""
        name = best.single
        if name is None:
            return []
        fitted = best.fit.model.effect_named(name).parameters
        trials: list[Trial] = []
        for other in preferred():
            if other == name or other not in self.last or other not in CATALOGUE[name].confused:
                continue
            simple = effect(other)
            numbers = {k: float(fitted[k].value) for k in simple.parameters if k in fitted}
            if len(numbers) == len(simple.parameters):
                bounded = {k: float(np.clip(v, *simple.parameters[k].bounds)) for k, v in numbers.items()}
                trials += self.trial(now, (other,), [effect(other, **bounded)])
        return [t for t in trials if gain(best.fit, t.fit, best.effects) < 3.0 * self.settings.close_deviance]

    def _added(self, now: Fit, chosen: Trial, trials: Sequence[Trial]) -> Fit:
        equal = self._alike(chosen, trials, self.settings.equal_deviance, self.settings.high_collinearity)
        rivals = self._alike(chosen, trials, self.settings.close_deviance, self.settings.rival_collinearity)
        p = p_value(now.deviance - chosen.fit.deviance, len(chosen.fit.names) - len(now.names))
        for name in chosen.effects:
            score = self.last[name]
            held = {t.single for t in trials if t.single and at_bound(t.fit, t.single)}
            visible = [n for n, s in self.last.items() if n != name and n not in held and s.visible]
            same = tuple(n for n in visible if n in equal or self._same(self.last[n], score))
            close = tuple(
                other
                for other, fit in rivals.items()
                if other not in same
                and len(fit.names) <= len(chosen.fit.names)
                and (chosen.fit.undisturbed or not self._predicts_better(fit, chosen.fit))
            )
            replaced = tuple(a for a in self.additions if a.name in CATALOGUE[name].contains)
            kept = [a for a in self.additions if a not in replaced]
            self.additions = [*kept, Addition(name, same, close, p, replaced)]
        return settled(chosen.fit)

    def _alike(self, chosen: Trial, trials: Sequence[Trial], deviance: float, cosine: float) -> dict[str, Fit]:
        """The other effects of single trials with which the log is as likely as with the chosen one, up to a difference
        of the deviance, and whose collinearity with it exceeds a cosine, with their fits."""
        name = chosen.single
        return {
            t.single: t.fit
            for t in trials
            if name
            and t.single
            and t.single != name
            and abs(gain(chosen.fit, t.fit, (name,))) < deviance
            and collinearity(self.last[t.single], self.last[name]) > cosine
        }

    def _pruned(self, now: Fit) -> Fit:
        """Drop additions one at a time, then try simpler forms of those that are left.

        First those without a size go, then those that no longer pay or matter beside the others; each time the one of
        which least is lost beyond its price.
        """
        while self.additions:
            size = {a.name: squared_size(now, a.name) for a in self.additions}
            nothing = [a for a in self.additions if size[a.name] < self.settings.sure_size]
            doubtful = [a for a in self.additions if not size[a.name] > self.settings.clear_size]
            candidates = nothing or (doubtful if len(self.additions) > 1 else [])
            tried = [(a, self.without(now, a, a.replaced, QUICK)) for a in candidates]
            needless = [(a, without) for a, without in tried if a in nothing or self._needless(a.name, now, without)]
            if not needless:
                break
            saved = {a.name: price(a.name, self.settings.price) for a, _ in needless}
            addition, without = min(needless, key=lambda item: item[1].deviance - saved[item[0].name])
            logger.debug(f"going on without {addition.name}")
            self.additions = all_but(addition, self.additions)
            now = settled(without)
        return self._simplified(now)

    def without(self, now: Fit, left: Addition, back: Sequence[Addition] = (), settings: Settings = THOROUGH) -> Fit:
        """The fit without an addition, and with others `back` in the place that it took; those of the model as it came
        are there again, too."""
        fit = reduced(now, left.name, settings)
        present = fit.model.effect_names
        begun = [e for e in self.given if e.name in CATALOGUE[left.name].contains and e.name not in present]
        begun += [self._simpler(now, left.name, a.name) for a in back]
        return extended(fit, begun, settings) if begun else fit

    def _needless(self, name: str, now: Fit, without: Fit) -> bool:
        """Whether an effect does not pay or does not matter beside the others."""
        loses = gain(now, without, (name,)) - price(name, self.settings.price)
        return loses < 0.0 or not matters(without.model, now, self.settings)

    def _simplified(self, now: Fit) -> Fit:
        """Replace refinements that, beside later additions, no longer beat their simpler form or are not plausible."""
        for addition in list(self.additions):
            for new, other in self.simpler_forms(now, addition):
                saved = price(addition.name, self.settings.price) - sum(price(n, self.settings.price) for n in new)
                shared = {field for n in new for field in effect(n).parameters}
                if (
                    is_plausible(now, (addition.name,))
                    and not squared_size(now, addition.name, shared) < self.settings.sure_size
                    and gain(now, other, (addition.name,)) > saved
                    and self._predicts(other, now)
                    and matters(other.model, now, self.settings)
                ):
                    continue
                self.additions = self.in_place_of(addition, new, self.additions)
                now = fit_parameters(now.samples, other.model, other.names, other)
                break
        return now

    def simpler_forms(self, now: Fit, addition: Addition) -> Iterator[tuple[tuple[str, ...], Fit]]:
        """The simpler forms of a refinement: the names of the effects that come in its place, and the fit with them.
        What another effect contains is present. Forms that other numbers of the model absorb are left out."""
        others = [e for e in now.model.effects if e.name != addition.name]
        present = {addition.name, *(e.name for e in others)} | contained_in(others)
        for simpler in CATALOGUE[addition.name].refines:
            new = tuple(n for n in simpler if n not in present and (n in self.last or n in self.first))
            if new and len(new) + len(present & set(simpler)) >= len(simpler):
                logger.debug(f"trying {' and '.join(new)} in place of {addition.name}")
                other = self._with_simpler(now, addition.name, new)
                if is_determined(other, now, ()):
                    yield new, other

    def in_place_of(self, refined: Addition, new: Sequence[str], additions: Sequence[Addition]) -> list[Addition]:
        """The additions with a simpler form of one of them in its place; what the model came with is none."""
        came = {e.name for e in self.given}
        return all_but(refined, additions, [Addition(n, (), (), refined.p_value) for n in new if n not in came])

    def _simpler(self, now: Fit, refined: str, name: str) -> Effect:
        """A simpler effect that begins at the refinement's numbers if these include its own, else at a small size."""
        numbers = now.model.effect_named(refined).parameters
        fields = effect(name).parameters
        if set(fields) <= set(numbers):
            begun: Effect = effect(name, **{field: float(numbers[field].value) for field in fields})
            if not begun.idle:
                return begun
        return self._start(now, name, False, self.last)

    def _with_simpler(self, now: Fit, refined: str, simpler: Sequence[str]) -> Fit:
        """The fit with simpler effects in place of a refinement. It begins where a fit without the refinement ends; or,
        if the refinement has ended as its simpler form, with all other numbers at their bounds, where the present fit
        ended."""
        numbers = now.model.effect_named(refined).parameters
        starts = [self._simpler(now, refined, name) for name in simpler]
        shared = {field for e in starts if set(e.parameters) <= set(numbers) for field in e.parameters}
        if not shared or not {f"{refined}.{field}" for field in numbers if field not in shared} <= now.at_bounds:
            return extended(reduced(now, refined), starts, QUICK)
        model = now.model.without_effect(refined)
        for start in starts:
            model = model.with_effect(start)
        names = [*(n for n in now.names if n in model.parameters), *(n for e in starts for n in model.names_of(e.name))]
        return fit_parameters(now.samples, model, names, now, settings=QUICK)
