"""The baseline: what a careful engineer does in an afternoon, without a simulator of the machine.

The acceleration is a central difference of the smoothed speed; torque and regressors are averaged over the same
interval and pass the same filter, so that both sides of the equation are smoothed alike:

    theta_ddot = u / J + (G / J) sin(theta) + sum_j c_j r_j(theta, theta_dot, t)

Effects enter one by one, the one that lowers BIC most first; after each, those that BIC no longer wants leave. Delay,
lag, clip and dead zone of the torque, the orders of ripples and the frequencies of disturbances are scanned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_coeffs

from sysid import Record
from tests.benchmarks.rivals import lagged

Array = NDArray[np.float64]
MOST = 4  # effects at most
ORDERS = np.arange(2, 13)
FREQUENCIES = np.arange(0.2, 5.0, 0.05)  # [Hz]
FILTERS = ((5, 1), (7, 1), (11, 2), (15, 3), (21, 3))  # rows of the smoother; rows either side of the difference
QUIET = 0.45  # [rad/s^2]
SPEEDS = (0.15, 0.3, 0.6, 1.0)  # [rad/s] of Stribeck's curve


@dataclass(frozen=True)
class Finding:
    """Effects `chosen`, in the order in which they entered, and the first round's gains of BIC, best first."""

    chosen: tuple[str, ...]
    ranking: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class _Torque:
    """What happens to the command: shift and lag [s], clip and dead zone [N m]."""

    shift: float = 0.0
    lag: float = 0.0
    clip: float = np.inf
    dead: float = 0.0


@dataclass(frozen=True)
class _Term:
    """An effect in the regression: its name, columns, number of scanned parameters, and the torque path with it."""

    name: str
    columns: tuple[Array, ...] = ()
    scanned: int = 0
    torque: _Torque | None = None


@dataclass
class _Log:
    """The rows of all rollouts: smoothed states and averages over the interval of the difference."""

    records: Sequence[Record]
    window: int
    span: int

    def __post_init__(self) -> None:
        self.dt = self.records[0].dt
        self.smooth = savgol_coeffs(self.window, 2)
        slope = savgol_coeffs(self.window, 3, deriv=1, delta=self.dt)
        self.theta, self.theta_dot, accelerations = [], [], []
        for r in self.records:
            theta = np.convolve(_padded(r.theta, self.window), self.smooth, "valid")
            raw = r.theta_dot
            if raw is None:
                raw = np.convolve(_padded(r.theta, self.window), slope, "valid")
            self.theta.append(theta)
            self.theta_dot.append(np.convolve(_padded(raw, self.window), self.smooth, "valid"))
            n = self.span
            accelerations.append(self._filter((raw[2 * n :] - raw[: -2 * n]) / (2.0 * n * self.dt)))
        self.acceleration = np.concatenate(accelerations)
        self.t = [r.t - r.t[0] for r in self.records]
        self.threshold = max(3.0 * _noise(self.theta_dot), 1e-3)
        self.sine = self.mean(lambda a, v, t: np.sin(a))
        self.way = self.mean(lambda a, v, t: np.clip(v / self.threshold, -1.0, 1.0))
        self.terms = tuple(_fixed_terms(self))

    def _filter(self, x: Array) -> Array:
        return np.convolve(x, self.smooth, "valid")

    def mean(self, of: Callable[[Array, Array, Array], Array]) -> Array:
        """A function of (theta, theta_dot, t), averaged over the difference's interval and filtered like it."""
        n = self.span
        weights = np.ones(2 * n + 1)
        weights[[0, -1]] = 0.5
        if n == 1:
            weights = np.array([1.0, 4.0, 1.0])
        weights /= weights.sum()
        series = (of(a, b, c) for a, b, c in zip(self.theta, self.theta_dot, self.t, strict=True))
        return np.concatenate([self._filter(np.convolve(x, weights, "valid")) for x in series])

    def torque(self, path: _Torque) -> Array:
        """The torque that acted, averaged over the samples that the difference spans."""
        out = []
        for r in self.records:
            u = np.clip(r.u - np.clip(r.u, -path.dead, path.dead), -path.clip, path.clip)
            # The integral of a held signal is linear between rows, so that any shift is a look-up.
            edges = self.dt * np.arange(len(u) + 1)
            if path.lag > 0.0:
                (u,) = lagged(u[None], path.lag, self.dt)
            total = np.concatenate([[0.0], np.cumsum(u) * self.dt])
            n = self.span
            at = edges - path.shift
            integral = np.interp(at, edges, total)
            out.append(self._filter((integral[2 * n :] - integral[: -2 * n]) / (2.0 * n * self.dt)))
        return np.concatenate(out)


def _choose_filter(records: Sequence[Record]) -> tuple[int, int]:
    """The shortest of FILTERS that leaves at most QUIET of noise in the acceleration, the longest where none does."""
    dt = records[0].dt
    speeds = [r.theta_dot for r in records if r.theta_dot is not None]
    sigma = _noise(speeds) if speeds else _noise([r.theta for r in records])
    for window, span in FILTERS:
        difference = np.zeros(2 * span + 1)
        difference[[0, -1]] = np.array([1.0, -1.0]) / (2.0 * span * dt)
        kernel = np.convolve(difference, savgol_coeffs(window, 2))
        if not speeds:
            kernel = np.convolve(kernel, savgol_coeffs(window, 3, deriv=1, delta=dt))
        if sigma * np.sqrt(np.sum(kernel**2)) <= QUIET:
            return window, span
    return FILTERS[-1]


def _noise(series: Sequence[Array]) -> float:
    """Standard deviation of what a cubic cannot follow over five samples; corners of the torque are left out."""
    fourth = np.concatenate([np.diff(x, 4) for x in series])
    return float(1.4826 * np.median(np.abs(fourth)) / np.sqrt(70.0))


def _padded(x: Array, window: int) -> Array:
    half = window // 2
    return np.pad(x, half, mode="reflect", reflect_type="odd")


def find(records: Sequence[Record]) -> Finding:
    """Name the effects that regression finds in the records."""
    log = _Log(records, *_choose_filter(records))
    chosen: list[_Term] = []
    best = _bic(log, chosen)
    ranking: tuple[tuple[str, float], ...] = ()
    while len(chosen) < MOST:
        offers = _best_each(log, chosen)
        gains = sorted(((best - bic, name) for name, (bic, _) in offers.items()), reverse=True)
        if not ranking:
            ranking = tuple((name, gain) for gain, name in gains)
        if not gains or gains[0][0] <= 0.0:
            break
        best, term = offers[gains[0][1]]
        chosen = [*chosen, term]
        for old in chosen[:-1]:
            without = [c for c in chosen if c is not old]
            if _bic(log, without) < best:
                chosen, best = without, _bic(log, without)
    return Finding(tuple(c.name for c in chosen if c.name != "stamp"), ranking)


def _best_each(log: _Log, chosen: list[_Term]) -> dict[str, tuple[float, _Term]]:
    """For every effect not yet chosen, the best of its scan."""
    best: dict[str, tuple[float, _Term]] = {}
    taken = {c.name for c in chosen}
    for term in _terms(log, chosen):
        if term.name in taken:
            continue
        bic = _bic(log, [*chosen, term])
        if term.name not in best or bic < best[term.name][0]:
            best[term.name] = (bic, term)
    return best


def _bic(log: _Log, chosen: Sequence[_Term]) -> float:
    """n log(RSS / n) + k log n, with the number of rows that the smoother leaves independent."""
    A, k = _design(log, chosen)
    y = log.acceleration
    coefficients = np.linalg.lstsq(A, y, rcond=None)[0]
    rss = float(np.sum((y - A @ coefficients) ** 2))
    n = len(y) / (2.0 * log.span)
    return n * np.log(rss / len(y)) + k * np.log(n)


def _path(chosen: Sequence[_Term]) -> _Torque:
    """The torque path of the last chosen term that has one: it was built on those before it."""
    paths = [c.torque for c in chosen if c.torque is not None]
    return paths[-1] if paths else _Torque()


def _design(log: _Log, chosen: Sequence[_Term]) -> tuple[Array, int]:
    columns = [log.torque(_path(chosen)), log.sine]
    columns += [x for c in chosen for x in c.columns]
    return np.stack(columns, axis=1), len(columns) + sum(c.scanned for c in chosen)


def _terms(log: _Log, chosen: Sequence[_Term]) -> Iterator[_Term]:
    """Every effect that a regression can hold, at every value of its scan."""
    yield from log.terms
    yield _Term("load_friction", (np.abs(_transmitted(log, chosen)) * log.way,))
    path, dt = _path(chosen), log.dt
    for rows in (*np.arange(-1.0, 0.0, 0.125), *np.arange(0.125, 5.0, 0.125)):
        yield _Term("delay" if rows > 1.0 else "stamp", (), 1, replace(path, shift=rows * dt))
    largest = max(float(np.max(np.abs(r.u))) for r in log.records)
    for T in (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.06, 0.08, 0.12):
        yield _Term("lag", (), 1, replace(path, lag=T))
    for share in np.arange(0.3, 1.0, 0.05):
        yield _Term("saturation", (), 1, replace(path, clip=share * largest))
    for share in (0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.12, 0.16, 0.2):
        yield _Term("dead_zone", (), 1, replace(path, dead=share * largest))


def _transmitted(log: _Log, chosen: Sequence[_Term]) -> Array:
    """The drive's torque less gravity as the regression so far sees them."""
    A, _ = _design(log, chosen)
    coefficients = np.linalg.lstsq(A, log.acceleration, rcond=None)[0]
    transmitted: Array = A[:, :2] @ (coefficients[:2] * (1.0, -1.0))
    return transmitted


def _fixed_terms(log: _Log) -> Iterator[_Term]:
    """The terms that do not depend on what has been chosen."""
    mean, v_0 = log.mean, log.threshold
    plus, minus = mean(lambda a, v, t: np.maximum(v, 0.0)), mean(lambda a, v, t: np.minimum(v, 0.0))
    yield _Term("viscous", (plus + minus,))
    yield _Term("asymmetric_viscous", (plus, minus))
    yield _Term("coulomb", (log.way,))
    forward = mean(lambda a, v, t: np.clip(v / v_0, 0.0, 1.0))
    yield _Term("asymmetric_coulomb", (forward, log.way - forward))
    for v_s in SPEEDS:
        fading = mean(lambda a, v, t, v_s=v_s: np.clip(v / v_0, -1.0, 1.0) * np.exp(-((v / v_s) ** 2)))
        yield _Term("stribeck", (log.way, fading), 1)
    yield _Term("drag", (mean(lambda a, v, t: np.abs(v) * v),))
    yield _Term("torque_bias", (np.ones_like(log.sine),))
    yield _Term("tilt", (mean(lambda a, v, t: np.cos(a)),))
    yield _Term("spring", (mean(lambda a, v, t: a - np.pi),))
    yield _Term("drift", (mean(lambda a, v, t: t),))
    for order in ORDERS:
        waves = (mean(lambda a, v, t, f=f, k=order: f(k * a)) for f in (np.sin, np.cos))
        yield _Term("ripple", tuple(waves), 1)
    for hertz in FREQUENCIES:
        waves = (mean(lambda a, v, t, f=f, w=2.0 * np.pi * hertz: f(w * t)) for f in (np.sin, np.cos))
        yield _Term("periodic", tuple(waves), 1)
