"""Residual torque: what must act on the joint beyond the model for the log to have come about."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.diagnose.held_out import finite
from sysid.diagnose.smoother import Chain, Smoothed, Torque
from sysid.diagnose.touched import HAND, Touched, slow, touched
from sysid.errors import InvalidInput
from sysid.identify.start import smooth_states
from sysid.model import Model
from sysid.records import Array, Record, check_records
from sysid.response import Response, cut
from sysid.sensor import Sensor

UNITS = {"theta": "rad", "theta_dot": "rad/s", "torque": "N m", "time": "s"}
"""What a residual torque can be drawn over."""

_BINS = 24
_ITERATIONS = 8
_SAMPLES = 8_000
"""Instants from which the size and the memory of the torque are found: more would not change them."""
_NO_PARAMETERS = np.zeros(0)
_SPREAD = (3.0, 30.0)
"""How far a record's first state may lie from the motion without a model [rad], [rad/s]: anywhere."""
_CLEARLY = 10.0
SIGNIFICANT = 4.6
"""Gain in log-likelihood that two free numbers reach by chance in 1 of 100 logs, at most."""


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
    """The mean of d [N m] in each of B bins of a coordinate, with the posterior sd of that mean; nan where no sample is.

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
        round_about = self.name == "theta"
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
    errors          RMS of readings less model over 1 s windows that start on the smoothed motion, in units of the
                    sensor's sd: without d, and with it
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
        return self.present and self.torque.T < 4.0 * float(first.t[1] - first.t[0])

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

    d is Gaussian with a size and a memory of largest likelihood; where the model needs no torque they are the largest
    that the log allows, and d is zero within its band. The motion is smoothed around itself until it rests
    (iterated Kalman smoother: Gauss-Newton on all states; Bell, SIAM J. Optim. 4, 1994). Linear in samples.
    Raises InvalidInput for records that do not fit the model or lack what the sensor vouches for.
    """
    log = _Log(model, Response(model, (), records, sensor, cut(check_records(model, records))))
    x = np.concatenate([smooth_states(r, sensor) for r in log.response.records])
    d = np.zeros(len(x))
    converged = False
    steps = np.array([1e-3, 0.05, 0.01]) * np.ones((len(x), 1))
    searches, best = 0, tuple[Torque, ...]()
    for _ in range(_ITERATIONS):
        chain = log.chain(x, d, steps)
        if searches == 0 or (converged and searches == 1):  # again, now about the right motion
            best, torque, gain = _likeliest(chain, log.motion_torque(x, chain), best)
            searches += 1
        smoothed = chain.smooth(torque)
        before, d = d, smoothed.mean[:, 2]
        sd = np.sqrt(np.maximum(np.diagonal(smoothed.cov, 0, 1, 2), 0.0))
        x = x + smoothed.mean[:, :2]
        steps = np.maximum(sd[:, :3], [1e-6, 1e-5, 1e-6])
        moved = np.abs(smoothed.mean[:, :3] - np.column_stack([np.zeros_like(x), before]))
        converged = bool(np.sqrt(np.mean((moved / np.maximum(sd[:, :3], 1e-12))[chain.follows] ** 2)) < 0.02)
        if converged and searches == 2:
            break
    return _answer(log, x, smoothed, torque, gain, chain.log_likelihood(torque), converged)


class _Log:
    """All instants of all records, one after the other (M,), and what the model says at them."""

    def __init__(self, model: Model, response: Response) -> None:
        self.model, self.response = model, response
        counts = np.array([len(r) for r in response.records])
        self.inside = np.arange(response.length + 1) <= counts[:, None]
        beyond = np.full((len(counts), 1), counts.sum())
        rows = np.concatenate([response.interval, beyond], axis=1)[self.inside]
        self.drives = response.drives(_NO_PARAMETERS)[0][rows]
        self.t = response.time[self.inside]
        self.y, self.weight = (np.swapaxes(v, 1, 2)[self.inside] for v in (response.y, response.weight))
        self.follows = np.ones(len(self.t), dtype=bool)
        self.follows[np.cumsum(counts + 1) - 1] = False

    def _move(self, x: Array, d: Array) -> Array:
        drives = tuple((self.drives + d[:, None]).T)
        moved = np.broadcast_arrays(*self.model.move(x[:, 0], x[:, 1], drives, self.t))
        return np.stack(moved, axis=1)

    def read(self, x: Array) -> Array:
        padded = np.zeros((*self.inside.shape, 2))
        padded[self.inside] = x
        return np.swapaxes(self.response.readings(_NO_PARAMETERS, padded), 1, 2)[self.inside]

    def chain(self, x: Array, d: Array, steps: Array) -> Chain:
        """The model about a motion x (M, 2) under d (M,), sloped over `steps` (M, 3) of theta, theta_dot, d.

        Central differences as wide as z is uncertain: a joint that sticks has no slope at a point, and a filter that
        believed in none would never let it go.
        """
        z = np.column_stack([x, d])
        A, H = np.zeros((len(x), 2, 3)), np.zeros((len(x), 2, 2))
        for i in range(3):
            up, down = z.copy(), z.copy()
            up[:, i] += steps[:, i]
            down[:, i] -= steps[:, i]
            width = 2.0 * steps[:, i, None]
            A[:, :, i] = (self._move(up[:, :2], up[:, 2]) - self._move(down[:, :2], down[:, 2])) / width
            if i < 2:
                H[:, :, i] = (self.read(up[:, :2]) - self.read(down[:, :2])) / width
        gap = self._move(x, d) - A[:, :, 2] * d[:, None] - np.roll(x, -1, axis=0)
        A[~self.follows], gap[~self.follows] = 0.0, 0.0
        r = (self.y - self.read(x)) * self.weight
        return Chain(A, gap, H * self.weight[:, :, None], r, self.follows, _SPREAD, self.model.dt)

    def motion_torque(self, x: Array, chain: Chain) -> float:
        """RMS of the torque that moves the joint [N m]: the yardstick for d."""
        change = np.diff(x[:, 1])[self.follows[:-1]]
        return max(float(np.sqrt(np.mean(change**2)) / np.max(np.abs(chain.A[:, 1, 2]))), 1e-9)

    def errors(self, x: Array, r: Array) -> tuple[float, float]:
        """RMS of readings less model, in units of the sensor's sd: without d over 1 s from x, and along x."""
        windows = cut(self.response.records, 1.0)
        first = np.concatenate([[0], np.cumsum([len(v) + 1 for v in self.response.records])])
        starts = x[[first[w.record] + w.begin for w in windows]]
        response = Response(self.model, (), self.response.records, self.response.sensor, windows)
        read = max(int(np.count_nonzero(self.weight)), 1)
        without = float(np.sum(response.residual(_NO_PARAMETERS, starts) ** 2))
        return math.sqrt(without / read), math.sqrt(float(np.sum(r**2)) / read)

    def coordinates(self, x: Array) -> dict[str, Array]:
        """Mean theta (mod 2 pi), theta_dot, drive torque and time of each interval (M,), the last one of a record idle."""
        middle = 0.5 * (x + np.roll(x, -1, axis=0))
        own = {"theta": np.mod(middle[:, 0], 2.0 * math.pi), "theta_dot": middle[:, 1]}
        return own | {"torque": self.drives.mean(axis=1), "time": self.t + 0.5 * self.model.dt}

    def touched(self, x: Array, d: Array, smoothed: Smoothed) -> tuple[Touched, ...]:
        """Where something acted that no state of the joint explains."""
        records, inside, dt = self.response.records, self.follows, self.model.dt
        number = np.repeat(np.arange(len(records)), [len(v) for v in records])
        # how the sd of an average compares to that of a sample is found on a few stretches: it is alike in all
        length, group = max(1, round(HAND / dt)), np.full(len(x), -1)
        for i, begin in enumerate(np.linspace(0, max(len(x) - length, 0), _BINS).astype(int)):
            group[begin : begin + length] = i
        group[~inside] = -1
        variance = np.maximum(smoothed.cov[:, 2, 2], 1e-30)
        kept = np.unique(group[group >= 0])
        single = np.array([np.mean(variance[group == i]) for i in kept])
        ratio = float(np.median(smoothed.sd_of_means(group, _BINS)[kept] / np.sqrt(single)))
        sd = ratio * np.sqrt(variance[inside])
        return touched(
            [v.name for v in records], number, self.t[inside], x[inside], slow(d[inside], number, dt), sd, dt
        )

    def split(self, values: Array) -> list[Array]:
        """By record."""
        return np.split(values, np.cumsum([len(r) + 1 for r in self.response.records])[:-1])


def _likeliest(chain: Chain, size: float, last: tuple[Torque, ...]) -> tuple[tuple[Torque, ...], Torque, float]:
    """The likeliest torque of each kind, the one of the two to use, and its gain over none.

    Of the two kinds the smooth one, whose band is narrower, must be likelier by more than a little. Where neither
    gains anything, the one to use is the largest not ruled out. The search begins at `last`, or on a grid.
    """
    part = chain.thinned(_SAMPLES)
    if not last:
        coarse = chain.thinned(_SAMPLES // 4)
        sizes = [
            [Torque(f * size, T, k) for T in (0.1, 0.4, 1.6) for f in (1e-3, 1e-2, 0.1, 1.0)] for k in (False, True)
        ]
        last = tuple(max(grid, key=coarse.log_likelihood) for grid in sizes)
    rough, smooth = last = tuple(_climbed(part, torque) for torque in last)
    torque = smooth if part.log_likelihood(smooth) > part.log_likelihood(rough) + _CLEARLY else rough
    if part is not chain:  # a rare event may lie outside of the part
        wider = max((replace(torque, s=f * torque.s) for f in (1.0, 5.0, 25.0)), key=chain.log_likelihood)
        torque = torque if wider.s == torque.s else _climbed(chain, wider)
    gain = chain.log_likelihood(torque) - chain.log_likelihood(Torque(0.0, 1.0))
    return last, torque if gain > SIGNIFICANT else _largest(part, size), max(gain, 0.0)


def _climbed(chain: Chain, torque: Torque) -> Torque:
    """The torque of largest likelihood near another of its kind."""
    from scipy.optimize import minimize

    longest = max(20.0, len(chain.r) * chain.dt)

    def at(h: Array) -> Torque:
        s, T = torque.s * math.exp(h[0]), torque.T * math.exp(h[1])
        return Torque(s, min(max(T, 2.0 * chain.dt), longest), torque.smooth)

    simplex = [[0.0, 0.0], [0.7, 0.0], [0.0, 0.7]]
    options = {"xatol": 1.0, "fatol": 0.1, "initial_simplex": simplex, "maxfev": 40}
    found = minimize(lambda h: -chain.log_likelihood(at(h)), simplex[0], method="Nelder-Mead", options=options)
    return at(found.x)


def _largest(chain: Chain, size: float) -> Torque:
    """The largest torque with a memory of 0.5 s that the log does not rule out, one-sided at 95 %."""
    from scipy.optimize import brentq

    none = chain.log_likelihood(Torque(0.0, 0.5))

    def excess(log_s: float) -> float:
        return chain.log_likelihood(Torque(math.exp(log_s), 0.5)) - none + 0.5 * 1.645**2

    low = high = math.log(1e-6 * size)
    while excess(high) > 0.0 and high < math.log(1e3 * size):
        low, high = high, high + 1.0
    return Torque(math.exp(brentq(excess, low, high, xtol=0.02) if excess(high) < 0.0 else high), 0.5)


def _answer(
    log: _Log, x: Array, smoothed: Smoothed, torque: Torque, gain: float, log_likelihood: float, converged: bool
) -> ResidualTorque:
    d, sd = smoothed.mean[:, 2], np.sqrt(np.maximum(smoothed.cov[:, 2, 2], 0.0))
    inside, records = log.follows, log.response.records
    r = (log.y - log.read(x)) * log.weight
    seen = log.weight > 0.0
    normal = float(np.sum(np.log(log.weight[seen]))) - 0.5 * math.log(2.0 * math.pi) * np.count_nonzero(seen)
    at = log.coordinates(x)
    number = np.repeat(np.arange(len(records)), [len(v) + 1 for v in records])
    stretch = number[inside] if len(records) > 1 else np.arange(inside.sum()) * 8 // inside.sum()
    binned = {name: _binned(name, at[name], d, inside, smoothed) for name in UNITS}
    return ResidualTorque(
        records=tuple(
            Followed(v.name, v.t, own[:, 0], own[:, 1], own[:-1, 2], own[:-1, 3])
            for v, own in zip(records, log.split(np.column_stack([x, d, sd])), strict=True)
        ),
        torque=torque,
        gain=gain,
        log_likelihood=log_likelihood + normal,
        errors=log.errors(x, r),
        binned=binned,
        explained={name: _explained(at[name][inside], d[inside], stretch, binned[name].edges) for name in UNITS},
        touched=log.touched(x, d, smoothed) if gain > SIGNIFICANT else (),
        converged=converged,
    )


def _binned(name: str, coordinate: Array, d: Array, follows: NDArray[np.bool_], smoothed: Smoothed) -> Binned:
    own = coordinate[follows]
    low, high = (0.0, 2.0 * math.pi) if name == "theta" else (float(own.min()), float(own.max()))
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
