"""diagnose: from a model and a log to the effect that is missing, its size and the evidence for it."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid.data.checks import check_excitation
from sysid.data.logs import notes_of
from sysid.data.noise import sensor_noise
from sysid.data.record import Record, amount_of, check_records, unique_names
from sysid.data.sensor import Sensor
from sysid.data.splitting import sample_of, split
from sysid.diagnosis.answer import Diagnosis
from sysid.diagnosis.conclusion import conclusion
from sysid.diagnosis.confirmation import Confirmation
from sysid.diagnosis.contacts import Contact, find_contacts, without_contacts
from sysid.diagnosis.criteria import is_lowered
from sysid.diagnosis.explanation import Evidence, friction_shown
from sysid.diagnosis.residual_torque import missing_torque, needed_disturbances, residual_torque
from sysid.diagnosis.search import Search
from sysid.diagnosis.search_settings import DEFAULT, SHORTEST_HORIZON, SearchSettings
from sysid.errors import InvalidInput, check_kind, items_of
from sysid.estimation.channels import relied_on
from sysid.estimation.disturbances import NO_DISTURBANCE
from sysid.estimation.estimate import Estimate
from sysid.estimation.first_fit import first_fits
from sysid.estimation.fit import free
from sysid.estimation.held_out import held_out_error, lead_of
from sysid.estimation.initial_guess import initial_guess, shown_ratios
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import foreseeable, telling_horizon, widened_sensor
from sysid.estimation.prediction_error import Fit
from sysid.estimation.torque_regression import frees_gravity, telling_motion
from sysid.physics.effects import CATALOGUE, effect
from sysid.physics.model import Model

logger = logging.getLogger(__name__)

MOST_RESTARTS = 3
"""Most times that the search begins anew after contacts were left out of the log."""
LEAST_LEFT = 0.6
"""Least share of a log that has to remain; contacts are left out only if it does."""


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

    The model is fitted beside a random torque, whose size and correlation time are found from the log. An effect is
    added if it explains what the random torque had to: the likelihood gains more than the effect's numbers and its
    rarity cost, predictions on left-out stretches are no worse, and what it changes matters. This is repeated until no
    effect pays. In the end effects that raise the error on the held-out data are taken back.

    Parameters
    ----------
    model : Model or Estimate
        The model as it came. If it is an estimate, its free parameters are refitted and the others keep their numbers.
    records : sequence of Record
        At least one rollout. A long log is searched by a sample that is spread over it (`SearchSettings.samples`).
        Contacts, such as a hand's push, are left out of the search and named in the answer.
    sensor : Sensor, optional
        Noise of the readings; by default the estimate's, else found from the records without any model.
    hold_out : float, optional
        A share or a count of the records, which no fit sees.
    effects : iterable of str, optional
        Names of the effects that may be missing; by default the whole catalogue.
    parameters : sequence of str, optional
        The names of the free parameters; the others keep their numbers. By default the estimate's, or all but what is
        known, such as g; and of these not what sets the scale of all torques in free swings, such as m or J.
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
    began = time.perf_counter()
    notes = notes_of(records)
    records = unique_names(check_records(model.model if isinstance(model, Estimate) else model, records))
    parameters = free(model, records) if parameters is None else parameters
    if isinstance(model, Estimate):
        sensor, model = sensor or model.sensor, model.model
    model.check_names(parameters)
    names = tuple(parameters)
    check_kind("settings", settings, SearchSettings, "SearchSettings, such as SearchSettings(tolerance=0.05)")
    chosen = None if effects is None else _known(effects)
    sensor = sensor or sensor_noise(records).sensor
    check_excitation(records, sensor)
    fitted, held_out = split(records, hold_out)
    training = sample_of(fitted, settings.samples)
    if training != fitted:
        notes = (*notes, f"of {amount_of(fitted)} to fit, {amount_of(training)} are searched, spread over the log")
        logger.info(notes[-1])
    sensor = relied_on(model, training, sensor)
    asked = telling_horizon(records) if settings.horizon is None else settings.horizon
    longest = float(f"{max(len(r) * r.dt for r in held_out):.2g}")
    ahead = min(asked, longest, _foreseeable(model, names, training, sensor))
    settings = replace(settings, horizon=max(ahead, SHORTEST_HORIZON))
    search, base, contacts, mistakes = _searched(
        lambda left: Search(left, sensor, chosen, settings), training, held_out, model, names
    )
    end = search.end(base)
    widened = widened_sensor(end, settings.ahead)
    held_out, more = (held_out, ()) if mistakes else _untouched(end, held_out, widened, settings.ahead)
    confirmed = Confirmation(Evidence(search, base, held_out, (*contacts, *more), widened))
    return conclusion(confirmed, records, notes, began)


def _foreseeable(model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor) -> float:
    """How far ahead [s] the motion is `foreseeable`. It is inf if gravity is free and the log does not show it, since
    then nothing is known to fall."""
    if not set(names).isdisjoint(model.plant.parameters):
        if frees_gravity(model, names):
            terms = telling_motion(model, names, records, sensor)
            if "G/J" not in shown_ratios(model, terms):
                return math.inf
        model = initial_guess(model, names, records, sensor)
    return foreseeable(model, records)


class _Searched(NamedTuple):
    """A search through records, the fit that it began at, the contacts that were left out of it, and whether its model
    takes for contacts what it lacks."""

    search: Search
    base: Fit
    contacts: tuple[Contact, ...]
    mistakes: bool


def _searched(
    search_in: Callable[[Sequence[Record]], Search],
    records: Sequence[Record],
    held_out: Sequence[Record],
    model: Model,
    names: tuple[str, ...],
) -> _Searched:
    """The search through the records without contacts.

    What looks like a contact may be what the model lacks. It is left out only if that pays (`_pays_to_leave_out`).
    """
    search, base, end = _best_search(search_in, records, model, names)
    contacts: tuple[Contact, ...] = ()
    for _ in range(MOST_RESTARTS):
        touched = _contacts(search, base, end, again=bool(contacts))
        rest = _without(touched, records)
        if rest is None:
            break
        other = _best_search(search_in, rest, model, names)
        if not _pays_to_leave_out(end, other[-1], held_out, search):
            return _Searched(search, base, contacts, mistakes=not contacts)
        (search, base, end), records, contacts = other, rest, (*contacts, *touched)
    return _Searched(search, base, contacts, mistakes=False)


def _contacts(search: Search, base: Fit, end: Fit, again: bool) -> tuple[Contact, ...]:
    """The contacts in the torque that the final fit `end` of a search leaves missing; `base` is the fit of the model as
    it came."""
    if end.undisturbed or _is_astray(end, base, search):
        return ()
    beside = NO_DISTURBANCE if end.samples.driven else end.disturbances
    return find_contacts(end, missing_torque(end, needed_disturbances(base, beside)), again=again)


def _pays_to_leave_out(before: Fit, after: Fit, held_out: Sequence[Record], search: Search) -> bool:
    """Whether the fit `after` contacts were left out predicts held-out records no worse than the fit `before` as a
    whole; and needs no random torque, or predicts them better by what matters in the geometric mean over windows: where
    something touched the held-out records, both err alike. If what is left shows another inertia, what was left out is
    where the drive acted."""
    if abs(math.log(after.inertia / before.inertia)) > math.log(search.settings.inertia_factor):
        return False
    was, now = (held_out_error(fit.model, held_out, search.sensor, search.settings.ahead) for fit in (before, after))
    old, new = (np.array([max(window.ratio, 1.0) for window in error.windows]) for error in (was, now))
    better = float(np.mean(np.log(new / old))) < math.log1p(-search.settings.tolerance)
    return (better or after.undisturbed) and is_lowered(now.ratio, was.ratio, 0.0)


def _is_astray(end: Fit, base: Fit, search: Search) -> bool:
    """Whether the friction along the motion contradicts the inertia of a final fit, which then tells of no contacts;
    `base` is the fit of the model as it came."""
    along = friction_shown(search, base, end, search.records)
    return along is not None and along.tells_inertia and along.contradicts(end.inertia, search.settings.inertia_factor)


def _best_search(
    search_in: Callable[[Sequence[Record]], Search], records: Sequence[Record], model: Model, names: tuple[str, ...]
) -> tuple[Search, Fit, Fit]:
    """Search from each first fit, and keep the search whose final fit predicts left-out stretches best. Returned are
    this search, its base fit and its final fit. If speeds alone were read and something remains, one search more runs
    with readings that share an error. It begins at the first fit whose inertia is nearest to that of the best end."""

    def from_first(helped: Fit) -> tuple[Search, Fit, Fit]:
        search = search_in(records)
        return (search, *search.run(model, names, helped))

    sensor = search_in(records).sensor
    searches = [from_first(helped) for helped in first_fits(Samples(model, records, sensor), model, names)]
    best = _best_predicting(searches)
    sharing = Samples(model, records, sensor, speeds_share=True)
    if not sharing.error_channel or any(end.undisturbed for *_, end in searches):
        return best
    inertia = best[-1].inertia
    nearest = min(first_fits(sharing, model, names), key=lambda fit: abs(math.log(fit.inertia / inertia)))
    return _best_predicting([best, from_first(nearest)])


def _best_predicting(searches: Sequence[tuple[Search, Fit, Fit]]) -> tuple[Search, Fit, Fit]:
    """That of several searches whose final fit predicts left-out stretches best."""
    if len(searches) == 1:
        return searches[0]
    lead = max(lead_of(end.model) for _, _, end in searches)
    return min(searches, key=lambda item: item[0].left_out(item[2], lead).ratio)


def _untouched(
    end: Fit, held_out: tuple[Record, ...], sensor: Sensor, ahead: float
) -> tuple[tuple[Record, ...], tuple[Contact, ...]]:
    """The held-out records without contacts, which no model can predict, and these contacts."""
    if not held_out_error(end.model, held_out, sensor, ahead).beyond_noise:
        return held_out, ()
    try:
        torque = residual_torque(end.model, (*end.samples.records, *held_out), sensor)
    except InvalidInput:  # the model runs away from what it has not seen
        return held_out, ()
    names = {r.name for r in held_out}
    touched = tuple(contact for contact in torque.contacts if contact.name in names)
    rest = _without(touched, held_out)
    return (held_out, ()) if rest is None else (rest, touched)


def _without(contacts: Sequence[Contact], records: Sequence[Record]) -> tuple[Record, ...] | None:
    """The records without the contacts; None if there are no contacts, or too little would be left."""
    rest = without_contacts(records, contacts)
    return rest if contacts and sum(map(len, rest)) >= LEAST_LEFT * sum(map(len, records)) else None


def _known(effects: Iterable[str]) -> tuple[str, ...]:
    names = items_of(effects)
    for name in names:
        if not isinstance(name, str) or name not in CATALOGUE:
            effect(name)  # raises, and says which names are near
    if not names:
        raise InvalidInput("no effects were named: leave them out to try the whole catalogue")
    return names
