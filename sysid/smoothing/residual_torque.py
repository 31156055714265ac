"""Residual torque: what must act on the joint beyond the model for the log to have come about."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.comparison.held_out import finite
from sysid.errors import InvalidInput
from sysid.identify.start import smooth_states
from sysid.model import Model
from sysid.records import Array, Record, check_records
from sysid.response import Response
from sysid.sensor import Sensor
from sysid.smoothing.instants import Instants
from sysid.smoothing.likeliest import SIGNIFICANT, largest, likeliest
from sysid.smoothing.smoother import Chain, Smoothed, Torque
from sysid.smoothing.touched import HAND, Touched, slow, touched
from sysid.windows import cut

UNITS = {"theta": "rad", "theta_dot": "rad/s", "torque": "N m", "time": "s"}
"""What a residual torque can be drawn over."""

_BINS = 24
_ITERATIONS = 5
_RESTS = 0.02
"""A motion that moves by less than this in units of its sd has come to rest."""
_FAR, _LOST = 2.0, 100.0
"""Multiples of the sensor's sd beyond which a model does not follow the readings, or never will."""
_NOTHING = Torque(0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Followed:
    """One record of N intervals as the smoother follows it.

    t, theta, theta_dot (N+1,)  [s], [rad], [rad/s]   the motion
    d, sd (N,)                  [N m]                 the torque held from t[k] to t[k+1] beyond the model, and its sd
    """

    name: str
    t: Array
    theta: Array
    theta_dot: Array
    d: Array
    sd: Array


@dataclass(frozen=True, eq=False)
class Binned:
    """The mean of d [N m] in each of B bins of a coordinate, with the posterior sd of that mean; nan in empty bins.

    edges (B+1,) in `unit`; mean, sd, count (B,).
    """

    name: str
    unit: str
    edges: Array
    mean: Array
    sd: Array
    count: NDArray[np.intp]

    @property
    def peak(self) -> tuple[float, float]:
        """Edges of the stretch of half the largest |mean| or more; beyond 2 pi where a peak of theta spans 0."""
        mean, B = np.nan_to_num(self.mean), len(self.mean)
        mean = np.where(np.abs(mean) > 2.0 * np.nan_to_num(self.sd), mean, 0.0)
        at = int(np.argmax(np.abs(mean)))
        alike = mean * np.sign(mean[at]) >= 0.5 * abs(mean[at])
        round_about = self.name == "theta" and math.isclose(self.edges[-1] - self.edges[0], 2.0 * math.pi)
        low, high = at, at
        while alike[(low - 1) % B] and (round_about or low > 0) and high - low < B - 1:
            low -= 1
        while alike[(high + 1) % B] and (round_about or high < B - 1) and high - low < B - 1:
            high += 1
        width = self.edges[1] - self.edges[0]
        return float(self.edges[at] + (low - at) * width), float(self.edges[at] + (high + 1 - at) * width)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON; a bin without samples holds None."""
        numbers = {k: [finite(v) for v in getattr(self, k).tolist()] for k in ("edges", "mean", "sd")}
        return {"name": self.name, "unit": self.unit, **numbers, "count": self.count.tolist()}


@dataclass(frozen=True, eq=False)
class ResidualTorque:
    """What acts beyond the model: d(t), smoothed from the log, with its posterior band.

    records         one a record: the torque d and the motion, each with its instants
    torque          size and memory of d as the log has them (largest likelihood)
    gain            log-likelihood of the log with such a torque, less that without any
    log_likelihood  of the readings, with it
    errors          RMS of readings less model in units of the sensor's sd: without d over windows of 1 s with refitted
                    states (as in held_out_error), and with d
    binned          its mean over each of theta (mod 2 pi), theta_dot, torque, time
    explained       share of the mean square of d that its mean over that coordinate, taken from the other records
                    (from other stretches, where there is one record), predicts; 0 where it predicts nothing
    touched         stretches that no torque of the joint's state explains while the others fit: a hand, perhaps
    converged       whether the smoothed motion came to rest
    """

    records: tuple[Followed, ...]
    torque: Torque
    gain: float
    log_likelihood: float
    errors: tuple[float, float]
    binned: dict[str, Binned]
    explained: dict[str, float]
    touched: tuple[Touched, ...]
    converged: bool

    @property
    def present(self) -> bool:
        """Whether the log needs such a torque."""
        return self.gain > SIGNIFICANT

    @property
    def restless(self) -> bool:
        """Whether d has no memory beyond a few samples, so that it is no torque of the joint's slow motion."""
        first = self.records[0]
        return self.present and 4.0 * float(first.t[1] - first.t[0]) > self.torque.T

    @property
    def rms(self) -> float:
        """RMS of d over the log [N m]."""
        return float(np.sqrt(np.mean(np.concatenate([r.d for r in self.records]) ** 2)))

    @property
    def band(self) -> float:
        """RMS of the posterior sd of d [N m]."""
        return float(np.sqrt(np.mean(np.concatenate([r.sd for r in self.records]) ** 2)))

    @property
    def q(self) -> float:
        """Strength of d: the variance that it gains in a second of walking [N^2 m^2/s]."""
        return 2.0 * self.torque.s**2 / self.torque.T

    @property
    def share(self) -> float:
        """How much of the squared error over 1 s windows goes when d acts, 0 ... 1; 0 where no torque is needed."""
        without, within = self.errors
        return max(0.0, 1.0 - (within / without) ** 2) if self.present and without > 0.0 else 0.0

    def over(self, name: str) -> Binned:
        """The mean of d over "theta" (mod 2 pi), "theta_dot", "torque" or "time"; raises InvalidInput for others."""
        if name not in self.binned:
            raise InvalidInput(
                f"a residual torque is not drawn over {name!r}: expected one of {', '.join(self.binned)}"
            )
        return self.binned[name]

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return {
            "present": self.present,
            "rms": self.rms,
            "band": self.band,
            "share": self.share,
            "gain": self.gain,
            "log_likelihood": self.log_likelihood,
            "q": self.q,
            "errors": list(self.errors),
            "explained": self.explained,
            "touched": [vars(t) for t in self.touched],
            "over": {name: b.to_dict() for name, b in self.binned.items()},
            "records": [
                {k: v if isinstance(v, str) else v.tolist() for k, v in vars(record).items()} for record in self.records
            ],
        }

    def __str__(self) -> str:
        if not self.present:
            return f"no torque beyond the model is visible; one of {2.0 * self.torque.s:.2g} N m rms would be"
        sentences = [
            f"a torque of {self.rms:.2g} N m rms is needed beyond the model; it is largest {self._where()}",
            f"without it the model misses by {self.errors[0]:.3g} times the sensor noise within 1 s, "
            f"with it by {self.errors[1]:.3g}",
        ]
        if self.restless:
            sentences.append("it changes from sample to sample: a vibration, or readings that contradict each other")
        if self.touched:
            sentences.append("no state of the joint explains " + "; ".join(map(str, self.touched)))
        return ". ".join(sentences)

    def _where(self) -> str:
        name, share = max(self.explained.items(), key=lambda item: item[1])
        if share > 0.2:
            low, high = self.binned[name].peak
            return f"near {name} = {low:.2g} to {high:.2g} {UNITS[name]}"
        record = max(self.records, key=lambda r: float(np.max(np.abs(r.d))))
        return f"near t = {record.t[int(np.argmax(np.abs(record.d)))]:.3g} s of {record.name}"


def residual_torque(model: Model, records: Sequence[Record], sensor: Sensor) -> ResidualTorque:
    """The torque d(t) beyond a model, constant over an interval, that makes the model follow the records.

        x_(k+1) = F(x_k, drive_k + d_k),   y_k = h(x_k) + noise of the sensor's sd

    d is Gaussian with the size and the memory of largest likelihood; where the model needs no torque, with the largest
    size that the log allows, and d is zero within its band. The motion is smoothed around itself until it rests
    (iterated Kalman smoother, which is Gauss-Newton on all states; Bell, SIAM J. Optim. 4, 1994). Cost is linear in
    samples. Where the readings hold vibrations that no rigid joint has, the sd of the readings about the model's fit
    is the better sensor. Raises InvalidInput for records that do not fit the model or lack a channel.
    """
    log = Instants(model, Response(model, (), records, sensor, cut(check_records(model, records))))
    x, error = log.windows()
    alone, chain, none = _alone(log, _motion(x))
    found: tuple[Torque, ...] = ()
    if math.isfinite(none):
        found, torque = likeliest(chain, log.motion_torque(alone.x, chain), log.shortest)
    if not found or chain.log_likelihood(torque) > none + SIGNIFICANT:
        if not (found or log.model.output_effects):
            x = np.concatenate([smooth_states(r, sensor) for r in log.records])
        start = alone if found else _motion(x)
        own, motion, torque, converged = _followed(log, start, found)
        gain = own.log_likelihood(torque) - max(none, own.log_likelihood(_NOTHING))
        if gain > SIGNIFICANT:
            return _answer(log, own, motion, torque, gain, error, converged)
    torque = largest(chain, log.motion_torque(alone.x, chain))
    return _answer(log, chain, _step(chain, torque, alone)[0], torque, 0.0, error, True)


class _Motion(NamedTuple):
    """States x (M, 2), the torque d (M,), and how wide (M, 3) the model is sloped about them."""

    x: Array
    d: Array
    steps: Array


def _motion(x: Array) -> _Motion:
    return _Motion(x, np.zeros(len(x)), np.array([1e-3, 0.05, 0.01]) * np.ones((len(x), 1)))


def _alone(log: Instants, motion: _Motion) -> tuple[_Motion, Chain, float]:
    """The model's motion without any d, and its log-likelihood: -inf where it does not follow the readings."""
    for _ in range(_ITERATIONS):
        chain = log.chain(*motion)
        if np.mean(chain.r[log.weight > 0.0] ** 2) > _LOST**2:
            break
        motion, moved = _step(chain, _NOTHING, motion)
        if moved < _RESTS:
            break
    chain = log.chain(*motion)
    follows = np.mean(chain.r[log.weight > 0.0] ** 2) < _FAR**2
    return motion, chain, chain.log_likelihood(_NOTHING) if follows else -math.inf


def _step(chain: Chain, torque: Torque, motion: _Motion) -> tuple[_Motion, float]:
    """The motion smoothed about itself, and by how many sd it moved (RMS)."""
    smoothed = chain.smooth(torque)
    sd = np.sqrt(smoothed.variance[:, :3])
    moved = smoothed.mean[:, :3] - np.column_stack([np.zeros_like(motion.x), motion.d])
    distance = float(np.sqrt(np.mean((moved / np.maximum(sd, 1e-12))[chain.follows] ** 2)))
    after = _Motion(motion.x + smoothed.mean[:, :2], smoothed.mean[:, 2], np.maximum(sd, [1e-6, 1e-5, 1e-6]))
    return after, distance


def _followed(log: Instants, motion: _Motion, found: tuple[Torque, ...]) -> tuple[Chain, _Motion, Torque, bool]:
    """The motion at rest under the likeliest torque, which is sought at first and again about the right motion."""
    settled, moved = False, math.inf
    for _ in range(2 * _ITERATIONS):
        chain = log.chain(*motion)
        if math.isinf(moved) or (moved < _RESTS and not settled):
            settled = moved < _RESTS
            found, torque = likeliest(chain, log.motion_torque(motion.x, chain), log.shortest, found)
        motion, moved = _step(chain, torque, motion)
        if moved < _RESTS and settled:
            break
    return chain, motion, torque, moved < _RESTS


def _answer(
    log: Instants,
    chain: Chain,
    motion: _Motion,
    torque: Torque,
    gain: float,
    error: float,
    converged: bool,
) -> ResidualTorque:
    (x, d, _), inside = motion, log.follows
    smoothed = chain.smooth(torque, linked=True)
    sd = np.sqrt(smoothed.variance[:, 2])
    seen = log.weight > 0.0
    normal = float(np.sum(np.log(log.weight[seen]))) - 0.5 * math.log(2.0 * math.pi) * np.count_nonzero(seen)
    at, number = log.coordinates(x), log.number[inside]
    stretch = number if len(log.records) > 1 else np.arange(len(number)) * 8 // len(number)
    binned = {name: _binned(name, at[name], d, inside, smoothed, log.model.plant.turns) for name in UNITS}
    return ResidualTorque(
        records=tuple(
            Followed(v.name, v.t, own[:, 0], own[:, 1], own[:-1, 2], own[:-1, 3])
            for v, own in zip(log.records, log.split(np.column_stack([x, d, sd])), strict=True)
        ),
        torque=torque,
        gain=gain,
        log_likelihood=chain.log_likelihood(torque) + normal,
        errors=(error, float(np.sqrt(np.mean(log.residuals(x)[seen] ** 2)))),
        binned=binned,
        explained={name: _explained(at[name][inside], d[inside], stretch, binned[name].edges) for name in UNITS},
        touched=_touched(log, x, d, smoothed) if gain > SIGNIFICANT else (),
        converged=converged,
    )


def _touched(log: Instants, x: Array, d: Array, smoothed: Smoothed) -> tuple[Touched, ...]:
    dt, inside, number = log.model.dt, log.follows, log.number[log.follows]
    # how the sd of an average compares to that of a sample is found on a few stretches: it is alike in all
    length, group = max(1, round(HAND / dt)), np.full(len(x), -1)
    for i, begin in enumerate(np.linspace(0, max(len(x) - length, 0), _BINS).astype(int)):
        group[begin : begin + length] = i
    group[~inside] = -1
    variance = np.maximum(smoothed.variance[:, 2], 1e-30)
    kept = np.unique(group[group >= 0])
    single = np.array([np.mean(variance[group == i]) for i in kept])
    ratio = float(np.median(smoothed.sd_of_means(group, _BINS)[kept] / np.sqrt(single)))
    names = [v.name for v in log.records]
    averaged = slow(d[inside], number, dt)
    return touched(names, number, log.t[inside], x[inside], averaged, ratio * np.sqrt(variance[inside]), dt)


def _binned(
    name: str, coordinate: Array, d: Array, follows: NDArray[np.bool_], smoothed: Smoothed, turns: bool
) -> Binned:
    own = coordinate[follows]
    low, high = (0.0, 2.0 * math.pi) if name == "theta" and turns else (float(own.min()), float(own.max()))
    edges = np.linspace(low, high if high > low else low + 1e-9, _BINS + 1)
    group = np.where(follows, np.clip(np.searchsorted(edges, coordinate, side="right") - 1, 0, _BINS - 1), -1)
    count = np.bincount(group[follows], minlength=_BINS)
    total = np.bincount(group[follows], weights=d[follows], minlength=_BINS)
    mean = np.divide(total, count, out=np.full(_BINS, math.nan), where=count > 0)
    sd = np.where(count > 0, smoothed.sd_of_means(group, _BINS), math.nan)
    return Binned(name, UNITS[name], edges, mean, sd, count)


def _explained(coordinate: Array, d: Array, stretch: NDArray[np.intp], edges: Array) -> float:
    """1 - mean (d - prediction)^2 / mean d^2: each stretch is predicted by the bin means of all others."""
    bins, folds = len(edges) - 1, int(stretch.max()) + 1
    group = np.clip(np.searchsorted(edges, coordinate, side="right") - 1, 0, bins - 1)
    cell = stretch * bins + group
    count, total = (np.bincount(cell, w, folds * bins).reshape(folds, bins) for w in (np.ones(len(d)), d))
    count, total = count.sum(axis=0) - count, total.sum(axis=0) - total
    prediction = np.divide(total, count, out=np.zeros_like(total), where=count > 0.0)[stretch, group]
    square = float(np.mean(d**2))
    return max(0.0, 1.0 - float(np.mean((d - prediction) ** 2)) / square) if square > 0.0 else 0.0
