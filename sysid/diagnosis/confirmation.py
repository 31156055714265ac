"""Confirmation: which additions of a search are believed, by held-out data and by the torque that remains missing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.diagnosis.answer import MissingTorque, Remaining
from sysid.diagnosis.contacts import Contact
from sysid.diagnosis.criteria import (
    excess_of,
    is_nothing,
    is_plausible,
    is_undetermined,
    shows_in_balance,
    squared_size,
)
from sysid.diagnosis.dependence import dependence
from sysid.diagnosis.residual_torque import missing_torque, needed_disturbances
from sysid.diagnosis.search import Addition, Search, all_but, contained_in
from sysid.diagnosis.search_settings import SearchSettings
from sysid.estimation.disturbances import NO_DISTURBANCE, Disturbances
from sysid.estimation.energy_balance import FRICTIONS, EnergyBalance
from sysid.estimation.held_out import HeldOutError, held_out_error
from sysid.estimation.likelihood import p_value
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import fitted_error
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import balanced, extended, settled
from sysid.estimation.scores import scores
from sysid.estimation.solver import QUICK
from sysid.estimation.torque_regression import FrictionAlong, friction_along
from sysid.physics.effects import CATALOGUE
from sysid.physics.ops import Array

NEGLIGIBLE_RISE = 1e-3
"""A rise of the held-out error by less than this share is not printed, and counts as none."""


def is_lowered(error: float, without: float, tolerance: float) -> bool:
    """Whether an `error`, in units of the noise, is lower than the error `without` something by a share `tolerance`.

    error^2 - 1 <= (1 - tolerance)^2 (without^2 - 1);  where `without` is within the noise, error <= without. A
    negligible rise is allowed in both cases.
    """
    if not math.isfinite(error):
        return False
    excess = (1.0 - tolerance) ** 2 * max(without**2 - 1.0, 0.0)
    return error**2 <= (excess + min(without**2, 1.0)) * (1.0 + NEGLIGIBLE_RISE) ** 2


@dataclass(eq=False)
class Explanation:
    """A set of additions, the fit with these alone, and what that leaves unexplained.

    among      the confirmation that weighs it against other sets
    additions  those of the search, in the order in which they came
    fit        of the model as it came with these
    """

    among: Confirmation
    additions: tuple[Addition, ...]
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """The sorted names of the additions."""
        return tuple(sorted(a.name for a in self.additions))

    @cached_property
    def error(self) -> HeldOutError:
        """The error on the records that no fit has seen."""
        return self.among.error(self.fit)

    @cached_property
    def fitted_error(self) -> float:
        """The error of predictions of the fitted samples, in units of the noise."""
        return fitted_error(self.fit, self.among.settings.ahead, self.among.sensor)

    @cached_property
    def missing(self) -> Array:
        """The missing torque (M,) [N m] over time, smoothed under the random torque `needed`."""
        return missing_torque(self.fit, self.among.needed)

    @cached_property
    def torque(self) -> MissingTorque:
        """The size of the missing torque, before the additions and with them."""
        drive = float(np.sqrt(np.mean(self.fit.linearised.drive_torques[self.fit.samples.follows] ** 2)))
        return MissingTorque(drive, *(float(np.sqrt(np.nanmean(e.missing**2))) for e in (self.among.bare, self)))

    @property
    def remains(self) -> bool:
        """Whether fitted samples are predicted with errors beyond the noise, and a random torque is needed or the
        errors are larger than any noise could be."""
        settings = self.among.settings
        # a shared error is known roughly
        limit = settings.unseen_error_factor if self.among.widened else math.sqrt(1.0 + settings.remaining_error**2)
        beyond = not self.fitted_error < limit
        return beyond and not (self.fit.undisturbed and self.fitted_error < settings.largest_noise)

    @property
    def fails_elsewhere(self) -> bool:
        """Whether held-out data are predicted much worse than the noise, and than the fitted samples."""
        limit = self.among.settings.unseen_error_factor * max(self.fitted_error, 1.0)
        return self.error.beyond_noise and not self.error.ratio < limit

    @cached_property
    def remaining(self) -> Remaining | None:
        """What matters and is not explained, if predictions err beyond the noise on fitted or on held-out samples."""
        share, after = max(0.0, 1.0 - 1.0 / max(self.error.ratio, 1e-9) ** 2), self.torque.after
        contacts = self.among.contacts
        if not contacts and not self.remains:
            return Remaining(share, (), "", after, unseen=True) if self.fails_elsewhere else None
        found = dependence(self.fit, self.missing)
        depends_on = (*(q for q in found.depends_on if q != "time"), "time") if contacts else found.depends_on
        return Remaining(share, depends_on, found.where, after)

    def without(self, left: Addition) -> Explanation:
        """The explanation without one of the additions; what that had replaced is there again."""
        return self.among.explanation(all_but(left, self.additions))

    def missing_over(self, quantity: str, alone: bool) -> float:
        """The mean square [N^2 m^2] of the missing torque if that is a function of the quantity `alone`, else of the
        part of it that the quantity predicts."""
        share = 1.0 if alone else dependence(self.fit, self.missing).shares.get(quantity, 0.0)
        return share * float(np.nanmean(self.missing**2))


@dataclass(eq=False)
class Confirmation:
    """The additions of a search that are believed, with the errors and missing torques on which that rests.

    base         fit of the model as it came
    held_out     records that no fit has seen
    contacts     stretches that a hand may have touched; if there are any, what remains depends on time
    sensor       the noise in whose units errors are given (`widened_sensor`)
    bare, now    the explanation without additions, and with those that stay
    unconfirmed  the names of the additions that were taken back
    weighed      names of additions -> the explanation by these
    as_likely    explanations by other sets of common frictions with which the log is about as likely
    friction     friction and load in the drive's torque, if no model explains how the motion follows from the torque
    """

    search: Search
    base: Fit
    held_out: Sequence[Record]
    contacts: tuple[Contact, ...]
    sensor: Sensor
    bare: Explanation = field(init=False)
    now: Explanation = field(init=False)
    unconfirmed: list[str] = field(init=False, default_factory=list)
    weighed: dict[tuple[str, ...], Explanation] = field(init=False, default_factory=dict)
    as_likely: list[Explanation] = field(init=False, default_factory=list)
    friction: FrictionAlong | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.bare = self.now = self._weigh((), self.base)
        self._confirm()
        self._take_back_imitations()
        self._compare_frictions()
        self._reconsider()
        self._weigh_friction()

    @property
    def settings(self) -> SearchSettings:
        """What counts as evidence, and what matters."""
        return self.search.settings

    @property
    def additions(self) -> tuple[Addition, ...]:
        """Those that stay."""
        return self.now.additions

    @property
    def widened(self) -> bool:
        """Whether an error that neighbouring readings share counts as the sensor's."""
        return self.sensor != self.search.sensor

    @cached_property
    def needed(self) -> Disturbances:
        """The random torque that the model as it came needs; all models are compared under it."""
        shared = self.search.end(self.base).likeliest_torque if self.widened else NO_DISTURBANCE
        return needed_disturbances(self.base, shared)

    @cached_property
    def held_out_balance(self) -> EnergyBalance | None:
        """The energy balance of held-out free swings; None if they are too few."""
        end = self.search.end(self.base).model
        return EnergyBalance.of(Samples(end, tuple(self.held_out), self.search.sensor), end)

    def error(self, fit: Fit) -> HeldOutError:
        """The error of a fitted model on the records that no fit has seen."""
        return held_out_error(fit.model, self.held_out, self.sensor, self.settings.ahead)

    def explanation(self, additions: Sequence[Addition]) -> Explanation:
        """The explanation by some of the additions that stay, or by what they replaced."""
        names = {a.name for a in additions}
        if (known := self.weighed.get(tuple(sorted(names)))) is not None:
            return known
        fit = self.now.fit
        for addition in self.now.additions:
            if addition.name not in names:
                fit = self.search.without(fit, addition, [own for own in addition.replaced if own.name in names])
        return self._weigh(additions, fit)

    def _weigh(self, additions: Sequence[Addition], fit: Fit) -> Explanation:
        found = Explanation(self, tuple(additions), fit)
        self.weighed[found.names] = found
        return found

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
        refined = {name for own in self.now.names for simpler in CATALOGUE[own].refines for name in simpler}
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
            self.now = self.now.without(gone)

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
        fewer = {left: self.now.without(left) for left in zeros if len(zeros) > 1}
        found = [
            left
            for left, own in fewer.items()
            if any(self._swells(a.name, own.fit, self.now.fit) for a in zeros if a is not left)
        ]
        return min(found, key=lambda left: fewer[left].error.ratio, default=None)

    def _is_sound(self, left: Addition) -> bool:
        """Whether the other additions are plausible without one more; and, if that is a common one, the rare ones among
        them are what they were. With quite other numbers they are another explanation, which no search has found."""
        fewer, now = self.now.without(left), self.now.fit
        rare = [a.name for a in fewer.additions if a in self.additions and self._is_rare(a)]
        others = any(self._swells(name, fewer.fit, now) or self._swells(name, now, fewer.fit) for name in rare)
        return (self._is_rare(left) or not others) and is_plausible(fewer.fit, fewer.names)

    def _first_to_go(self, needless: Sequence[Addition]) -> Addition:
        """Of several needless additions, the one without which the error is least. If that is a common one that raises
        no error and would pay without a rare one, which is needless too, that rare one goes in its place."""
        ratio = {a: self.now.without(a).error.ratio for a in needless}
        first, *others = sorted(needless, key=ratio.__getitem__)
        if not self._is_rare(first) and ratio[first] >= (1.0 - self.settings.tolerance) * self.now.error.ratio:
            for other in others:
                if self._is_rare(other) and not self._is_needless(first, self.now.without(other)):
                    return other
        return first

    def _is_rare(self, addition: Addition) -> bool:
        return CATALOGUE[addition.name].rarity >= self.settings.rare_from

    def _swells(self, name: str, before: Fit, after: Fit) -> bool:
        """Whether a number of an effect is larger by `swollen_factor` in the fit `after`, or has another sign."""
        for number in after.model.names_of(name):
            was, now = (float(own.model.parameters[number].value) for own in (before, after))
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
        without = present.without(left)
        if self._is_rare(left) and self.widened and not without.remains:
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
        balance = self.held_out_balance
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
            self.now = self.now.without(imitation)
            self._drop_needless()
        self.unconfirmed += [a.name for a in before if a not in self.additions]

    def _imitation(self) -> Addition | None:
        """The first of the additions that imitates something unknown; None if none does."""
        if not math.isfinite(self.now.error.ratio):
            return None
        for addition in self.additions:
            fewer = self.now.without(addition)
            if not math.isfinite(fewer.error.ratio):  # without it the model runs away
                continue
            if self._losses_confirm(self.now, fewer):
                continue
            # an error that speeds share took the torque's place in the fit, and bent the numbers of the poorer model
            comparable = not self.base.samples.shared
            more = comparable and self.now.torque.after > (1.0 + self.settings.tolerance) * fewer.torque.after
            worse = more and not is_lowered(self.now.error.ratio, fewer.error.ratio, self.settings.decisive_fall)
            if worse or self._is_part_of_unknown(addition, fewer):
                return addition
        return None

    def _is_part_of_unknown(self, addition: Addition, fewer: Explanation) -> bool:
        """Whether an addition is a part of something unknown; `fewer` is the explanation without it. A zero of a free
        swing is none: every sensor has one, whatever else depends on the angle."""
        kind, remaining = CATALOGUE[addition.name], self.now.remaining
        imitates, is_zero = kind.imitates, kind.moves_rest and not self.base.samples.driven
        if not imitates or is_zero or remaining is None or imitates not in remaining.depends_on:
            return False
        alone = remaining.depends_on == (imitates,)
        after, before = (own.missing_over(imitates, alone) for own in (self.now, fewer))
        bent = self.now.fit.at_bounds - self.base.at_bounds
        return bool(bent) or after > (1.0 - self.settings.explained_share) * before

    def _compare_frictions(self) -> None:
        """Compare all sets of common frictions: keep the likeliest, and tell which others are about as likely.

        A search adds one friction after the other, and stays with the first one where two explain more together. A set
        is kept in place of the named one if it is likelier, its sizes are sure, it does not raise the held-out error,
        and none of it is needless.
        """
        named, others = self.now, list(self._other_frictions())
        loss = {own: self._loss(own) for own in ((named, *others) if others else ())}
        sure = (own for own in loss if self._least_size(own) > self.settings.sure_size)
        for likelier in sorted((own for own in sure if loss[own] < 0.0), key=loss.__getitem__):
            if is_plausible(likelier.fit, likelier.names) and not self._raises_error(likelier, named):
                self.now = likelier
                self._drop_needless()
                if self.now is likelier:
                    self.unconfirmed = [name for name in self.unconfirmed if name not in likelier.names]
                    break
                self.now = named
        if not set(FRICTIONS).isdisjoint(self.now.names):
            rest = [own for own in loss if own is not self.now and self._is_as_good(own)]
            self.as_likely = [own for own in rest if loss[own] - loss[self.now] < self.settings.close_deviance]

    def _other_frictions(self) -> Iterator[Explanation]:
        """The explanations with other sets of common frictions in place of those that are named; and of a free swing,
        which always loses energy, also if none is named. There are none where likelihood has decided, since the model
        of a driven log needs no random torque."""
        known = {a.name: a for a in self.additions if a.name in FRICTIONS}
        if self.base.samples.driven and (not known or self.now.fit.undisturbed):
            return
        first = min(map(self.additions.index, known.values()), default=len(self.additions))
        others = [a for a in self.additions if a.name not in known]
        fewer = balanced(self.explanation(others).fit, self.now.fit.balance)
        tested = self.search.tested(fewer)
        possible = [n for n in FRICTIONS if n in known or (n in tested and tested[n].visible)]
        sets = (own for k in range(1, len(possible) + 1) for own in combinations(possible, k))
        for names in (own for own in sets if set(own) != set(known)):
            for trial in self.search.trial(fewer, names):
                fit = settled(trial.fit)
                p = p_value(fewer.deviance - fit.deviance, len(names))
                new = [known.get(n) or Addition(n, self.search.inseparable(n), (), p) for n in names]
                yield self._weigh((*others[:first], *new, *others[first:]), fit)

    def _loss(self, other: Explanation) -> float:
        """By how much another set of frictions is less likely than the named one: the rise of the deviance, divided by
        the larger excess of the two, and the price of its numbers. All of FRICTIONS are as common here."""
        excess = max(excess_of(own.fit, FRICTIONS) for own in (other, self.now))
        more = len(other.additions) - len(self.now.additions)
        return (other.fit.deviance - self.now.fit.deviance) / excess + self.settings.price * more

    def _least_size(self, own: Explanation) -> float:
        """The least squared size of the common frictions of an explanation; 0 if it has none."""
        return min((squared_size(own.fit, n) for n in own.names if n in FRICTIONS), default=0.0)

    def _is_as_good(self, other: Explanation) -> bool:
        """Whether another set of frictions is plausible, with sizes beyond their standard deviations, and predicts
        held-out data no worse by what matters."""
        worse = is_lowered(self.now.error.ratio, other.error.ratio, self.settings.tolerance)
        return self._least_size(other) > 1.0 and is_plausible(other.fit, other.names) and not worse

    def _reconsider(self) -> None:
        """Add effects that are sure but too small to matter in the motion that was searched, if they matter in the
        held-out motion, which goes further."""
        for name in self.search.negligible:
            end = self.now.fit
            related = {name, *CATALOGUE[name].contains}.intersection(self.now.names)
            if related or name in contained_in(end.model.effects) or not self.now.fails_elsewhere or self.now.remains:
                continue
            found = scores(end, (name,)).get(name)
            if found is None or not found.visible:
                continue
            fit = settled(extended(end, [found.best.at(found.sizes)], QUICK))
            p = p_value(end.deviance - fit.deviance, found.numbers)
            more = self._weigh((*self.additions, Addition(name, self.search.inseparable(name), (), p)), fit)
            sound = is_plausible(fit, (name,)) and not is_undetermined(fit, name)
            if sound and more.error.ratio < self.now.error.ratio * (1.0 - self.settings.tolerance):
                self.now = more

    def _weigh_friction(self) -> None:
        """Answer with friction along the motion, and no effect, if the motion does not follow from the torque.

        That is so if friction and load explain nearly all of the drive's torque, while the additions leave more torque
        missing than the drive has, or too much beside what friction and load leave (`_leaves_more`).
        """
        found = self._friction_along()
        if found is None or not (self.now.torque.overwhelms or self._leaves_more(found)):
            return
        if self.now.remaining is not None:
            self.friction, self.now, self.unconfirmed, self.as_likely = found, self.bare, [], []

    def _leaves_more(self, found: FrictionAlong) -> bool:
        """Whether the additions leave more torque missing than friction along the motion does.

        If an inertia shows in the torque, that has to be more by `farther_factor`, and predictions have to err beyond
        the noise. And the additions have to be wrong: there are none, or they lack the dry friction that shows, or the
        inertia beside them is another (`inertia_factor`).
        """
        torque, end = self.now.torque, self.now.fit
        more = torque.after / max(math.sqrt(1.0 - found.share) * torque.drive, 1e-300)
        if not found.shows_inertia:
            return more > 1.0
        if more <= self.settings.farther_factor or self.now.error.ratio < 1.0:
            return False
        another = found.contradicts(end.inertia, self.settings.inertia_factor)
        lacking = found.shows_dry_friction and not any(e.is_dry for e in end.model.effects)
        return another or lacking or not self.additions

    def _friction_along(self) -> FrictionAlong | None:
        search = self.search
        return friction_along(self.base.model, self.base.names, search.records, self.held_out, search.sensor)
