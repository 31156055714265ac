"""diagnose: from a model and a log to the effect that is missing, with the evidence and its size."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from scipy.special import chdtrc

from sysid.data.logs import notes_of
from sysid.data.record import Record, check_records, unique_names
from sysid.data.sensor import Sensor
from sysid.diagnosis.answer import Diagnosis, MissingTorque, Remaining, Step
from sysid.diagnosis.contacts import Contact, find_contacts
from sysid.diagnosis.dependence import dependence
from sysid.diagnosis.findings import fitted_numbers
from sysid.diagnosis.ranked import Ranked
from sysid.diagnosis.residual_torque import missing_torque, needed_disturbances, residual_torque
from sysid.diagnosis.search import Addition, Search, is_nothing
from sysid.diagnosis.search_settings import DEFAULT, SearchSettings
from sysid.errors import InvalidInput
from sysid.estimation.channels import relied_on
from sysid.estimation.estimate import Estimate
from sysid.estimation.fit import free
from sysid.estimation.held_out import HeldOutError, held_out_error
from sysid.estimation.prediction import fitted_error
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended, reduced, settled
from sysid.estimation.scores import alikeness, price, scores
from sysid.estimation.solver import QUICK
from sysid.physics.effects import CATALOGUE, effect
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.planning.planned_experiment import Experiment

MOST_RESTARTS = 2
"""What a hand touched is left out and the search begun anew, at most so often."""

LEAST_LEFT = 0.6
"""The share of a log that has to be left beside what a hand touched, or nothing is left out."""

DETECTABLE = 3.9
"""Size, in its standard deviations, that is found in 80 % of logs at the price that an effect has to pay."""

FELL = 5e-3
"""A fall of the held-out error by less than this share is told together with that of the next step."""

NEGLIGIBLE_RISE = 1e-3
"""A rise of the held-out error by less than this share is not printed, and counts as none."""


def diagnose(
    model: Model | Estimate,
    records: Sequence[Record],
    sensor: Sensor | None = None,
    hold_out: float | None = None,
    effects: Iterable[str] | None = None,
    parameters: Sequence[str] | None = None,
    settings: SearchSettings = DEFAULT,
) -> Diagnosis:
    """Which physical effect is missing, how large is it, and does it matter?

    Beside the model acts a random torque, whose size and correlation time the log tells. An effect is added where it
    explains what the random torque had to: where the likelihood gains more than the effect's numbers and its rarity
    cost, predictions on left-out stretches are no worse, and what it changes matters. So it goes on until nothing
    pays; in the end no effect stays that raises the error on the held-out data.

    Parameters
    ----------
    model : Model or Estimate
        The model as it came. Of an estimate the free parameters are refitted; the others keep their numbers.
    records : sequence of Record
        At least one rollout. Stretches that a hand touched are left out of the search, and named.
    sensor : Sensor, optional
        Noise of the readings; by default the estimate's, else found from the records without any model.
    hold_out : float, optional
        A share, or a count, of the records that no fit sees.
    effects : iterable of str, optional
        Names of the effects that may be missing; by default the whole catalogue.
    parameters : sequence of str, optional
        The free parameters; by default the estimate's, or all but gravity.
    settings : SearchSettings, optional
        What counts as evidence, and what matters.

    Returns
    -------
    Diagnosis
        The verdict with its evidence, and the mended model.

    Raises
    ------
    InvalidInput
        For unusable records and unknown names.

    Notes
    -----
    Kristensen, Madsen, Jorgensen, "A method for systematic improvement of stochastic grey-box models", Computers and
    Chemical Engineering 28 (2004) 1431. Brynjarsdottir, O'Hagan, Inverse Problems 30 (2014) 114007, show what leaving
    the random torque out does to intervals.
    """
    from sysid.data.splitting import split

    began = time.perf_counter()
    notes = notes_of(records)
    records = unique_names(check_records(model.model if isinstance(model, Estimate) else model, records))
    if parameters is None:
        parameters = model.names if isinstance(model, Estimate) else free(model)
    names = tuple(parameters)
    if isinstance(model, Estimate):
        sensor, model = sensor or model.sensor, model.model
    chosen = None if effects is None else _known(effects)
    if sensor is None:
        from sysid.data.noise import sensor_noise

        sensor = sensor_noise(records).sensor
    training, held_out = split(records, hold_out)
    sensor = relied_on(model, training, sensor)
    search, base, contacts = _searched(lambda left: Search(left, sensor, chosen, settings), training, model, names)
    held_out, more = _untouched(search, base, held_out)
    return _Report(search, base, records, held_out, sensor, (*contacts, *more), notes).diagnosis(began)


def _searched(
    search_in: Callable[[Sequence[Record]], Search], records: Sequence[Record], model: Model, names: tuple[str, ...]
) -> tuple[Search, Fit, tuple[Contact, ...]]:
    """The search through what no hand touched, the fit that it began at, and what was touched."""
    contacts: tuple[Contact, ...] = ()
    for restarts_left in reversed(range(MOST_RESTARTS + 1)):
        search = search_in(records)
        base, end = search.run(model, names)
        perhaps = restarts_left and not end.undisturbed
        found = find_contacts(end, missing_torque(end, needed_disturbances(base))) if perhaps else ()
        rest = _without(found, records)
        if rest is None:
            break
        contacts, records = (*contacts, *found), rest
    return search, base, contacts


def _untouched(
    search: Search, base: Fit, held_out: tuple[Record, ...]
) -> tuple[tuple[Record, ...], tuple[Contact, ...]]:
    """The held-out records without what a hand touched, which no model predicts, and what that was."""
    end = search.stages[-1][1] if search.stages else base
    if not held_out_error(end.model, held_out, search.sensor, search.settings.window).beyond_noise:
        return held_out, ()
    try:
        torque = residual_torque(end.model, (*search.records, *held_out), search.sensor)
    except InvalidInput:  # the model runs away from what it has not seen
        return held_out, ()
    names = {r.name for r in held_out}
    found = tuple(contact for contact in torque.contacts if contact.name in names)
    rest = _without(found, held_out)
    return (held_out, ()) if rest is None else (rest, found)


def _without(contacts: Sequence[Contact], records: Sequence[Record]) -> tuple[Record, ...] | None:
    """The records without what was touched; None where nothing was, or too little would be left."""
    from sysid.data.splitting import leave_out

    rest = leave_out(records, [(t.name, t.t_begin, t.t_end) for t in contacts])
    return rest if contacts and sum(map(len, rest)) >= LEAST_LEFT * sum(map(len, records)) else None


def _known(effects: Iterable[str]) -> tuple[str, ...]:
    names = (effects,) if isinstance(effects, str) else tuple(effects)
    for name in names:
        if name not in CATALOGUE:
            effect(name)  # raises, and says which names are near
    if not names:
        raise InvalidInput("no effects were named: leave them out to try the whole catalogue")
    return names


def is_lowered(error: float, without: float, tolerance: float) -> bool:
    """Whether something lowers an error, in units of the noise, by that share of its excess over the noise.

    error^2 - 1 <= (1 - tolerance)^2 (without^2 - 1),   or where that was noise: error <= without, but for rounding
    """
    if not math.isfinite(error):
        return False
    excess = (1.0 - tolerance) ** 2 * max(without**2 - 1.0, 0.0)
    return error**2 <= (excess + min(without**2, 1.0)) * (1.0 + NEGLIGIBLE_RISE) ** 2


class _Report:
    """Puts the way of a search into numbers; errors are held-out."""

    def __init__(
        self,
        search: Search,
        base: Fit,
        records: tuple[Record, ...],
        held_out: Sequence[Record],
        sensor: Sensor,
        contacts: tuple[Contact, ...],
        notes: tuple[str, ...],
    ) -> None:
        self.records, self.notes = records, notes
        self.search, self.base, self.held_out, self.sensor, self.contacts = search, base, held_out, sensor, contacts
        self.errors: dict[tuple[str, ...], tuple[Fit, HeldOutError]] = {(): (base, self._error(base))}
        self.fitted, self.torques, self.needed = dict[Fit, float](), dict[Fit, Array](), needed_disturbances(base)
        self.additions, self.unconfirmed = list[Addition](), list[str]()
        self._confirm()
        self._unmask()
        self._reconsider()

    def _error(self, fit: Fit) -> HeldOutError:
        return held_out_error(fit.model, self.held_out, self.sensor, self.search.settings.window)

    @staticmethod
    def _names(additions: Sequence[Addition]) -> tuple[str, ...]:
        return tuple(sorted(a.name for a in additions))

    def _with(self, additions: Sequence[Addition]) -> tuple[Fit, HeldOutError]:
        """The fit with these additions alone, and its error."""
        names = self._names(additions)
        if names not in self.errors:
            fit, _ = self.errors[self._names(self.additions)]
            for addition in self.additions:
                if addition.name not in names:
                    fit = reduced(fit, addition.name)
            self.errors[names] = (fit, self._error(fit))
        return self.errors[names]

    def _confirm(self) -> None:
        """The last stage of the search that does not raise the error on the held-out data, less each addition that
        raises it, that beside others does not lower it by what matters, or that is nothing any more."""
        best = self.errors[()][1].ratio
        for additions, fit in self.search.stages:
            error = self._error(fit)
            self.errors[self._names(additions)] = fit, error
            if error.ratio <= best * (1.0 + NEGLIGIBLE_RISE) or not math.isfinite(best):
                best, self.additions = min(best, error.ratio), list(additions)
        while self.additions:
            end, error = self._with(self.additions)
            fewer = [[a for a in self.additions if a is not left] for left in self.additions]
            own = min(fewer, key=lambda own: self._with(own)[1].ratio)
            tolerance = self.search.settings.tolerance if own else 0.0
            if is_lowered(error.ratio, self._with(own)[1].ratio, tolerance):
                nothing = [a for a in self.additions if is_nothing(end, a.name, self.search.settings.sure)]
                if not nothing:
                    break
                own = [a for a in self.additions if a is not nothing[0]]
            self.additions = own
        kept = self._names(self.additions)
        tried = dict.fromkeys(a.name for additions, _ in self.search.stages for a in additions)
        self.unconfirmed = [name for name in tried if name not in kept]

    def _unmask(self) -> None:
        """Take back what leaves more torque missing than was missing without it, and what is a part of something
        unknown: what remains depends on the quantity that it is a function of, and it explains less than most of that,
        or only with a number driven to its bound."""
        for addition in list(self.additions):
            end, error = self._with(self.additions)
            if not math.isfinite(error.ratio):
                continue
            torque = self._torque(end)
            fewer = [a for a in self.additions if a is not addition]
            without = self._torque(self._with(fewer)[0]).after
            if torque.after > without or self._hides(addition, end, error, torque, without):
                self.unconfirmed.append(addition.name)
                self.additions = fewer

    def _hides(self, addition: Addition, end: Fit, error: HeldOutError, torque: MissingTorque, without: float) -> bool:
        """Whether an addition is a part of something unknown, `without` it is the torque [N m] that is missing then."""
        imitates = CATALOGUE[addition.name].imitates
        if not imitates:
            return False
        remaining = self._remaining(end, error, torque)
        if remaining is None or imitates not in remaining.depends_on:
            return False
        bent = end.at_bounds - self.base.at_bounds
        return bool(bent) or torque.after**2 > (1.0 - self.search.settings.most) * without**2

    def _reconsider(self) -> None:
        """Add what is sure and too small to matter in the motion that was searched, where the held-out motion goes
        further and shows that it matters there."""
        for name in self.search.negligible:
            end, error = self._with(self.additions)
            if name in self._names(self.additions) or not self._fails_elsewhere(end, error) or self._remains(end):
                continue
            found = scores(end, (name,)).get(name)
            if found is None or not found.visible:
                continue
            fit = settled(extended(end, [found.best.at(found.sizes)], QUICK))
            after = self._error(fit)
            if after.ratio < error.ratio * (1.0 - self.search.settings.tolerance):
                p = float(chdtrc(found.numbers, max(end.deviance - fit.deviance, 0.0)))
                self.additions = [*self.additions, Addition(name, self._same(name), (), p, fit)]
                self.errors[self._names(self.additions)] = (fit, after)

    def diagnosis(self, began: float) -> Diagnosis:
        """The answer; `began` is when the question was asked."""
        end, error = self._with(self.additions)
        steps = self._steps(end)
        machine = tuple(s for s in steps if not CATALOGUE[s.effect].of_log)
        torque = self._torque(end)
        remaining = self._remaining(end, error, torque)
        verdict = "adequate" if not machine else "missing"
        if sum(s.decrease for s in machine if s.rivals) > 0.5 * sum(s.decrease for s in machine):
            verdict = "cannot tell"
        elif remaining is not None:
            verdict = "partly" if machine else "unknown"
        return Diagnosis(
            verdict=verdict,
            base=self.base.estimate(),
            base_error=self.errors[()][1],
            error=error,
            steps=machine,
            conventions=tuple(s for s in steps if CATALOGUE[s.effect].of_log),
            ranking=self._ranking(torque.before),
            remaining=remaining,
            not_identifiable=self._not_identifiable(end),
            ruled_out=self._ruled_out(),
            sensor=self.sensor,
            records=self.records,
            unseen=tuple(self.held_out),
            notes=self.notes,
            estimate=end.estimate(),
            contacts=self.contacts,
            next_experiment=self._experiment(machine, end),
            seconds=time.perf_counter() - began,
            torque=torque,
            negligible=tuple(
                n for n in self.search.negligible if n not in (*self._names(self.additions), *self.unconfirmed)
            ),
            unconfirmed=tuple(self.unconfirmed),
            tolerance=self.search.settings.tolerance,
        )

    def _torque(self, end: Fit) -> MissingTorque:
        """How large the missing torque is, before and after."""
        drive = float(np.sqrt(np.mean(end.linearised.drives[end.samples.follows] ** 2)))
        return MissingTorque(drive, *(float(np.sqrt(np.nanmean(self._missing(f) ** 2))) for f in (self.base, end)))

    def _missing(self, fit: Fit) -> Array:
        """The missing torque (M,) [N m] over time, smoothed under what the model as it came needed."""
        if fit not in self.torques:
            self.torques[fit] = missing_torque(fit, self.needed)
        return self.torques[fit]

    def _experiment(self, machine: tuple[Step, ...], end: Fit) -> Experiment | None:
        """What to play next where a class does not separate."""
        alike = next((s.alike for s in machine if s.rivals), None)
        if alike is None:
            return None
        from sysid.planning.next_experiment import next_experiment

        try:
            return next_experiment(end.estimate(), alike, sensor=self.sensor, records=self.search.records)
        except InvalidInput:  # no torque in the log, or rivals that exclude each other
            return None

    def _steps(self, end: Fit) -> tuple[Step, ...]:
        """In the order of the search; a step of the error is that of all effects that pay together."""
        estimate, additions = end.estimate(), self.additions
        errors = [self._with(additions[:k])[1].ratio for k in range(len(additions) + 1)]
        steps, first = list[Step](), 0
        for k, addition in enumerate(additions):
            falls = (j for j in range(k + 1, len(errors)) if errors[j] < errors[first] * (1.0 - FELL))
            last = next(falls, len(errors) - 1)
            steps.append(
                Step(
                    effect=addition.name,
                    alike=(addition.name, *addition.same, *addition.close),
                    rivals=addition.close,
                    parameters=fitted_numbers(estimate, addition.name),
                    error_before=errors[first],
                    error_after=errors[last],
                    p_value=addition.p_value,
                    estimate=self._with(additions[: k + 1])[0].estimate(),
                )
            )
            first = last if last == k + 1 else first
        return tuple(steps)

    def _ranking(self, missing: float) -> tuple[Ranked, ...]:
        """The first round: those that were fitted by what came out, then the others by what they promise."""
        first, each = self.search.first, self.search.settings.price
        fitted = {t.effects[0]: t for t in self.search.trials if len(t.effects) == 1}
        order = sorted(fitted, key=lambda n: fitted[n].merit, reverse=True)
        chosen = [a.name for a in self.search.additions if a.name in first]
        order = [*chosen, *(n for n in order if n not in chosen)]
        merit = {n: s.lm - price(n, each, s.shapes) for n, s in first.items()}
        order += sorted(
            (n for n, s in first.items() if s.visible and n not in order), key=merit.__getitem__, reverse=True
        )
        return tuple(
            Ranked(
                name,
                (name, *self._same(name)),
                fitted[name].merit if name in fitted else merit[name],
                self._p_value(name),
                self._error(fitted[name].fit).ratio if name in fitted else None,
                fitted[name].fit if name in fitted else None,
                self.base,
                missing,
            )
            for name in order
        )

    def _p_value(self, name: str) -> float:
        score = self.search.first[name]
        return min(1.0, float(chdtrc(max(len(score.sizes), 1), score.lm)) * len(self.search.first))

    def _same(self, name: str) -> tuple[str, ...]:
        first, own = self.search.first, self.search.first[name]
        return tuple(
            n
            for n, s in first.items()
            if n != name
            and s.visible
            and len(s.sizes) == len(own.sizes)
            and alikeness(s, own) > self.search.settings.same
        )

    def _remaining(self, end: Fit, error: HeldOutError, torque: MissingTorque) -> Remaining | None:
        """What matters and is not explained: predictions err beyond the noise, on what was fitted to or beyond."""
        share = max(0.0, 1.0 - 1.0 / max(error.ratio, 1e-9) ** 2)
        if not self.contacts and not self._remains(end):
            elsewhere = self._fails_elsewhere(end, error)
            return Remaining(share, (), "", torque.after, unseen=True) if elsewhere else None
        found = dependence(end, self._missing(end))
        depends_on = (*(q for q in found.depends_on if q != "time"), "time") if self.contacts else found.depends_on
        return Remaining(share, depends_on, found.where, torque.after)

    def _remains(self, end: Fit) -> bool:
        """Whether what was fitted to is predicted with errors beyond the noise, and a random torque is needed."""
        return not end.undisturbed and not self._fitted(end) ** 2 < 1.0 + self.search.settings.enough**2

    def _fails_elsewhere(self, end: Fit, error: HeldOutError) -> bool:
        """Whether held-out data are predicted much worse than the noise, and than what was fitted to."""
        return error.beyond_noise and not error.ratio < self.search.settings.worse * max(self._fitted(end), 1.0)

    def _fitted(self, end: Fit) -> float:
        """The error of predictions of what was fitted to, which several ask for."""
        if end not in self.fitted:
            self.fitted[end] = fitted_error(end, self.search.settings.window)
        return self.fitted[end]

    def _not_identifiable(self, end: Fit) -> tuple[tuple[str, ...], ...]:
        """Parameters that no log of this kind separates, and effects that the free parameters absorb."""
        groups = []
        own = end.model.plant.parameters
        absorbed = tuple(n for n, s in self.search.first.items() if s.absorbed)
        if absorbed:
            groups.append((*(n for n in end.names if n in own), *absorbed))
        groups.extend((a.name, *a.same) for a in self.additions if a.same)
        F = end.Z.T @ end.Z
        size = np.sqrt(np.maximum(np.diag(F), 1e-300))
        values, vectors = np.linalg.eigh(F / np.outer(size, size)) if len(size) else (np.zeros(0), np.zeros((0, 0)))
        for value, v in zip(values, vectors.T, strict=True):
            if value < 1e-9:
                groups.append(tuple(n for n, c in zip(end.names, v, strict=True) if abs(c) > 0.2))
        return tuple(groups)

    def _ruled_out(self) -> dict[str, dict[str, Any]]:
        """Sizes above which effects that were not found would have been found."""
        found = {}
        for name, s in self.search.last.items():
            if not s.visible or len(s.sizes) != 1 or not math.isfinite(s.sd[0]):
                continue
            p = s.best.neutral.parameters[s.best.magnitudes[0]]
            if not p.never:
                found[name] = {"parameter": p.name, "size": DETECTABLE * s.sd[0], "unit": p.unit}
        return found
