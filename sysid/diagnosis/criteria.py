"""Criteria: what a fit has to show for the effects in it, beside a fit without them."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from sysid.diagnosis.search_settings import DEFAULT, SearchSettings
from sysid.estimation.prediction import moved
from sysid.estimation.prediction_error import Fit, inverse
from sysid.physics.model import Model
from sysid.physics.ops import Array


def is_plausible(found: Fit, effects: Sequence[str]) -> bool:
    """Whether a machine may have these effects' numbers, and the readings can show them."""
    sd, reach = found.samples.sensor.theta or 0.0, 0.5 * float(np.ptp(found.samples.smoothed[:, 0]))
    told = found.linearised.told(found.model)
    return all(e.plausible and e.resolved(sd, reach, told) for e in found.model.effects if e.name in effects)


def is_determined(found: Fit, before: Fit, others: Collection[str]) -> bool:
    """Whether the log determines the numbers of a fit beside those of `others`, effects that may be pruned in its
    favour, if it determined those of the fit before."""
    own = [i for i, name in enumerate(found.names) if found.model.parameters[name].owner not in others]
    Z = found.Z[:, own]
    return bool(np.all(np.isfinite(inverse(Z.T @ Z))) or not np.all(np.isfinite(before.covariance)))


def is_nothing(found: Fit, name: str, sure: float = DEFAULT.sure) -> bool:
    """Whether the sizes of an effect may as well be none, by `squared_size`.

    What the readings do not determine is not said to be nothing.
    """
    return squared_size(found, name) < sure


def is_undetermined(found: Fit, name: str) -> bool:
    """Whether the readings say nothing of an effect's sizes, since other numbers may make up for any of them."""
    at = _sizes(found, name)
    return bool(at) and not np.all(np.isfinite(found.covariance[np.ix_(at, at)]))


def squared_size(found: Fit, name: str, beyond: Collection[str] = ()) -> float:
    """The sizes x (q,) of an effect in units of their covariance C (q, q):  x' C^-1 x / q;  0 of one that changes
    nothing, nan where the readings do not determine them. Of a limit it is the limit: one that may as well be infinite
    is none, at the slope that it has, since with a steeper one any limit ends at the same speed. The numbers that it
    shares with a simpler one, which are `beyond` question, are left aside. Where a number of the plant ended at its
    bound, C is that of the others beside it: beyond it nothing can take an effect's place."""
    if any(e.idle for e in found.model.effects if e.name == name):
        return 0.0
    parameters = found.model.parameters
    at = [i for i in _sizes(found, name) if parameters[found.names[i]].field not in beyond]
    if not at or is_undetermined(found, name):
        return math.nan
    sizes = [parameters[found.names[i]] for i in at]
    x = np.array([float(p.value) - (0.0 if p.never else float(p.neutral or 0.0)) for p in sizes])
    numbers = [found.names.index(n) for n in found.model.names_of(name) if n in found.names and sizes[0].never]
    shapes = [i for i in numbers if i not in at and math.isfinite(found.covariance[i, i])]
    own = [*at, *shapes]
    precision = np.linalg.pinv(_beside_bounds(found, own), hermitian=True)[: len(at), : len(at)]
    return float(x @ precision @ x) / len(x)


def _beside_bounds(found: Fit, own: list[int]) -> Array:
    """The covariance of some numbers given those of the plant that ended at their bounds."""
    C, ended = found.covariance, found.at_bounds.intersection(found.model.plant.parameters)
    held = [i for i, name in enumerate(found.names) if name in ended and 0.0 < C[i, i] < math.inf]
    across = C[np.ix_(own, held)]
    return C[np.ix_(own, own)] - across @ np.linalg.pinv(C[np.ix_(held, held)], hermitian=True) @ across.T


def _sizes(found: Fit, name: str) -> list[int]:
    """Which of a fit's numbers are sizes of an effect: those that are none where it changes nothing."""
    parameters = found.model.parameters
    own = [n for n in found.model.names_of(name) if n in found.names and parameters[n].neutral is not None]
    return [found.names.index(n) for n in own]


def gain(found: Fit, other: Fit, effects: Sequence[str]) -> float:
    """Decrease of the deviance that these effects bring, over what chance multiplies it with where the random torque is
    no Gaussian process: the excess variance of the effects' numbers (Huber's correction of the likelihood ratio)."""
    parameters = found.model.parameters
    own = [i for i, name in enumerate(found.names) if parameters[name].owner in effects]
    excess = float(np.mean(found.wider[own] ** 2)) if own else 1.0
    return (other.deviance - found.deviance) / excess


def at_bound(found: Fit, name: str) -> bool:
    """Whether one of the effect's numbers ended at a bound that is not its neutral value."""
    return not set(found.model.names_of(name)).isdisjoint(found.at_bounds)


def matters(before: Model, after: Fit, settings: SearchSettings) -> bool:
    """Whether predictions move by more than nothing that anybody would notice.

    The RMS difference of the two models' predictions exceeds `noise_share` of the sensor noise and what would lower the
    error by the share `tolerance`:  sqrt(1 - (1 - tolerance)^2)  of what the prediction is off beyond the noise.
    """
    size, error = moved(before, after.model, after, settings.ahead)
    excess = math.sqrt(max(error**2 - 1.0, 0.0))
    share = math.sqrt(1.0 - (1.0 - settings.tolerance) ** 2)
    return math.isfinite(size) and size > max(settings.noise_share, share * excess)
