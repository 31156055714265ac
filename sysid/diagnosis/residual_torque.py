"""Residual torque: the torque that must act on the joint beyond a model to produce a log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.json_file import plain, plain_fields
from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.diagnosis.contacts import Contact, contacts_sentence, find_contacts, slow
from sysid.diagnosis.dependence import Dependence, coordinates, dependence
from sysid.diagnosis.findings import dependence_on, quantity
from sysid.errors import InvalidInput
from sysid.estimation.disturbances import CORRELATION_TIMES, NO_DISTURBANCE, Disturbances
from sysid.estimation.kalman import Filter
from sysid.estimation.likelihood import SIGMA_99, likelihood_ascent, maximum_likelihood
from sysid.estimation.linearisation import Samples, level
from sysid.estimation.prediction_error import Fit
from sysid.estimation.solver import HELD, Settings, fit_parameters
from sysid.physics.model import Model
from sysid.physics.ops import Array

CORRELATION_TIME = 0.1
"""Correlation time [s] of d where models are compared, and where the largest d that a log could hide is found."""
WITHOUT_SHARED_ERROR = Settings(shared_error=False)
"""Settings without an error of the angle that neighbouring readings share: all that readings show counts as motion."""
_FLOOR = np.full(3, -40.0)
_BINS = 24
_CELLS = (10, 8)


@dataclass(frozen=True, eq=False)
class Followed:
    """The smoothed motion and torque of one record of N intervals.

    t, theta, theta_dot (N+1,)  [s], [rad], [rad/s]   the motion
    d, sd (N,)                  [N m]                 the torque beyond the model from t[k] to t[k+1], and its sd
    """

    name: str
    t: Array
    theta: Array
    theta_dot: Array
    d: Array
    sd: Array


@dataclass(frozen=True, eq=False)
class Binned:
    """The mean (B,) of d in each of B bins of a quantity and the posterior sd (B,) of that mean, nan in empty bins;
    count (B,) of intervals; and the bins' edges (B+1,) in `unit`."""

    name: str
    unit: str
    edges: Array
    mean: Array
    sd: Array
    count: NDArray[np.intp]

    @property
    def peak(self) -> tuple[float, float]:
        """The edges of the range around the largest |mean| over which |mean| is at least half of that. They may exceed
        2 pi if the range of theta spans 0."""
        mean, B = np.nan_to_num(self.mean), len(self.mean)
        mean = np.where(np.abs(mean) > 2.0 * np.nan_to_num(self.sd), mean, 0.0)
        at = int(np.argmax(np.abs(mean)))
        strong = mean * np.sign(mean[at]) >= 0.5 * abs(mean[at])
        round_about = self.name == "theta" and math.isclose(self.edges[-1] - self.edges[0], 2.0 * math.pi)
        low, high = at, at
        while strong[(low - 1) % B] and (round_about or low > 0) and high - low < B - 1:
            low -= 1
        while strong[(high + 1) % B] and (round_about or high < B - 1) and high - low < B - 1:
            high += 1
        width = self.edges[1] - self.edges[0]
        return float(self.edges[at] + (low - at) * width), float(self.edges[at] + (high + 1 - at) * width)


@dataclass(frozen=True, eq=False)
class TorqueMap:
    """The mean (I, J) of d in cells of theta (its place) and theta_dot and the posterior sd of that mean, nan in empty
    cells; count (I, J) of intervals; and the cells' edges theta (I+1,) and theta_dot (J+1,)."""

    theta: Array
    theta_dot: Array
    torque: Array
    sd: Array
    count: NDArray[np.intp]

    @property
    def significant(self) -> NDArray[np.bool_]:
        """The cells (I, J) in which the torque is larger than 2.6 of its sd."""
        return np.nan_to_num(np.abs(self.torque)) > SIGMA_99 * np.nan_to_num(self.sd, nan=np.inf)


@dataclass(frozen=True, eq=False)
class ResidualTorque:
    """The torque d(t) that acts beyond a model, smoothed from the log, with its posterior band.

    Attributes
    ----------
    records : tuple of Followed
        d and the motion of each record.
    s, T : float
        The sd [N m] and correlation time [s] of d that make the log likeliest. If no torque is needed, s is the largest
        that the log does not rule out, one-sided at 95 %.
    present : bool
        Whether the log needs such a torque.
    drive : float
        RMS of the drive torque [N m].
    averaged : float
        RMS of d averaged over 0.4 s [N m], as a diagnosis counts what is missing; nan if all records are shorter.
    binned : dict
        The mean of d over each of theta (its place), theta_dot, torque, time.
    map : TorqueMap
        The mean of d over theta and theta_dot together.
    dependence : Dependence
        The quantity that predicts d on left-out stretches of the log.
    contacts : tuple of Contact
        Stretches in which d is extreme for the state of the joint: a hand's push, or lost readings, perhaps.
    units : dict
        The units of "theta", "theta_dot", "torque" and "time" for the model's plant.
    converged : bool
        Whether the iteration of the smoothed motion converged.
    """

    records: tuple[Followed, ...]
    s: float
    T: float
    present: bool
    drive: float
    averaged: float
    binned: dict[str, Binned]
    map: TorqueMap
    dependence: Dependence
    contacts: tuple[Contact, ...]
    units: dict[str, str]
    converged: bool

    @property
    def rms(self) -> float:
        """RMS of d over the log [N m]."""
        return _root_mean_square(np.concatenate([r.d for r in self.records]))

    @property
    def band(self) -> float:
        """RMS of the posterior sd of d [N m]."""
        return _root_mean_square(np.concatenate([r.sd for r in self.records]))

    @property
    def share(self) -> float:
        """RMS of d as a share of the drive torque's; infinite for a free swing."""
        return self.rms / self.drive if self.drive > 0.0 else math.inf

    @property
    def restless(self) -> bool:
        """Whether d is correlated over a few samples only and no quantity predicts it: a vibration, perhaps."""
        first = self.records[0]
        return self.depends_on == ("time",) and 4.0 * float(first.t[1] - first.t[0]) > self.T

    @property
    def depends_on(self) -> tuple[str, ...]:
        """What d depends on: some of "theta", "theta_dot", "torque", "time", "history"; () if no torque is needed."""
        return self.dependence.depends_on if self.present else ()

    def over(self, name: str) -> Binned:
        """The mean of d over "theta" (its place), "theta_dot", "torque" or "time"; raises InvalidInput for others."""
        if name not in self.binned:
            raise InvalidInput(
                f"a residual torque is not drawn over {name!r}: expected one of {', '.join(self.binned)}"
            )
        return self.binned[name]

    def to_dict(self, series: bool = True) -> dict[str, Any]:
        """Plain data, ready for JSON, with None in bins without samples; `series` adds d over time."""
        others = {
            "unit": self.units["torque"],
            "predicts": self.dependence.shares,
            "where": self.dependence.where if self.present else "",
            "touched": self.contacts,
            "over": self.binned,
        }
        names = ("present", "rms", "averaged", "share", "band", "s", "T", "depends_on", "map")
        return dict(plain(others)) | plain_fields(self, *names, *(("records",) if series else ()))

    @property
    def sentence(self) -> str:
        """A sentence on how large d is and what it depends on."""
        what, unit = quantity("torque", self.units), self.units["torque"]
        if not self.present:
            return f"No {what} beyond the model is visible; one of {self.s:.2g} {unit} rms would be."
        share = f"{self.share:.0%} of the drive's" if math.isfinite(self.share) else ""
        averaged = f"{self.averaged:.2g} {unit} averaged over 0.4 s" if math.isfinite(self.averaged) else ""
        of_it = "; ".join(filter(None, (share, averaged)))
        size = f"{self.rms:.2g} {unit} rms" + (f" ({of_it})" if of_it else "")
        on = dependence_on(self.depends_on, self.dependence.where)
        vibration = " It changes from sample to sample: a vibration, or readings that contradict each other."
        return f"A {what} of {size} acts beyond the model; {on}.{vibration * self.restless}"

    def __str__(self) -> str:
        return " ".join([self.sentence, *([contacts_sentence(self.contacts)] if self.contacts else [])])


def residual_torque(model: Model, records: Sequence[Record], sensor: Sensor) -> ResidualTorque:
    """Find the torque d(t) that has to act beyond a model, constant over each interval, to produce the records.

        x_(k+1) = F(x_k, drive_k + d_k),   y_k = h(x_k) + noise of the sensor's sd

    d is a stationary Gaussian process with the size and the correlation time that make the log likeliest. The cost is
    linear in the samples.

    Parameters
    ----------
    model : Model
        The model as it is; no number of it is fitted.
    records : sequence of Record
        At least one rollout.
    sensor : Sensor
        Noise of the readings. If they hold vibrations that no rigid joint has, better give the sd of the readings about
        a fit of the model.

    Returns
    -------
    ResidualTorque
        The torque over time with its sd, its means over several quantities, and the quantity that it depends on.

    Raises
    ------
    InvalidInput
        For records that do not fit the model or lack a channel, and for a model that runs away within one sample.
    """
    return torque_of(followed(Samples(model, records, sensor), model))


def followed(samples: Samples, model: Model) -> Fit:
    """Fit only the size and the correlation time of the random torque beside a model; raises InvalidInput if the model
    runs away within one sample."""
    prior = Disturbances(0.3 * level(samples), CORRELATION_TIME)
    begun = fit_parameters(samples, model, (), disturbances=prior, settings=WITHOUT_SHARED_ERROR)
    if not math.isfinite(begun.deviance):
        raise InvalidInput("the model runs away from these records within a sample: no torque can be told beside it")
    trials = (begun.disturbances.with_memory(T) for T in CORRELATION_TIMES)
    return fit_parameters(
        samples,
        model,
        (),
        begun,
        maximum_likelihood(begun.linearised.system, trials, shared_error=False),
        WITHOUT_SHARED_ERROR,
    )


def torque_of(fit: Fit) -> ResidualTorque:
    """The residual torque of a fit, in numbers over time, over quantities and over states."""
    samples, inertia = fit.samples, fit.inertia
    present = not fit.undisturbed
    filter = fit.filter if present else fit.linearised.system.filter(_largest(fit))
    z, inside = filter.smooth(), samples.follows
    d, sd = inertia * z[:, 2], inertia * filter.posterior_sd()[:, 2]
    x, averaged, at = fit.motion.x + z[:, :2], slow(d, samples.number, samples.dt), coordinates(fit)
    means = _Means(fit, filter, d)
    return ResidualTorque(
        records=tuple(
            Followed(r.name, r.t, x[a:b, 0], x[a:b, 1], d[a : b - 1], sd[a : b - 1])
            for r, a, b in zip(samples.records, samples.first[:-1].tolist(), samples.first[1:].tolist(), strict=True)
        ),
        s=inertia * filter.disturbances.s,
        T=filter.disturbances.T,
        present=present,
        drive=_root_mean_square(fit.linearised.drive_torques[inside]),
        averaged=_root_mean_square(averaged),
        binned={name: means.over(name, values) for name, values in at.items()},
        map=means.map(at["theta"], at["theta_dot"]),
        dependence=dependence(fit, averaged),
        contacts=find_contacts(fit, averaged, 4.0 * means.sd_of_slow()) if present else (),
        units=fit.model.plant.quantities,
        converged=fit.converged,
    )


def _root_mean_square(values: Array) -> float:
    """RMS of the values that are known; nan if there are none."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def needed_disturbances(base: Fit, beside: Disturbances = NO_DISTURBANCE) -> Disturbances:
    """The likeliest random torque beside a fitted model, with T = CORRELATION_TIME and the error that readings share
    in `beside`, by default none.

    It begins large if such an error took the torque's place in the fit, else at the fit's own.
    """
    least = level(base.samples) if base.samples.error_channel else 1e-3 * float(np.std(base.samples.smoothed[:, 1]))
    begun = replace(beside, s=max(base.disturbances.s, least), T=CORRELATION_TIME)
    likely = base.linearised.system.filter(begun)
    for _ in range(6):
        before, likely = likely, likelihood_ascent(likely, _FLOOR, shared_error=False)
        if likely is before:
            break
    return likely.disturbances


def missing_torque(fit: Fit, disturbances: Disturbances) -> Array:
    """The torque (M,) [N m] that the log needs beside a fitted model, made `slow` unless all records are too short.
    Models are compared under the same `disturbances`, those that the model as it came needs."""
    smoothed = fit_parameters(fit.samples, fit.model, (), fit, disturbances, HELD)
    torque = fit.inertia * smoothed.motion.d
    averaged = slow(torque, fit.samples.number, fit.samples.dt)
    return averaged if np.any(np.isfinite(averaged)) else torque


def _largest(fit: Fit) -> Disturbances:
    """The largest random torque that the log does not rule out: its deviance is 1.645^2 above that without any."""
    from scipy.optimize import brentq

    system = fit.linearised.system

    def excess(log_s: float) -> float:
        return system.filter(Disturbances(math.exp(log_s), CORRELATION_TIME)).deviance - none - 1.645**2

    none = system.filter(Disturbances(0.0)).deviance
    low = high = math.log(1e-6 * level(fit.samples))
    while excess(high) < 0.0 and high < low + 60.0:
        low, high = high, high + 1.0
    return Disturbances(
        math.exp(brentq(excess, low, high, xtol=0.05) if excess(low) < 0.0 < excess(high) else high), CORRELATION_TIME
    )


@dataclass(frozen=True, eq=False)
class _Means:
    """Computes means of d [N m] over groups of intervals, with their posterior sd."""

    fit: Fit
    filter: Filter
    d: Array

    def of(self, group: NDArray[np.intp], groups: int) -> tuple[Array, Array, NDArray[np.intp]]:
        """Mean, sd and count (groups,) over the intervals of each group; nan for an empty one."""
        inside = self.fit.samples.follows
        count = np.bincount(group[inside], minlength=groups)
        shares = (group[:, None] == np.arange(groups)) * inside[:, None] / np.maximum(count, 1)
        mean = np.where(count > 0, self.d @ shares, math.nan)
        sd = np.where(count > 0, self.fit.inertia * self.filter.posterior_sd_of_sums(shares), math.nan)
        return mean, sd, count

    def sd_of_slow(self) -> float:
        """The median, over 24 places of the log, of the posterior sd of d made `slow`."""
        samples = self.fit.samples
        at = np.linspace(0, len(samples) - 1, 26).astype(int)[1:-1]
        once = (np.arange(len(samples))[:, None] == at).astype(float)
        shares = np.nan_to_num(np.stack([slow(v, samples.number, samples.dt) for v in once.T], axis=1))
        sd = self.filter.posterior_sd_of_sums(shares)[np.sum(shares, axis=0) > 0.99]
        return self.fit.inertia * float(np.median(sd)) if len(sd) else math.inf

    def over(self, name: str, values: Array) -> Binned:
        """The means in bins of one quantity (M,)."""
        plant = self.fit.model.plant
        edges = _edges(name, values[self.fit.samples.follows], plant.turns)
        return Binned(name, plant.quantities[name], edges, *self.of(_bin(values, edges), _BINS))

    def map(self, theta: Array, theta_dot: Array) -> TorqueMap:
        """The means in cells of the states."""
        inside = self.fit.samples.follows
        cut = [np.linspace(*_spread(v[inside]), n + 1) for v, n in zip((theta, theta_dot), _CELLS, strict=True)]
        cell = _bin(theta, cut[0]) * _CELLS[1] + _bin(theta_dot, cut[1])
        mean, sd, count = self.of(cell, math.prod(_CELLS))
        return TorqueMap(cut[0], cut[1], mean.reshape(_CELLS), sd.reshape(_CELLS), count.reshape(_CELLS))


def _edges(name: str, values: Array, turns: bool) -> Array:
    low, high = (0.0, 2.0 * math.pi) if name == "theta" and turns else (float(values.min()), float(values.max()))
    return np.linspace(low, high if high > low else low + 1e-9, _BINS + 1)


def _spread(values: Array) -> tuple[float, float]:
    """The range of all but the rarest values."""
    low, high = np.quantile(values, [0.002, 0.998])
    return float(low), max(float(high), float(low) + 1e-6)


def _bin(values: Array, edges: Array) -> NDArray[np.intp]:
    """The bin (M,) of each value; values beyond the edges belong to the outer bins."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
