"""Explanation: a set of additions with its fit, what that predicts, and what it leaves unexplained."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.diagnosis.answer import MissingTorque, Remaining
from sysid.diagnosis.contacts import Contact
from sysid.diagnosis.dependence import dependence
from sysid.diagnosis.residual_torque import missing_torque, needed_disturbances
from sysid.diagnosis.search import Addition, Search
from sysid.diagnosis.search_settings import SearchSettings
from sysid.estimation.disturbances import NO_DISTURBANCE, Disturbances
from sysid.estimation.energy_balance import EnergyBalance
from sysid.estimation.held_out import HeldOutError, held_out_error
from sysid.estimation.horizon_fit import HorizonFit, horizon_fit
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import fitted_error
from sysid.estimation.prediction_error import LARGEST_NOISE, Fit
from sysid.estimation.torque_regression import FrictionAlong, friction_along
from sysid.physics.effects import Effect
from sysid.physics.model import Model
from sysid.physics.ops import Array


@dataclass(eq=False)
class Evidence:
    """What all explanations of a log are judged by.

    search    the search that found the additions
    base      fit of the model as it came
    held_out  records that no fit has seen
    contacts  stretches in which something outside acted; if there are any, what remains depends on time
    sensor    the noise in whose units errors are given (`widened_sensor`)
    """

    search: Search
    base: Fit
    held_out: Sequence[Record]
    contacts: tuple[Contact, ...]
    sensor: Sensor

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

    @cached_property
    def bare(self) -> Explanation:
        """The explanation without additions."""
        return Explanation(self, (), self.base)

    @cached_property
    def held_out_balance(self) -> EnergyBalance | None:
        """The energy balance of held-out free swings; None if they are too few."""
        end = self.search.end(self.base).model
        return EnergyBalance.of(Samples(end, tuple(self.held_out), self.search.sensor), end)

    def error(self, fit: Fit) -> HeldOutError:
        """The error of a fitted model on the records that no fit has seen."""
        return held_out_error(fit.model, self.held_out, self.sensor, self.settings.ahead)


@dataclass(eq=False)
class Explanation:
    """A set of additions, the fit with these alone, and what that leaves unexplained.

    evidence   what it is judged by
    additions  those of the search, in the order in which they came
    fit        of the model as it came with these
    """

    evidence: Evidence
    additions: tuple[Addition, ...]
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """The sorted names of the additions."""
        return tuple(sorted(a.name for a in self.additions))

    @cached_property
    def error(self) -> HeldOutError:
        """The error on the records that no fit has seen."""
        return self.evidence.error(self.fit)

    @cached_property
    def fitted_error(self) -> float:
        """The error of predictions of the fitted samples, in units of the noise."""
        return fitted_error(self.fit, self.evidence.settings.ahead, self.evidence.sensor)

    @cached_property
    def missing(self) -> Array:
        """The missing torque (M,) [N m] over time, smoothed under the random torque that is `needed`."""
        return missing_torque(self.fit, self.evidence.needed)

    @cached_property
    def torque(self) -> MissingTorque:
        """The size of the missing torque, before the additions and with them."""
        drive = float(np.sqrt(np.mean(self.fit.linearised.drive_torques[self.fit.samples.follows] ** 2)))
        return MissingTorque(drive, *(float(np.sqrt(np.nanmean(e.missing**2))) for e in (self.evidence.bare, self)))

    @property
    def remains(self) -> bool:
        """Whether fitted samples are predicted with errors beyond the noise, and a random torque is needed or the
        errors are larger than any noise could be."""
        settings = self.evidence.settings
        # a shared error is known roughly
        limit = settings.unseen_error_factor if self.evidence.widened else math.sqrt(1.0 + settings.remaining_error**2)
        beyond = not self.fitted_error < limit
        return beyond and not (self.fit.undisturbed and self.fitted_error < LARGEST_NOISE)

    @property
    def fails_elsewhere(self) -> bool:
        """Whether held-out data are predicted much worse than the noise, and than the fitted samples."""
        limit = self.evidence.settings.unseen_error_factor * max(self.fitted_error, 1.0)
        return self.error.beyond_noise and not self.error.ratio < limit

    @cached_property
    def remaining(self) -> Remaining | None:
        """What matters and is not explained, if predictions err beyond the noise on fitted or on held-out samples."""
        share, after = max(0.0, 1.0 - 1.0 / max(self.error.ratio, 1e-9) ** 2), self.torque.after
        contacts = self.evidence.contacts
        if not contacts and not self.remains:
            return Remaining(share, (), "", after, unseen=True) if self.fails_elsewhere else None
        over = dependence(self.fit, self.missing)
        depends_on = (*(q for q in over.depends_on if q != "time"), "time") if contacts else over.depends_on
        return Remaining(share, depends_on, over.where, after)

    @cached_property
    def predicting_best(self) -> Explanation | None:
        """The same additions with the numbers that predict best (`horizon_fit`), if there are such numbers."""
        fit = None if isinstance(self.fit, HorizonFit) else horizon_fit(self.fit, self.evidence.settings.ahead)
        return None if fit is None else Explanation(self.evidence, self.additions, fit)

    @cached_property
    def friction_along(self) -> FrictionAlong | None:
        """Friction and load in the drive's torque along the motion (`friction_shown`)."""
        return friction_shown(self.evidence.search, self.evidence.base, self.fit, self.evidence.held_out)

    def missing_over(self, quantity: str, alone: bool) -> float:
        """The mean square [N^2 m^2] of the missing torque if that is a function of the quantity `alone`, else of the
        part of it that the quantity predicts."""
        share = 1.0 if alone else dependence(self.fit, self.missing).shares.get(quantity, 0.0)
        return share * float(np.nanmean(self.missing**2))

    @property
    def is_led(self) -> bool:
        """Whether the motion does not follow from the torque: friction and load along the motion explain nearly all of
        the drive's torque, while the additions leave more torque missing than the drive has, or too much beside what
        friction and load leave (`leaves_more_than`)."""
        along = self.friction_along
        return along is not None and (self.torque.overwhelms or self.leaves_more_than(along))

    def leaves_more_than(self, along: FrictionAlong) -> bool:
        """Whether the additions leave more torque missing than friction along the motion does.

        If an inertia shows in the torque, that has to be more by `farther_factor`, and predictions have to err beyond
        the noise. And the additions have to be wrong: there are none, or they lack the dry friction that shows, or the
        inertia beside them is another (`inertia_factor`). They never yield to what lacks a dry friction of theirs.
        """
        settings, dry = self.evidence.settings, any(e.is_dry for e in self.fit.model.effects)
        if dry and not along.has_dry_friction:
            return False
        more = self.torque.after / max(math.sqrt(1.0 - along.share) * self.torque.drive, 1e-300)
        if not along.shows_inertia:
            return more > 1.0
        if more <= settings.farther_factor or self.error.ratio < 1.0:
            return False
        another = along.contradicts(self.fit.inertia, settings.inertia_factor)
        return another or (along.shows_dry_friction and not dry) or not self.additions


def friction_shown(search: Search, base: Fit, end: Fit, unseen: Sequence[Record]) -> FrictionAlong | None:
    """Friction and load in the drive's torque along the motion, if they show also in the records `unseen`.

    The torque passes through the `late_effects` of the fit `end`: a regression takes what comes late for an inertia.
    """
    late = reduce(Model.with_effect, late_effects(base, end), base.model)
    seen, others = ([delivered(late, r) for r in records] for records in (search.records, unseen))
    return friction_along(base.model, base.names, seen, others, search.sensor)


def late_effects(base: Fit, end: Fit) -> list[Effect]:
    """The delays and lags of the drive that a fit has beyond those of the model as it came."""
    added = (e for e in end.model.input_effects if e.name not in base.model.effect_names)
    return [e for e in added if e.rest(base.model.dt)]  # what remembers is late


def delivered(model: Model, record: Record) -> Record:
    """The record with the commands that a model's input effects pass on, in the mean over each interval."""
    if not model.input_effects:
        return record
    passed = np.mean(model.drive_record(record.commands), axis=-1)
    return replace(record, u=passed[len(record.previous_commands) :])
