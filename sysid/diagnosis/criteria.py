"""Criteria: tests that the effects in a fit have to pass, compared to a fit without them."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np

from sysid.diagnosis.search_settings import DEFAULT, SearchSettings
from sysid.estimation.energy_balance import FRICTIONS
from sysid.estimation.prediction import moved
from sysid.estimation.prediction_error import Fit, inverse
from sysid.physics.model import Model
from sysid.physics.ops import Array

NEGLIGIBLE_RISE = 1e-3
"""A rise of the held-out error by less than this share is not printed, and counts as none."""


def is_plausible(fit: Fit, effects: Sequence[str]) -> bool:
    """Whether a machine can have these effects with their fitted numbers, and the readings can show them."""
    sd, reach = fit.samples.sensor.theta or 0.0, 0.5 * float(np.ptp(fit.samples.smoothed[:, 0]))
    joint = fit.linearised.moving_joint(fit.model)
    return all(e.plausible and e.resolved(sd, reach, joint) for e in fit.model.effects if e.name in effects)


def is_determined(fit: Fit, before: Fit, others: Collection[str]) -> bool:
    """Whether the log determines all numbers of a fit; also True if it did not determine those of the fit `before`.
    Numbers of the effects `others` do not count, since these may be pruned later."""
    Z = fit.Z[:, [i for i, name in enumerate(fit.names) if fit.model.parameters[name].owner not in others]]
    return bool(np.all(np.isfinite(inverse(Z.T @ Z))) or not np.all(np.isfinite(before.covariance)))


def recurs(fit: Fit, effects: Sequence[str], settings: SearchSettings) -> bool:
    """Whether a periodic pattern comes back often enough to be believed, in at least one record, and the log tells how
    often; True for effects without a pattern."""
    samples = fit.samples
    rows = [slice(a, b) for a, b in pairwise(samples.first.tolist())]
    motions = [(samples.smoothed[i, 0], samples.time_since_start[i], samples.commands[i]) for i in rows]
    for effect in (e for e in fit.model.effects if e.name in effects):
        counts = [effect.recurrences(*motion) for motion in motions]
        most = max(counts)
        if most < settings.recurrences or min(counts) == -math.inf:
            return False
        if math.isfinite(most) and not most * _shape_sd(fit, effect.name) < settings.count_sd:
            return False
    return True


def _shape_sd(fit: Fit, name: str) -> float:
    """The largest relative sd of an effect's shapes, such as the order of a ripple; 0 if none is free."""
    numbers = [(p, i) for i, n in enumerate(fit.names) if (p := fit.model.parameters[n]).owner == name]
    sds = [math.sqrt(fit.covariance[i, i]) / abs(float(p.value)) for p, i in numbers if p.neutral is None]
    return max(sds, default=0.0)


def is_nothing(fit: Fit, name: str, sure: float = DEFAULT.sure_size) -> bool:
    """Whether the sizes of an effect are compatible with 0 (`squared_size`); False if the readings leave them open."""
    return squared_size(fit, name) < sure


def is_undetermined(fit: Fit, name: str) -> bool:
    """Whether the readings do not determine an effect's sizes, because other numbers make up for any of them."""
    at = _sizes(fit, name)
    return bool(at) and not np.all(np.isfinite(fit.covariance[np.ix_(at, at)]))


def squared_size(fit: Fit, name: str, beyond: Collection[str] = ()) -> float:
    """The squared size x' C^-1 x / q of an effect, with its q sizes x counted from neutral and their covariance C.

    It is 0 for an effect that changes nothing, and nan if the readings do not determine x. The size of a limit is the
    limit itself (an infinite one is none), conditional on its slope: with a steeper slope any limit ends at the same
    speed. Fields in `beyond`, shared with a simpler effect, do not count. If a number of the plant ended at its bound,
    C is conditional on it, too: beyond the bound it cannot take the effect's place.
    """
    if any(e.idle for e in fit.model.effects if e.name == name):
        return 0.0
    parameters = fit.model.parameters
    at = [i for i in _sizes(fit, name) if parameters[fit.names[i]].field not in beyond]
    if not at or is_undetermined(fit, name):
        return math.nan
    sizes = [parameters[fit.names[i]] for i in at]
    x = np.array([float(p.value) - (0.0 if p.never else float(p.neutral or 0.0)) for p in sizes])
    numbers = [fit.names.index(n) for n in fit.model.names_of(name) if n in fit.names and sizes[0].never]
    shapes = [i for i in numbers if i not in at and math.isfinite(fit.covariance[i, i])]
    precision = np.linalg.pinv(_beside_bounds(fit, [*at, *shapes]), hermitian=True)[: len(at), : len(at)]
    return float(x @ precision @ x) / len(x)


def _beside_bounds(fit: Fit, at: list[int]) -> Array:
    """The covariance of the numbers `at`, conditional on those of the plant that ended at their bounds."""
    C, ended = fit.covariance, fit.at_bounds.intersection(fit.model.plant.parameters)
    held = [i for i, name in enumerate(fit.names) if name in ended and 0.0 < C[i, i] < math.inf]
    across = C[np.ix_(at, held)]
    return C[np.ix_(at, at)] - across @ np.linalg.pinv(C[np.ix_(held, held)], hermitian=True) @ across.T


def _sizes(fit: Fit, name: str) -> list[int]:
    """The indices of an effect's sizes among a fit's numbers: those that have a value at which it changes nothing."""
    parameters = fit.model.parameters
    names = [n for n in fit.model.names_of(name) if n in fit.names and parameters[n].neutral is not None]
    return [fit.names.index(n) for n in names]


def gain(fit: Fit, other: Fit, effects: Sequence[str]) -> float:
    """The decrease of the deviance by these effects, divided by the excess variance of their numbers.

    What a model lacks is no Gaussian process, so that even an idle effect gains more than likelihood theory says: by
    `Fit.excess`, averaged over its numbers.
    """
    return (other.deviance - fit.deviance) / excess_of(fit, effects)


def excess_of(fit: Fit, effects: Sequence[str]) -> float:
    """The excess variance of the numbers of these effects, on average (`Fit.excess`); 1 if none of them is free."""
    parameters = fit.model.parameters
    numbers = [i for i, name in enumerate(fit.names) if parameters[name].owner in effects]
    return float(np.mean(fit.excess[numbers])) if numbers else 1.0


def at_bound(fit: Fit, name: str) -> bool:
    """Whether one of the effect's numbers ended at a bound other than its neutral value."""
    return not set(fit.model.names_of(name)).isdisjoint(fit.at_bounds)


def shows_in_balance(before: Model, after: Fit, settings: SearchSettings) -> bool:
    """Whether frictions that a fit has beside those of the model `before` explain the losses of a free swing better, by
    enough to matter."""
    balance = after.balance
    new = set(after.model.effect_names) - set(before.effect_names)
    if balance is None or not new <= set(FRICTIONS):
        return False
    return balance.deviance(before) - balance.deviance(after.model) > settings.balance_deviance


def matters(before: Model, after: Fit, settings: SearchSettings) -> bool:
    """Whether predictions of the two models differ by so much that it matters, or the energy balance shows it.

    The RMS difference has to exceed `noise_share` of the sensor noise, and sqrt(1 - (1 - tolerance)^2) of the error
    beyond the noise: the difference that lowers the error by the share `tolerance`.
    """
    if shows_in_balance(before, after, settings):
        return True
    size, error = moved(before, after.model, after, settings.ahead)
    excess = math.sqrt(max(error**2 - 1.0, 0.0))
    share = math.sqrt(1.0 - (1.0 - settings.tolerance) ** 2)
    return math.isfinite(size) and size > max(settings.noise_share, share * excess)


def is_lowered(error: float, without: float, tolerance: float) -> bool:
    """Whether an `error`, in units of the noise, is lower than the error `without` something by a share `tolerance`.

    error^2 - 1 <= (1 - tolerance)^2 (without^2 - 1);  where `without` is within the noise, error <= without. A
    negligible rise is allowed in both cases.
    """
    if not math.isfinite(error):
        return False
    excess = (1.0 - tolerance) ** 2 * max(without**2 - 1.0, 0.0)
    return error**2 <= (excess + min(without**2, 1.0)) * (1.0 + NEGLIGIBLE_RISE) ** 2
