"""Ranked: an effect that may be missing, with the evidence for it and the torque that it would add."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sysid.data.json_file import plain_fields
from sysid.diagnosis.dependence import coordinates
from sysid.diagnosis.findings import fitted_numbers
from sysid.diagnosis.predictions import LONGEST_STRETCH
from sysid.diagnosis.residual_torque import missing_torque
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.linearisation import LinearisedModel
from sysid.estimation.prediction_error import Fit
from sysid.physics.ops import Array

_BINS = 48
_RAREST = 0.005
_LEAST_SHARE = 0.3


@dataclass(frozen=True)
class Ranked:
    """A candidate of the first round.

    indistinguishable  effects that the log cannot tell from it, itself first
    score              decrease of the deviance (-2 log likelihood) beyond the price, expected or, if it was fitted,
                       found
    p_value            of the score test, multiplied by the number of effects that were tested (Bonferroni's correction)
    error_after        the held-out error with it, in units of the sensor noise, if it was fitted
    fit                the fit with it, if it was fitted
    needed             the random torque beside which missing torques are found
    missing            RMS of the torque [N m] that is missing without it
    """

    effect: str
    indistinguishable: tuple[str, ...]
    score: float
    p_value: float
    error_after: float | None = None
    fit: Fit | None = None
    needed: Disturbances | None = None
    missing: float = 0.0

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Its fitted numbers {name: {value, sd, unit}}; empty if it was not fitted."""
        return {} if self.fit is None else fitted_numbers(self.fit.estimate(), self.effect)

    @cached_property
    def explained(self) -> float | None:
        """The share of the missing torque that it explains (see `MissingTorque`); None if it was not fitted."""
        if self.fit is None or self.needed is None or not self.missing > 0.0:
            return None
        left = float(np.nanmean(missing_torque(self.fit, self.needed) ** 2))
        return max(0.0, 1.0 - left / self.missing**2)

    @cached_property
    def torque(self) -> EffectTorque | None:
        """Its torque over the quantity that it is a function of; None if it was not fitted or is no torque."""
        return None if self.fit is None else effect_torque(self.fit, self.effect)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return plain_fields(self, "effect", "score", "p_value", "error_after") | {"class": list(self.indistinguishable)}


@dataclass(frozen=True, eq=False)
class EffectTorque:
    """The torque of an effect over the quantity that it is a function of.

    over   "theta" (its place), "theta_dot" or "torque"; "time" if none of these explains much of the torque
    x      (B,) values of that quantity; of time the instants [s] of a stretch of `record`, where the torque is large
    mean   (B,) mean torque [N m] at x; over time the torque itself
    share  of its mean square that the quantity explains
    """

    over: str
    x: Array
    mean: Array
    share: float
    record: str = ""


def effect_torque(fit: Fit, name: str) -> EffectTorque | None:
    """The torque by which an effect of a fitted model changes the speed along the motion, over the quantity that
    explains most of it; None for an effect that changes readings alone."""
    without = LinearisedModel(fit.samples, fit.model.without_effect(name), fit.motion)
    inside = fit.samples.follows
    gained = (fit.linearised.ends[:, 1] - without.ends[:, 1])[inside] / fit.samples.dt
    torque = fit.inertia * gained
    if not float(np.std(torque)) > 0.0 or not np.all(np.isfinite(torque)):
        return None
    at = {name: x[inside] for name, x in coordinates(fit).items()}
    best = max((_over(name, x, torque) for name, x in at.items() if name != "time"), key=lambda over: over.share)
    return best if best.share > _LEAST_SHARE else _over_time(fit, at["time"], torque)


def _over_time(fit: Fit, t: Array, torque: Array) -> EffectTorque:
    """The torque over time, in the first LONGEST_STRETCH of the record in which it is largest."""
    number = fit.samples.number[fit.samples.follows]
    size = np.bincount(number, torque**2) / np.maximum(np.bincount(number), 1)
    rows = np.flatnonzero(number == int(np.argmax(size)))
    rows = rows[t[rows] <= t[rows[0]] + LONGEST_STRETCH]
    return EffectTorque("time", t[rows], torque[rows], 1.0, fit.samples.records[int(number[rows[0]])].name)


def _over(name: str, x: Array, torque: Array) -> EffectTorque:
    low, high = np.quantile(x, [_RAREST, 1.0 - _RAREST])
    edges = np.linspace(low, max(high, low + 1e-9), _BINS + 1)
    place = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    mean = np.bincount(place, torque, minlength=_BINS) / np.maximum(count, 1)
    share = 1.0 - float(np.mean((torque - mean[place]) ** 2)) / float(np.mean(torque**2))
    middle, met = 0.5 * (edges[1:] + edges[:-1]), count > 0
    return EffectTorque(name, middle[met], mean[met], share if math.isfinite(share) else 0.0)
