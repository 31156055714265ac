"""Held-out error: how far a model is from readings of rollouts it never saw, in units of the sensor noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.json_file import plain_fields
from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.estimation.linearisation import Samples
from sysid.estimation.output_error import ALL, CHANNELS, Among, Linearisation, Response
from sysid.estimation.windows import Window, cut
from sysid.physics.model import Model
from sysid.physics.ops import Array

LEAD = 1.0
"""Unscored seconds before each window of a model whose sensors have a memory, or whose effects have states."""
HEAD = 1.0
"""Length [s] of the head of a long window to which its state is refitted first."""
REFITS = 16
"""Most linearisations while the windows' states are refitted; a good model takes three."""
NEGLIGIBLE_DECREASE = 1e-3
"""A window's refit ends when a step lowers its cost, half the sum of squares, by less than this times the larger of 1
and a tenth of the cost."""


@dataclass(frozen=True)
class WindowError:
    """The error of one window, from `begin` to `end` [s] of a record, as a multiple `ratio` of the sensor noise."""

    record: str
    begin: float
    end: float
    ratio: float


@dataclass(frozen=True, eq=False)
class HeldOutError:
    """RMS of readings less model over windows of `window` [s], after the initial state of each window is refitted.

        ratios[c] = sqrt(sum e_c^2 / sum (1 - h_c)),   e whitened, h the leverage of the refitted state

    The sums go over the readings of channel c, those of `ratio` over all readings. A perfect model gets 1.0 in
    expectation at any sample rate. theta [rad] and theta_dot [rad/s] are the RMS in the plant's `units` (None: not
    measured). `windows` are in the log's order.
    """

    window: float
    theta: float | None
    theta_dot: float | None
    ratios: dict[str, float]
    ratio: float
    n_readings: int
    windows: tuple[WindowError, ...]
    units: Mapping[str, str]

    @property
    def n_windows(self) -> int:
        """The number of windows."""
        return len(self.windows)

    @property
    def worst(self) -> tuple[WindowError, ...]:
        """The three windows with the largest errors."""
        return tuple(sorted(self.windows, key=lambda w: -w.ratio)[:3])

    @property
    def beyond_noise(self) -> bool:
        """Whether the error exceeds the noise by 5 %, and by more than it does for 99 of 100 perfect models."""
        degrees = max(1, self.n_readings - 2 * self.n_windows)
        return not self.ratio**2 < 1.0 + max(2.33 * math.sqrt(2.0 / degrees), 1.05**2 - 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON; a number that is not finite becomes None."""
        return plain_fields(self, "window", "theta", "theta_dot", "ratios", "ratio", "n_readings", "n_windows", "worst")

    def __str__(self) -> str:
        values = {"theta": self.theta, "theta_dot": self.theta_dot}
        parts = [f"{c} {values[c]:.3g} {self.units[c]} ({r:.2f} x noise)" for c, r in self.ratios.items()]
        span = "whole rollouts" if math.isinf(self.window) else f"{self.n_windows} windows of {self.window:g} s"
        return f"{self.ratio:.2f} x the sensor noise over {span}: {', '.join(parts)}"


@dataclass(frozen=True, eq=False)
class Refit:
    """A model on a log, after the initial states of all K windows are refitted.

    starts (K, 2) are the refitted states and lin the linearisation there. basis (K, R, 2) is an orthonormal basis of
    how a window's start can change its readings, 0 where it shows in none; leverage (K, R) = sum basis^2.
    """

    response: Response
    starts: Array
    lin: Linearisation
    basis: Array
    leverage: Array

    @property
    def scored(self) -> Array:
        """(K, R): 1 for each reading that is scored, else 0."""
        return (self.response.weight > 0.0).astype(float).reshape(self.lin.e.shape)


def held_out_error(
    model: Model, records: Sequence[Record], sensor: Sensor, window: float = 1.0, near: Refit | None = None
) -> HeldOutError:
    """The error of a model, as it is, on records over windows of `window` [s].

    The refit of the states begins at those of `near`, if windows of 1 s have been refitted before.
    Raises InvalidInput for records that do not fit the model or lack a channel that the sensor measures.
    """
    samples = Samples(model, records, sensor)
    return error_of(refit_windows(model, samples, cut(samples.records, window, lead_of(model)), near), window)


def refit_windows(
    model: Model | Sequence[Model], samples: Samples, windows: Sequence[Window], near: Refit | None = None
) -> Refit:
    """Refit the initial states of windows, with one model for all or with one for each (`Response`).

    - A long window is refitted through heads of growing length, since a long motion depends sharply on its start.
    - Short windows begin at the states of windows of 1 s if the angle is not read, since a short one does not tell it.
    - So do windows with a lead: the windows of 1 s are scored from their first instant on.
    """
    length = round(HEAD / samples.dt)
    longest = max(w.count - w.lead for w in windows)
    angles = samples.sensor.theta is not None and all(r.has_angles for r in samples.records)
    blind = 2 * longest <= length and not angles
    if near is None and (blind or any(w.lead for w in windows)):
        one = model if isinstance(model, Model) else model[0]
        near = refit(Response(one, samples, cut(samples.records, HEAD)))
    starts = None if near is None else _states_at(near, windows)
    if near is not None:
        length *= 2
    while 2 * length < longest:
        heads = [replace(w, count=min(w.count, w.lead + length)) for w in windows]
        starts = refit(Response(model, samples, heads), starts, REFITS // 4).starts
        length *= 2
    return refit(Response(model, samples, windows), starts)


def _states_at(fit: Refit, windows: Sequence[Window]) -> Array:
    """The states (K, 2) of refitted windows at the first instants of others."""
    begins = np.array([(w.record, w.begin) for w in fit.response.windows])
    states = []
    for w in windows:
        i = int(np.flatnonzero((begins[:, 0] == w.record) & (begins[:, 1] <= w.begin))[-1])
        states.append(fit.lin.states[i, w.begin - begins[i, 1]])
    return np.array(states)


def lead_of(model: Model) -> float:
    """Seconds before a window in which memories of sensors and states of dynamic effects settle; memories of the input
    fill over the whole record and need none."""
    remembers = any(e.rest(0.0, 0.0, model.dt) for e in model.output_effects)
    return LEAD if remembers or model.dynamic_effects else 0.0


def refit(response: Response, starts: Array | None = None, most: int = REFITS) -> Refit:
    """Refit the initial states of all windows, by Levenberg-Marquardt in each; parameters of the model stay."""
    x = response.starts if starts is None else starts
    at = _linearised(response, x)
    cost, damping, stalled = _cost(at), np.zeros(len(x)), np.zeros(len(x), dtype=bool)
    for _ in range(most):
        step, promised = _steps(at, damping, response.samples.reach)
        least = NEGLIGIBLE_DECREASE * np.maximum(1.0, 0.1 * cost)
        open_ = (promised > least) & ~stalled & (damping < 1e3)
        active = np.flatnonzero(open_)
        if not len(active):
            break
        trial = _linearised(response, (x + step)[active], active)
        after = np.full(len(x), np.inf)
        after[active] = _cost(trial)
        better = after < cost
        stalled |= better & (after + least > cost)
        damping = np.where(better, 0.1 * damping, np.where(open_, np.maximum(4.0 * damping, 1.0), damping))
        x = np.where(better[:, None], x + step, x)
        _replace(at, trial, active[better[active]], better[active])
        cost = np.where(better, after, cost)
    basis = _triangle(at.S_x * response.samples.reach)[0]
    return Refit(response, x, at, basis, np.sum(basis**2, axis=-1))


def error_of(fit: Refit, window: float) -> HeldOutError:
    """The error of refitted windows, corrected for leverage."""
    response, K = fit.response, len(fit.starts)
    squares = (fit.lin.e**2).reshape(K, 2, -1)
    free = (fit.scored - fit.leverage).reshape(K, 2, -1)
    weight = response.weight.reshape(squares.shape)
    raw = np.divide(squares, weight**2, out=np.zeros_like(squares), where=weight > 0.0)
    read = [(k, c) for k, c in enumerate(CHANNELS) if getattr(response.samples.sensor, c) is not None]
    ratios, rms = ({c: _root(of[:, k], free[:, k]) for k, c in read} for of in (squares, raw))
    return HeldOutError(
        window=window,
        theta=rms.get("theta"),
        theta_dot=rms.get("theta_dot"),
        ratios=ratios,
        ratio=_root(squares, free),
        n_readings=int(fit.scored.sum()),
        windows=tuple(
            _named(response, w, _root(s, f)) for w, s, f in zip(response.windows, squares, free, strict=True)
        ),
        units=response.model.plant.quantities,
    )


def _named(response: Response, window: Window, ratio: float) -> WindowError:
    record = response.samples.records[window.record]
    begin, end = window.begin + window.lead, window.begin + window.count
    return WindowError(record.name, float(record.t[begin]), float(record.t[end]), ratio)


def _root(squares: Array, free: Array) -> float:
    """sqrt(sum e^2 / sum (1 - h)); nan if the refitted states leave nothing to judge."""
    rest = float(np.sum(free))
    return math.sqrt(float(np.sum(squares)) / rest) if rest > 1e-6 * free.size else math.nan


def _linearised(response: Response, starts: Array, among: Among = ALL) -> Linearisation:
    """The linearisation; windows in which the model runs away get an infinite error and no slope."""
    with np.errstate(over="ignore", invalid="ignore"):
        lin = response.linearise(starts, among)
    bad = ~(np.all(np.isfinite(lin.e), axis=1) & np.all(np.isfinite(lin.S_x), axis=(1, 2)))
    if np.any(bad):
        lin.e[bad], lin.S_x[bad] = np.inf, 0.0
    return lin


def _cost(at: Linearisation) -> Array:
    """Half the sum of squares of each window (K,)."""
    return 0.5 * np.sum(at.e**2, axis=1)


def _steps(at: Linearisation, damping: Array, reach: float) -> tuple[Array, Array]:
    """Damped steps (K, 2) of the starts, at most 0.5 and 3 times the reach; decreases (K,) of the cost if undamped."""
    basis, R = _triangle(at.S_x * reach)
    e = np.where(np.isfinite(at.e), at.e, 0.0)
    along = np.einsum("krs,kr->ks", basis, e)
    theta = along[:, 1] / R[:, 1, 1]
    theta_dot = (along[:, 0] - R[:, 0, 1] * theta) / R[:, 0, 0]
    step = np.stack([theta, theta_dot], axis=-1) / (1.0 + damping[:, None])
    return reach * np.clip(step, [-0.5, -3.0], [0.5, 3.0]), 0.5 * np.sum(along**2, axis=1)


def _triangle(S_x: Array) -> tuple[Array, Array]:
    """The QR decomposition of S_x, speed first: orthonormal columns (K, R, 2) and the triangle (K, 2, 2).

    S_x is per reach of the log. The column is 0 for a speed that shows nowhere, and for an angle that the readings do
    not tell to half the reach (half a radian) beside the speed: no linearisation extends so far.
    """
    theta, theta_dot = S_x[..., 0], S_x[..., 1]
    speed = np.linalg.norm(theta_dot, axis=1)
    first = theta_dot / np.where(speed > 1e-3, speed, np.inf)[:, None]
    shared, second = np.zeros(len(S_x)), theta
    for _ in range(2):  # the second time takes out what rounding left
        more = np.sum(first * second, axis=1)
        shared, second = shared + more, second - more[:, None] * first
    angle = np.linalg.norm(second, axis=1)
    second = second / np.where(angle > 2.0, angle, np.inf)[:, None]
    R = np.zeros((len(S_x), 2, 2))
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 1] = np.maximum(speed, 1e-3), shared, np.maximum(angle, 2.0)
    return np.stack([first, second], axis=-1), R


def _replace(old: Linearisation, new: Linearisation, at: NDArray[np.intp], better: NDArray[np.bool_]) -> None:
    """Copy the windows of the new linearisation that are `better` to their places `at` in the old one."""
    for name in ("e", "S_x", "states"):
        getattr(old, name)[at] = getattr(new, name)[better]


def multiple(ratio: float) -> str:
    """A multiple of the noise, to three digits at most."""
    if not math.isfinite(ratio):
        return "inf"
    return f"{ratio:.2f}" if ratio < 9.995 else f"{ratio:.3g}" if ratio < 999.5 else f"{ratio:.0f}"
