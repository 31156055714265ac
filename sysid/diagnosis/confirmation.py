"""Confirmation: which additions of a search are believed, by held-out data and by the torque that remains missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.diagnosis.answer import MissingTorque, Remaining
from sysid.diagnosis.contacts import Contact
from sysid.diagnosis.criteria import is_nothing, is_plausible, is_undetermined, shows_in_balance, squared_size
from sysid.diagnosis.dependence import dependence
from sysid.diagnosis.residual_torque import missing_torque, needed_disturbances
from sysid.diagnosis.search import Addition, Search, all_but, contained_in
from sysid.diagnosis.search_settings import SearchSettings
from sysid.estimation.disturbances import NO_DISTURBANCE, Disturbances
from sysid.estimation.held_out import HeldOutError, held_out_error
from sysid.estimation.likelihood import p_value
from sysid.estimation.prediction import fitted_error
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended, settled
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


def names_added(additions: Sequence[Addition]) -> tuple[str, ...]:
    """The sorted names of additions, as a key."""
    return tuple(sorted(a.name for a in additions))


@dataclass(eq=False)
class Confirmation:
    """The additions of a search that are believed, with the errors and missing torques on which that rests.

    base         fit of the model as it came
    held_out     records that no fit has seen
    contacts     stretches that a hand may have touched; if there are any, what remains depends on time
    sensor       the noise in whose units errors are given (`widened_sensor`)
    additions    those that stay; unconfirmed: the names of those that were taken back
    errors       names of additions -> the fit with these alone, and its held-out error
    fitted       fit -> its error on the samples that were fitted; torques: fit -> the torque that it leaves missing
    friction     friction and load in the drive's torque, if no model explains how the motion follows from the torque
    """

    search: Search
    base: Fit
    held_out: Sequence[Record]
    contacts: tuple[Contact, ...]
    sensor: Sensor
    additions: list[Addition] = field(init=False, default_factory=list)
    unconfirmed: list[str] = field(init=False, default_factory=list)
    errors: dict[tuple[str, ...], tuple[Fit, HeldOutError]] = field(init=False, default_factory=dict)
    fitted: dict[Fit, float] = field(init=False, default_factory=dict)
    torques: dict[Fit, Array] = field(init=False, default_factory=dict)
    friction: FrictionAlong | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.errors[()] = self.base, self.error(self.base)
        self._confirm()
        self._unmask()
        self._reconsider()
        self._weigh_friction()

    @property
    def settings(self) -> SearchSettings:
        """What counts as evidence, and what matters."""
        return self.search.settings

    @property
    def widened(self) -> bool:
        """Whether an error that neighbouring readings share counts as the sensor's."""
        return self.sensor != self.search.sensor

    @cached_property
    def needed(self) -> Disturbances:
        """The random torque that the model as it came needs; all models are compared under it."""
        shared = self.search.end(self.base).likeliest_torque if self.widened else NO_DISTURBANCE
        return needed_disturbances(self.base, shared)

    def error(self, fit: Fit) -> HeldOutError:
        """The error of a fitted model on the records that no fit has seen."""
        return held_out_error(fit.model, self.held_out, self.sensor, self.settings.ahead)

    def fit_with(self, additions: Sequence[Addition]) -> tuple[Fit, HeldOutError]:
        """The fit with these additions alone, and its error."""
        names = names_added(additions)
        if names not in self.errors:
            fit, _ = self.errors[names_added(self.additions)]
            for addition in self.additions:
                if addition.name not in names:
                    fit = self.search.without(fit, addition, [own for own in addition.replaced if own.name in names])
            self.errors[names] = (fit, self.error(fit))
        return self.errors[names]

    def torque(self, end: Fit) -> MissingTorque:
        """The size of the missing torque, before and after the additions."""
        drive = float(np.sqrt(np.mean(end.linearised.drive_torques[end.samples.follows] ** 2)))
        return MissingTorque(drive, *(float(np.sqrt(np.nanmean(self.missing(f) ** 2))) for f in (self.base, end)))

    def missing(self, fit: Fit) -> Array:
        """The missing torque (M,) [N m] of a fit over time, smoothed under the random torque `needed`."""
        if fit not in self.torques:
            self.torques[fit] = missing_torque(fit, self.needed)
        return self.torques[fit]

    def remaining(self, end: Fit, error: HeldOutError, torque: MissingTorque) -> Remaining | None:
        """What matters and is not explained, if predictions err beyond the noise on fitted or on held-out samples."""
        share = max(0.0, 1.0 - 1.0 / max(error.ratio, 1e-9) ** 2)
        if not self.contacts and not self._remains(end):
            elsewhere = self._fails_elsewhere(end, error)
            return Remaining(share, (), "", torque.after, unseen=True) if elsewhere else None
        found = dependence(end, self.missing(end))
        depends_on = (*(q for q in found.depends_on if q != "time"), "time") if self.contacts else found.depends_on
        return Remaining(share, depends_on, found.where, torque.after)

    def fitted_error(self, end: Fit) -> float:
        """The error of predictions of the fitted samples; it is kept, since it is needed several times."""
        if end not in self.fitted:
            self.fitted[end] = fitted_error(end, self.settings.ahead, self.sensor)
        return self.fitted[end]

    def _confirm(self) -> None:
        """Keep the last stage of the search that does not raise the held-out error, without its needless additions."""
        best = self.errors[()][1].ratio
        for additions, fit in self.search.stages:
            error = self.error(fit)
            self.errors[names_added(additions)] = fit, error
            if error.ratio <= best * (1.0 + NEGLIGIBLE_RISE) or not math.isfinite(best):
                best, self.additions = min(best, error.ratio), list(additions)
        chosen = set(names_added(self.additions))
        self._drop_needless()
        self._return_to_earlier(chosen.difference(names_added(self.additions)))
        kept = names_added(self.additions)
        tried = dict.fromkeys(a.name for additions, _ in self.search.stages for a in additions)
        refined = {name for own in kept for simpler in CATALOGUE[own].refines for name in simpler}
        self.unconfirmed = [name for name in tried if name not in kept and name not in refined]

    def _return_to_earlier(self, dropped: set[str]) -> None:
        """If what was dropped had taken the place of another addition, keep the last stage with that one beside what is
        left, without its needless additions, if this lowers the held-out error by what matters."""
        kept = self.additions
        for additions, _ in reversed(self.search.stages):
            names = set(names_added(additions))
            if dropped and dropped.isdisjoint(names) and names > set(names_added(kept)):
                self.additions = list(additions)
                self._drop_needless()
                now, before = (self.fit_with(own)[1].ratio for own in (self.additions, kept))
                if is_lowered(now, before, self.settings.tolerance):
                    return
                self.additions = kept

    def _drop_needless(self) -> None:
        """Drop needless additions one after the other; what is left errs no more than the model as it came.

        An addition is needless if it raises the held-out error, or does not lower it by what matters (times its rarity,
        and beside others by as much again; if it is `rare` and other effects still promise something, by `halved`); if
        its size is compatible with 0 or not determined by the readings; if no machine has its numbers; or if another
        makes up for it (`_making_up`).
        """
        while self.additions:
            end, error = self.fit_with(self.additions)
            sound = [a for a in self.additions if self._is_sound(a, end)] or self.additions
            pay = is_lowered(error.ratio, self.errors[()][1].ratio, 0.0)
            needless = [a for a in sound if not pay or self._is_needless(a, self.additions)]
            if needless:
                self.additions = all_but(self._first_to_go(needless), self.additions)
                continue
            rarest = sorted(self.additions, key=lambda a: CATALOGUE[a.name].rarity, reverse=True)
            nothing = [a for a in self.additions if is_nothing(end, a.name, self.settings.sure)]
            nothing.sort(key=lambda a: squared_size(end, a.name))
            nothing += [a for a in rarest if is_undetermined(end, a.name) or not is_plausible(end, (a.name,))]
            nothing += [] if nothing else self._making_up(end)
            if not nothing:
                break
            self.additions = all_but(nothing[0], self.additions)

    def _making_up(self, end: Fit) -> list[Addition]:
        """Of two zeros of a free swing that make up for each other, the one without which less is lost.

        Each moves the angle at which it comes to rest. If one alone is at most a third as large as beside the other, or
        has the other sign, the two imitate an angle that is not told on one scale.
        """
        zeros = [a for a in self.additions if CATALOGUE[a.name].moves_rest]
        if len(zeros) < 2 or end.samples.driven:
            return []
        found: list[tuple[float, Addition]] = []
        for left in zeros:
            fewer, error = self.fit_with(all_but(left, self.additions))
            if any(self._swells(a.name, fewer, end) for a in zeros if a is not left):
                found.append((error.ratio, left))
        return [min(found, key=lambda own: own[0])[1]] if found else []

    def _is_sound(self, left: Addition, end: Fit) -> bool:
        """Whether the other additions are plausible without one more; and, if that is a common one, the rare ones among
        them are what they were. With quite other numbers they are another explanation, which no search has found."""
        fewer = all_but(left, self.additions)
        fit, _ = self.fit_with(fewer)
        rare = [a.name for a in fewer if a in self.additions and CATALOGUE[a.name].rarity >= self.settings.rare]
        others = any(self._swells(name, fit, end) or self._swells(name, end, fit) for name in rare)
        common = CATALOGUE[left.name].rarity < self.settings.rare
        return not (common and others) and is_plausible(fit, names_added(fewer))

    def _first_to_go(self, needless: Sequence[Addition]) -> Addition:
        """Of several needless additions, the one without which the error is least. If that is a common one that raises
        no error and would pay without a rare one, which is needless too, that rare one goes in its place."""
        ratio = {a.name: self.fit_with(all_but(a, self.additions))[1].ratio for a in needless}
        first, *others = sorted(needless, key=lambda a: ratio[a.name])
        present = self.fit_with(self.additions)[1].ratio
        common = CATALOGUE[first.name].rarity < self.settings.rare
        if common and ratio[first.name] >= (1.0 - self.settings.tolerance) * present:
            for other in others:
                rare = CATALOGUE[other.name].rarity >= self.settings.rare
                if rare and not self._is_needless(first, all_but(other, self.additions)):
                    return other
        return first

    def _swells(self, name: str, before: Fit, after: Fit) -> bool:
        """Whether a number of an effect is `swollen` in the fit `after`, or has another sign."""
        for number in after.model.names_of(name):
            was, now = (float(own.model.parameters[number].value) for own in (before, after))
            if was * now < 0.0 or abs(now) > self.settings.swollen * abs(was):
                return True
        return False

    def _is_needless(self, left: Addition, among: Sequence[Addition]) -> bool:
        """Whether one `among` additions does not lower the held-out error by as much as it has to. If nothing remains
        with it, and something without it, or if it is a friction that an energy balance shows, it need not lower that
        error. If nothing remains without it beside an error that readings share, a rare one is needless: it is likelier
        a part of that error."""
        end, error = self.fit_with(among)
        fewer = all_but(left, among)
        poorer, its_error = self.fit_with(fewer)
        without, least = its_error.ratio, self.settings.tolerance
        rarity = CATALOGUE[left.name].rarity
        if rarity < self.settings.rare:
            enough = is_lowered(error.ratio, without, min(least * (rarity + bool(fewer)), 1.0))
        elif self.widened and not self._remains(poorer):
            return True
        else:
            halved = is_lowered(error.ratio, without, max(least, self.settings.halved))
            enough = halved and error.ratio <= (1.0 - least) * without
        if enough or not is_lowered(error.ratio, without, 0.0):
            return not enough
        if shows_in_balance(poorer.model, end, self.settings):
            return False
        if rarity >= self.settings.rare and not self._another_pays(end):
            return False
        return self._remains(end) or not self._remains(poorer)

    def _another_pays(self, end: Fit) -> bool:
        """Whether another effect of the catalogue is expected to pay. If none is, what remains looks random beside this
        model: it hides a rare effect in the error of predictions, but it does not imitate one."""
        promise = self.search.promise(self.search.tested(end))
        return any(merit > 0.0 for merit in promise.values())

    def _unmask(self) -> None:
        """Take back additions that mask something unknown, and confirm the others anew after each.

        There are two cases. More torque, by what matters, is missing with the addition than without it, and it does not
        halve the held-out error beyond the noise. Or what remains depends on the one quantity of which the effect is a
        function, and the effect explains less than `most` of it (if it depends on others, too, of the part of it that
        this quantity predicts), or only with a number driven to its bound.
        """
        before = list(self.additions)
        while (masking := self._masking()) is not None:
            self.additions = all_but(masking, self.additions)
            self._drop_needless()
        self.unconfirmed += [a.name for a in before if a not in self.additions]

    def _masking(self) -> Addition | None:
        """The first of the additions that masks something unknown; None if none does."""
        end, error = self.fit_with(self.additions)
        if not math.isfinite(error.ratio):
            return None
        torque = self.torque(end)
        for addition in self.additions:
            fewer, its_error = self.fit_with(all_but(addition, self.additions))
            if not math.isfinite(its_error.ratio):  # without it the model runs away
                continue
            without = self.torque(fewer).after
            # an error that speeds share took the torque's place in the fit, and bent the numbers of the poorer model
            comparable = not self.base.samples.shared
            more = comparable and torque.after > (1.0 + self.settings.tolerance) * without
            worse = more and not is_lowered(error.ratio, its_error.ratio, self.settings.telling)
            if worse or self._hides(addition, end, error, torque, fewer):
                return addition
        return None

    def _hides(self, addition: Addition, end: Fit, error: HeldOutError, torque: MissingTorque, fewer: Fit) -> bool:
        """Whether an addition is a part of something unknown; `fewer` is the fit without it."""
        imitates = CATALOGUE[addition.name].imitates
        if not imitates:
            return False
        remaining = self.remaining(end, error, torque)
        if remaining is None or imitates not in remaining.depends_on:
            return False
        alone = remaining.depends_on == (imitates,)
        after, before = (self._missing_over(imitates, fit, alone) for fit in (end, fewer))
        bent = end.at_bounds - self.base.at_bounds
        return bool(bent) or after > (1.0 - self.settings.most) * before

    def _missing_over(self, quantity: str, fit: Fit, alone: bool) -> float:
        """The mean square [N^2 m^2] of a fit's missing torque if it is a function of that quantity `alone`, else of the
        part of it that the quantity predicts."""
        missing = self.missing(fit)
        share = 1.0 if alone else dependence(fit, missing).shares.get(quantity, 0.0)
        return share * float(np.nanmean(missing**2))

    def _reconsider(self) -> None:
        """Add effects that are sure but too small to matter in the motion that was searched, if they matter in the
        held-out motion, which goes further."""
        for name in self.search.negligible:
            end, error = self.fit_with(self.additions)
            present = {name, *CATALOGUE[name].contains}.intersection(names_added(self.additions))
            if present or name in contained_in(end.model.effects):
                continue
            if not self._fails_elsewhere(end, error) or self._remains(end):
                continue
            found = scores(end, (name,)).get(name)
            if found is None or not found.visible:
                continue
            fit = settled(extended(end, [found.best.at(found.sizes)], QUICK))
            after = self.error(fit)
            sound = is_plausible(fit, (name,)) and not is_undetermined(fit, name)
            if sound and after.ratio < error.ratio * (1.0 - self.settings.tolerance):
                p = p_value(end.deviance - fit.deviance, found.numbers)
                self.additions = [*self.additions, Addition(name, self.search.inseparable(name), (), p)]
                self.errors[names_added(self.additions)] = (fit, after)

    def _weigh_friction(self) -> None:
        """Answer with friction along the motion, and no effect, if the motion does not follow from the torque.

        That is so if friction and load explain nearly all of the drive's torque, while the additions leave more torque
        missing than the drive has, or too much beside what friction and load leave (`_leaves_more`).
        """
        found = self._friction_along()
        if found is None:
            return
        end, error = self.fit_with(self.additions)
        torque = self.torque(end)
        if not (torque.overwhelms or self._leaves_more(found, end, error, torque)):
            return
        if self.remaining(end, error, torque) is not None:
            self.friction, self.additions, self.unconfirmed = found, [], []

    def _leaves_more(self, found: FrictionAlong, end: Fit, error: HeldOutError, torque: MissingTorque) -> bool:
        """Whether the additions leave more torque missing than friction along the motion does, and no inertia shows.
        If one shows, they have to leave `farther` times as much, and predictions to err beyond the noise; and there are
        no additions, or they lack the dry friction that shows, or the inertia beside them is quite `another`."""
        more = torque.after / max(math.sqrt(1.0 - found.share) * torque.drive, 1e-300)
        if not found.shows_inertia:
            return more > 1.0
        if more <= self.settings.farther or error.ratio < 1.0:
            return False
        another = found.contradicts(end.inertia, self.settings.another)
        lacking = found.shows_dry_friction and not any(e.is_dry for e in end.model.effects)
        return another or lacking or not self.additions

    def _friction_along(self) -> FrictionAlong | None:
        search = self.search
        return friction_along(self.base.model, self.base.names, search.records, self.held_out, search.sensor)

    def _remains(self, end: Fit) -> bool:
        """Whether fitted samples are predicted with errors beyond the noise, and a random torque is needed or the
        errors are larger than any noise could be."""
        settings = self.settings
        # a shared error is known roughly
        limit = settings.worse if self.widened else math.sqrt(1.0 + settings.enough**2)
        beyond = not self.fitted_error(end) < limit
        return beyond and not (end.undisturbed and self.fitted_error(end) < settings.largest_noise)

    def _fails_elsewhere(self, end: Fit, error: HeldOutError) -> bool:
        """Whether held-out data are predicted much worse than the noise, and than the fitted samples."""
        return error.beyond_noise and not error.ratio < self.settings.worse * max(self.fitted_error(end), 1.0)
