"""Confirmation: which additions of a search are believed, by held-out data and by the torque that remains missing."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sysid.diagnosis.criteria import (
    NEGLIGIBLE_RISE,
    is_lowered,
    is_nothing,
    is_plausible,
    is_undetermined,
    shows_in_balance,
    squared_size,
)
from sysid.diagnosis.explanation import Evidence, Explanation, late_effects
from sysid.diagnosis.friction_sets import FrictionSets, is_as_good, least_size
from sysid.diagnosis.hidden_friction import hidden_friction
from sysid.diagnosis.search import Addition, all_but, contained_in
from sysid.estimation.energy_balance import FRICTIONS
from sysid.estimation.likelihood import p_value
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended, settled
from sysid.estimation.scores import scores
from sysid.estimation.solver import QUICK
from sysid.estimation.torque_regression import FrictionAlong
from sysid.physics.effects import CATALOGUE


class Confirmation:
    """The additions of a search that are believed, with the errors and missing torques on which that rests.

    evidence     what explanations are judged by, with its `search` and `settings`
    bare         the explanation without additions
    now          the explanation by the additions that stay
    unconfirmed  the names of the additions that were taken back
    weighed      names of additions -> the explanation by these
    as_likely    explanations by other sets of common frictions with which the log is about as likely
    friction     friction and load in the drive's torque, if no model explains how the motion follows from the torque
    """

    def __init__(self, evidence: Evidence) -> None:
        self.evidence, self.search, self.settings = evidence, evidence.search, evidence.settings
        self.now = self.bare = evidence.bare
        self.unconfirmed, self.as_likely = list[str](), list[Explanation]()
        self.weighed: dict[tuple[str, ...], Explanation] = {(): self.bare}
        self.friction: FrictionAlong | None = None
        self._confirm()
        self._take_back_imitations()
        self._compare_frictions()
        self._reconsider()
        self._find_hidden_friction()
        self._weigh_friction()
        self._take_numbers_that_predict_best()

    @property
    def additions(self) -> tuple[Addition, ...]:
        """Those that stay."""
        return self.now.additions

    def explanation(self, additions: Sequence[Addition]) -> Explanation:
        """The explanation by some of the additions that stay, or by what they replaced."""
        names = {a.name for a in additions}
        if (known := self.weighed.get(tuple(sorted(names)))) is not None:
            return known
        fit = self.now.fit
        for addition in self.now.additions:
            if addition.name not in names:
                fit = self.search.without(fit, addition, [a for a in addition.replaced if a.name in names])
        return self._weigh(additions, fit)

    def _weigh(self, additions: Sequence[Addition], fit: Fit) -> Explanation:
        explanation = Explanation(self.evidence, tuple(additions), fit)
        self.weighed[explanation.names] = explanation
        return explanation

    def _without(self, left: Addition, present: Explanation | None = None) -> Explanation:
        """The explanation without one of the additions; what that had replaced is there again."""
        return self.explanation(all_but(left, (present or self.now).additions))

    def _confirm(self) -> None:
        """Keep the last stage of the search that does not raise the held-out error, without its needless additions."""
        best = self.bare.error.ratio
        for additions, fit in self.search.stages:
            stage = self._weigh(additions, fit)
            no_worse = stage.error.ratio <= best * (1.0 + NEGLIGIBLE_RISE) or not math.isfinite(best)
            if no_worse or self._losses_confirm(stage, self.now):
                best, self.now = min(best, stage.error.ratio), stage
        self._simplify()
        chosen = set(self.now.names)
        self._drop_needless()
        self._return_to_earlier(chosen.difference(self.now.names))
        tried = dict.fromkeys(a.name for additions, _ in self.search.stages for a in additions)
        refined = {name for kept in self.now.names for simpler in CATALOGUE[kept].refines for name in simpler}
        self.unconfirmed = [name for name in tried if name not in self.now.names and name not in refined]

    def _simplify(self) -> None:
        """Put a refinement's simpler form in its place, if the refinement does not lower the held-out error by what
        matters, times its rarity."""
        for addition in self.additions:
            least = min(self.settings.tolerance * CATALOGUE[addition.name].rarity, 1.0)
            for new, fit in self.search.simpler_forms(self.now.fit, addition):
                simpler = self._weigh(self.search.in_place_of(addition, new, self.additions), settled(fit))
                if not is_lowered(self.now.error.ratio, simpler.error.ratio, least):
                    self.now = simpler
                    break

    def _return_to_earlier(self, dropped: set[str]) -> None:
        """If what was dropped had taken the place of another addition, keep the last stage with that one beside what is
        left, without its needless additions, if this lowers the held-out error by what matters."""
        kept = self.now
        for additions, _ in reversed(self.search.stages):
            names = {a.name for a in additions}
            if dropped and dropped.isdisjoint(names) and names > set(kept.names):
                self.now = self.explanation(additions)
                self._drop_needless()
                if is_lowered(self.now.error.ratio, kept.error.ratio, self.settings.tolerance):
                    return
                self.now = kept

    def _drop_needless(self) -> None:
        """Drop needless additions one after the other; what is left errs no more than the model as it came.

        An addition is needless if it does not lower the held-out error by as much as it has to (`_is_needless`); if its
        size is compatible with 0 or not determined by the readings; if no machine has its numbers; or if another makes
        up for it (`_making_up`).
        """
        while self.additions:
            sound = [a for a in self.additions if self._is_sound(a)] or self.additions
            pay = not self._raises_error(self.now, self.bare)
            needless = [a for a in sound if not pay or self._is_needless(a, self.now)]
            gone = self._first_to_go(needless) if needless else self._nothing_of_a_machine()
            if gone is None:
                break
            self.now = self._without(gone)

    def _nothing_of_a_machine(self) -> Addition | None:
        """The addition that is the least, if any is nothing; else the rarest of those that no machine has or that the
        readings do not determine; else a zero for which another makes up."""
        fit = self.now.fit
        nothing = [a for a in self.additions if is_nothing(fit, a.name, self.settings.sure_size)]
        if nothing:
            return min(nothing, key=lambda a: squared_size(fit, a.name))
        unreal = [a for a in self.additions if is_undetermined(fit, a.name) or not is_plausible(fit, (a.name,))]
        return max(unreal, key=lambda a: CATALOGUE[a.name].rarity) if unreal else self._making_up()

    def _making_up(self) -> Addition | None:
        """Of two zeros that make up for each other, the one without which less is lost.

        Each moves the angle at which the joint comes to rest. If one alone is at most a third as large as beside the
        other, or has the other sign, the two imitate an angle that is not told on one scale, or a torque over it.
        """
        zeros = [a for a in self.additions if CATALOGUE[a.name].moves_rest]
        fewer = {left: self._without(left) for left in zeros if len(zeros) > 1}
        making_up = [
            left
            for left, without in fewer.items()
            if any(self._swells(a.name, without.fit, self.now.fit) for a in zeros if a is not left)
        ]
        return min(making_up, key=lambda left: fewer[left].error.ratio, default=None)

    def _is_sound(self, left: Addition) -> bool:
        """Whether the other additions are plausible without one more; and, if that is a common one, the rare ones among
        them are what they were. With quite other numbers they are another explanation, which no search has found."""
        fewer, now = self._without(left), self.now.fit
        rare = [a.name for a in fewer.additions if a in self.additions and self._is_rare(a)]
        others = any(self._swells(name, fewer.fit, now) or self._swells(name, now, fewer.fit) for name in rare)
        return (self._is_rare(left) or not others) and is_plausible(fewer.fit, fewer.names)

    def _first_to_go(self, needless: Sequence[Addition]) -> Addition:
        """Of several needless additions, the one without which the error is least. If that is a common one that raises
        no error and would pay without a rare one, which is needless too, that rare one goes in its place."""
        ratio = {a: self._without(a).error.ratio for a in needless}
        first, *others = sorted(needless, key=ratio.__getitem__)
        if not self._is_rare(first) and ratio[first] >= (1.0 - self.settings.tolerance) * self.now.error.ratio:
            for other in others:
                if self._is_rare(other) and not self._is_needless(first, self._without(other)):
                    return other
        return first

    def _is_rare(self, addition: Addition) -> bool:
        return CATALOGUE[addition.name].rarity >= self.settings.rare_from

    def _swells(self, name: str, before: Fit, after: Fit) -> bool:
        """Whether a number of an effect is larger by `swollen_factor` in the fit `after`, or has another sign."""
        for number in after.model.names_of(name):
            was, now = (float(fit.model.parameters[number].value) for fit in (before, after))
            if was * now < 0.0 or abs(now) > self.settings.swollen_factor * abs(was):
                return True
        return False

    def _is_needless(self, left: Addition, present: Explanation) -> bool:
        """Whether an addition does not lower the held-out error by as much as it has to.

        - If nothing remains without it beside an error that readings share, a rare one is likelier a part of that.
        - A friction that an energy balance shows need only not raise the error, nor even that if the losses of the
          held-out swings confirm it.
        - The same holds for a rare effect beside which no other promises anything, and for what leaves nothing, where
          something remains without it.
        """
        without = self._without(left, present)
        if self._is_rare(left) and self.evidence.widened and not without.remains:
            return True
        if self._lowers_enough(left, present.error.ratio, without):
            return False
        if self._raises_error(present, without):
            return True
        if shows_in_balance(without.fit.model, present.fit, self.settings):
            return False
        if self._is_rare(left) and not self._another_pays(present.fit):
            return False
        return present.remains or not without.remains

    def _raises_error(self, present: Explanation, without: Explanation) -> bool:
        """Whether the held-out error rises by more than is negligible. That of a free swing tells its period rather
        than its losses: it does not count against frictions that these confirm."""
        lowered = is_lowered(present.error.ratio, without.error.ratio, 0.0)
        return not lowered and not self._losses_confirm(present, without)

    def _losses_confirm(self, present: Explanation, without: Explanation) -> bool:
        """Whether frictions that the energy balance shows explain the losses of held-out swings better, too."""
        if not shows_in_balance(without.fit.model, present.fit, self.settings):
            return False
        balance = self.evidence.held_out_balance
        return balance is not None and balance.deviance(present.fit.model) < balance.deviance(without.fit.model)

    def _lowers_enough(self, left: Addition, ratio: float, without: Explanation) -> bool:
        """Whether the held-out error falls to `ratio` by what matters, times the rarity of what is added; beside others
        by as much again. A rare one has to lower the error by what matters, and its excess by `rare_fall`."""
        before, least = without.error.ratio, self.settings.tolerance
        if self._is_rare(left):
            return is_lowered(ratio, before, max(least, self.settings.rare_fall)) and ratio <= (1.0 - least) * before
        rarity = CATALOGUE[left.name].rarity
        return is_lowered(ratio, before, min(least * (rarity + bool(without.additions)), 1.0))

    def _another_pays(self, end: Fit) -> bool:
        """Whether another effect of the catalogue is expected to pay. If none is, what remains looks random beside this
        model: it hides a rare effect in the error of predictions, but it does not imitate one."""
        promise = self.search.promise(self.search.tested(end))
        return any(merit > 0.0 for merit in promise.values())

    def _take_back_imitations(self) -> None:
        """Take back additions that imitate something unknown, and confirm the others anew after each.

        There are two cases. More torque, by what matters, is missing with the addition than without it, and it does not
        lower the held-out error by a `decisive_fall`. Or what remains depends on the one quantity of which the effect
        is a function, and the effect explains less than `explained_share` of it, or only with a number at its bound.
        """
        before = self.additions
        while (imitation := self._imitation()) is not None:
            self.now = self._without(imitation)
            self._drop_needless()
        self.unconfirmed += [a.name for a in before if a not in self.additions]

    def _imitation(self) -> Addition | None:
        """The first of the additions that imitates something unknown; None if none does."""
        if not math.isfinite(self.now.error.ratio):
            return None
        for addition in self.additions:
            fewer = self._without(addition)
            if not math.isfinite(fewer.error.ratio):  # without it the model runs away
                continue
            if self._losses_confirm(self.now, fewer):
                continue
            # an error that speeds share took the torque's place in the fit, and bent the numbers of the poorer model
            comparable = not self.evidence.base.samples.error_channel
            more = comparable and self.now.torque.after > (1.0 + self.settings.tolerance) * fewer.torque.after
            worse = more and not is_lowered(self.now.error.ratio, fewer.error.ratio, self.settings.decisive_fall)
            if worse or self._is_part_of_unknown(addition, fewer):
                return addition
        return None

    def _is_part_of_unknown(self, addition: Addition, fewer: Explanation) -> bool:
        """Whether an addition is a part of something unknown; `fewer` is the explanation without it. A zero of a free
        swing is none: every sensor has one, whatever else depends on the angle."""
        kind, remaining = CATALOGUE[addition.name], self.now.remaining
        imitates, is_zero = kind.imitates, kind.moves_rest and not self.evidence.base.samples.driven
        if not imitates or is_zero or remaining is None or imitates not in remaining.depends_on:
            return False
        alone = remaining.depends_on == (imitates,)
        after, before = (e.missing_over(imitates, alone) for e in (self.now, fewer))
        bent = self.now.fit.at_bounds - self.evidence.base.at_bounds
        return bool(bent) or after > (1.0 - self.settings.explained_share) * before

    def _compare_frictions(self) -> None:
        """Compare all sets of common frictions: keep the likeliest, and tell which others are about as likely.

        A set is kept in place of the named one if it is likelier, its sizes are sure, it does not raise the held-out
        error, and none of it is needless.
        """
        named, sets = self.now, FrictionSets(self.now)
        others = self._other_frictions(sets)
        loss = {e: sets.loss(e) for e in ((named, *others) if others else ())}
        sure = (e for e in loss if least_size(e) > self.settings.sure_size)
        for likelier in sorted((e for e in sure if loss[e] < 0.0), key=loss.__getitem__):
            if is_plausible(likelier.fit, likelier.names) and not self._raises_error(likelier, named):
                self.now = likelier
                self._drop_needless()
                if self.now is likelier:
                    self.unconfirmed = [name for name in self.unconfirmed if name not in likelier.names]
                    break
                self.now = named
        if not set(FRICTIONS).isdisjoint(self.now.names):
            rest = [e for e in loss if e is not self.now and is_as_good(e, self.now)]
            self.as_likely = [e for e in rest if loss[e] - loss[self.now] < self.settings.close_deviance]

    def _other_frictions(self, sets: FrictionSets) -> list[Explanation]:
        if not sets.comparable:
            return []
        without = self.explanation(sets.beside).fit
        return [self._weigh(additions, fit) for additions, fit in sets.others(without)]

    def _reconsider(self) -> None:
        """Add effects that are sure but too small to matter in the motion that was searched, if they matter in the
        held-out motion, which goes further."""
        for name in self.search.negligible:
            end = self.now.fit
            related = {name, *CATALOGUE[name].contains}.intersection(self.now.names)
            if related or name in contained_in(end.model.effects) or not self.now.fails_elsewhere or self.now.remains:
                continue
            score = scores(end, (name,)).get(name)
            if score is None or not score.visible:
                continue
            fit = settled(extended(end, [score.best.at(score.sizes)], QUICK))
            p = p_value(end.deviance - fit.deviance, score.numbers)
            more = self._weigh((*self.additions, Addition(name, self.search.inseparable(name), (), p)), fit)
            sound = is_plausible(fit, (name,)) and not is_undetermined(fit, name)
            if sound and more.error.ratio < self.now.error.ratio * (1.0 - self.settings.tolerance):
                self.now = more

    def _find_hidden_friction(self) -> None:
        """If nothing is named, name the friction that predictions show, unless it imitates something unknown."""
        found = None if self.additions else hidden_friction(self.bare)
        if found is None:
            return
        self.now = found
        if self._imitation() is None:
            self.weighed[found.names] = found
            self.unconfirmed = [name for name in self.unconfirmed if name not in found.names]
        else:
            self.now = self.bare

    def _weigh_friction(self) -> None:
        """Answer with friction along the motion, and no effect, if the motion does not follow from the torque
        (`Explanation.is_led`). Delays and lags of the drive stay if friction and load explain more with them, and
        predictions are no worse."""
        now, along = self.now, self.now.friction_along
        if along is None or now.remaining is None or not now.is_led:
            return
        punctual = self.bare.friction_along
        tells_more = punctual is None or along.share > punctual.share
        names = {effect.name for effect in late_effects(self.evidence.base, now.fit)} if tells_more else set()
        late = self.explanation([a for a in self.additions if a.name in names])
        self.now = self.bare if self._raises_error(late, self.bare) else late
        self.friction, self.unconfirmed, self.as_likely = along, [], []

    def _take_numbers_that_predict_best(self) -> None:
        """Tell the numbers that predict best over the horizon, if they lower the held-out error by what matters."""
        now, best = self.now, self.now.predicting_best
        if best is not None and is_lowered(best.error.ratio, now.error.ratio, self.settings.tolerance):
            self.now = self.weighed[now.names] = best
