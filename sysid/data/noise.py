"""Noise: how well the sensors measure, found from the records alone, without any model of the machine."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.data.computed_columns import COMPUTED, follows_readings, is_difference, unexplained
from sysid.data.digitisation import quantisation_step
from sysid.data.jitter import stamp_jitter
from sysid.data.record import Record, as_read, tuple_of_records
from sysid.data.sensor import UNITS, Sensor
from sysid.errors import InvalidInput
from sysid.physics.ops import Array
from sysid.physics.plants import Plant

ORDERS = (3, 4, 5, 6, 7, 8, 10, 12)
WIDTHS = (5, 7, 11, 15, 21, 31, 41, 61)
FEWEST_RESIDUALS = 40
"""Residuals that a standard deviation is computed from, at least."""
MOST_SAMPLES = 10_000
"""Samples that are used, at most: they give a sd to 1 %, and more would only take longer."""
LATEST = 0.3
"""The effect of a torque on the readings is taken out for so many seconds after it (at most 25 samples)."""
EVENT = 3.3
"""A residual beyond this many standard deviations is an event (a kink, an impact), not noise."""
KEPT = 0.9943
"""Standard deviation of a Gaussian of sd 1 that is truncated at +-EVENT."""
ERRORS = 6
"""An order of difference so high that next to nothing of the motion is left, and what remains are errors."""


class _ChannelNoise(NamedTuple):
    """The noise of one channel: the sd of its errors, the relative standard error of that, the sd of its stamps [s],
    whether errors were seen at all, the quantisation step (0: negligible), and notes on what is unusual."""

    sd: float
    error: float
    jitter: float
    seen: bool
    step: float
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Noise:
    """The noise of the sensors, as `sensor_noise` finds it.

    Attributes
    ----------
    sensor : Sensor
        The sd of each channel; None for a speed that was computed from the angle.
    error : dict of str to float
        The relative standard error of each sd, by channel.
    quantisation_step : dict of str to float
        The quantisation step of each channel whose rounding matters.
    notes : tuple of str
        What is unusual about the channels, one sentence each.
    """

    sensor: Sensor
    error: dict[str, float]
    quantisation_step: dict[str, float]
    notes: tuple[str, ...]

    def sentence(self, plant: Plant | None = None) -> str:
        """The sd of each channel with its standard error, in the units of `plant` (default: one that turns); then
        notes."""
        units = UNITS if plant is None else {channel: plant.unit(unit) for channel, unit in UNITS.items()}
        parts = [f"{c} {getattr(self.sensor, c):.3g} {units[c]} (known to {self.error[c]:.0%})" for c in self.error]
        return "; ".join(("sensor noise: " + ", ".join(parts), *self.notes))

    def __str__(self) -> str:
        return self.sentence()


NEGLIGIBLE_NOISE = 1e-4
"""Noise below this share of a channel's spread is taken to be this share: no model is more accurate than that."""
MOTION = 100.0
"""Residuals from windows that are this many times those from sample to sample are motion and no correlated errors."""
MOST_OF_SPREAD = 0.5
"""Residuals from windows that are this share of the channel's spread are motion, too."""


def sensor_noise(records: Sequence[Record]) -> Noise:
    """The standard deviation of the error of each channel's readings, found without any model of the machine.

    Motion is smooth, noise is not. The m-th difference D^m y of the readings leaves little of the motion and, of white
    noise, var(D^m y) = C(2m, m) sigma^2; m is high enough when higher orders give the same sigma. A torque that steps
    from sample to sample changes the speed too: D^m y is first regressed on the same differences of the held torque, up
    to 0.3 s later, through a piecewise linear map (dead zone, saturation). Residuals touched by kinks (stick-slip,
    backlash, impacts) are left out. Readings rounded to steps of q have a sd of at least q / sqrt(12).

    A filter, or a difference of angles, correlates neighbouring errors. The residuals of windows of 5 to 61 readings
    about their own cubics show that, and how large the errors then are in all. Errors of the angle that grow with the
    speed come from the stamps (`sysid.data.jitter`). A speed that was computed from the angle tells nothing new, and a
    torque that was computed from readings carries their noise: neither is used (`sysid.data.computed_columns`).

    Parameters
    ----------
    records : sequence of Record
        At least one rollout; of one that was thinned, all of its readings are used.

    Returns
    -------
    Noise
        The sensor, how well each sd is known, the quantisation steps, and notes.

    Raises
    ------
    InvalidInput
        Where a channel never changes or the records are too short.

    Notes
    -----
    The differences are von Neumann's (Ann. Math. Statist. 12 (1941) 153), the cubics Savitzky and Golay's (Anal. Chem.
    36 (1964) 1627).
    """
    records, channels = as_read(tuple_of_records(records)), dict[str, _ChannelNoise]()
    if follows_readings(records):  # such a torque would explain the noise that it was computed from
        records = [replace(r, u=np.zeros(len(r))) for r in records]
    for channel in ("theta", "theta_dot"):
        series = [(getattr(r, channel), r.u) for r in records]
        if any(y is None or len(y) == 1 for y, _ in series):
            continue
        if all(np.all(y == y[0]) for y, _ in series):
            raise InvalidInput(f"{channel} never changes (it stays at {series[0][0][0]:g}): it measures nothing")
        channels[channel] = _channel(channel, list(_blocks(series)), records[0].dt)
    if not channels:
        raise InvalidInput("no channel is in all of the records: expected theta, theta_dot or both in each")
    reason = _computed(records, channels["theta"].seen) if len(channels) == 2 else ""
    said = []
    if reason:
        del channels["theta_dot"]
        said.append(f"theta_dot was computed from the readings of theta ({reason}): the angle alone is used")
    return Noise(
        Sensor(
            **{channel: noise.sd for channel, noise in channels.items()},
            jitter=max(noise.jitter for noise in channels.values()),
        ),
        {channel: noise.error for channel, noise in channels.items()},
        {channel: noise.step for channel, noise in channels.items() if noise.step},
        (*(note for noise in channels.values() for note in noise.notes), *said),
    )


def _computed(records: Sequence[Record], seen: bool) -> str:
    """The reason to think that the speed was computed from the angle's readings, empty if there is none. The errors of
    both are compared only if those of the angle were `seen`."""
    if is_difference(records):
        return "it is a difference of them to the last digit"
    if not seen:
        return ""
    lags = _lags([len(r) for r in records], records[0].dt)
    rests = []
    for channel, power in (("theta", 2), ("theta_dot", 1)):
        series = list(_blocks([(getattr(r, channel), r.u) for r in records]))
        targets, regressors, edges = _filtered(series, _difference(ERRORS), power, lags)
        rests.append(_fitted(targets, regressors[:, : len(targets) // 8], np.ones(len(targets), dtype=bool))[0])
    share = unexplained(rests[0], rests[1], edges)
    return f"{1.0 - share:.0%} of its error comes from theirs" if share < COMPUTED else ""


def _lags(lengths: Sequence[int], dt: float) -> int:
    """For how many samples after a torque its effect is taken out, in records of these lengths."""
    return min(round(LATEST / dt), 25, int(np.median(lengths)) // 4)


def _blocks(series: Sequence[tuple[Array, Array]]) -> Iterator[tuple[Array, Array]]:
    """Readings y (N+1,) and torque u (N,) of each record; of long logs, stretches that are spread evenly."""
    total = sum(len(u) for _, u in series)
    if total <= MOST_SAMPLES:
        yield from ((y[: len(u) + 1], u[: len(y)]) for y, u in series)
        return
    stretches = [(y[k : k + 1001], u[k : k + 1000]) for y, u in series for k in range(0, max(len(u) - 999, 1), 1000)]
    every = max(math.ceil(len(stretches) * 1000 / MOST_SAMPLES), 1)
    yield from ((y[: len(u) + 1], u[: len(y)]) for y, u in stretches[::every])


def _channel(channel: str, series: Sequence[tuple[Array, Array]], dt: float) -> _ChannelNoise:
    power, notes = 2 if channel == "theta" else 1, list[str]()
    spread = math.sqrt(float(np.mean(np.concatenate([(y - y.mean()) ** 2 for y, _ in series]))))
    step = quantisation_step([y for y, _ in series])
    floor = max(step / math.sqrt(12.0), NEGLIGIBLE_NOISE * spread)
    lags = _lags([len(u) for _, u in series], dt)

    def spread_after(kernel: Array) -> tuple[float, int]:
        return _scale(series, kernel, power, lags, floor)

    sd, n, settled = _by_differences(spread_after)
    if math.isnan(sd):
        raise InvalidInput(
            f"{sum(len(y) for y, _ in series)} readings of {channel} are too few to find its noise: give its sd"
        )
    error, jitter = 1.3 / math.sqrt(2.0 * n), 0.0
    in_all = _by_windows(spread_after)
    correlated = abs(in_all - sd) > 0.1 * sd and 0.0 < in_all < min(MOTION * sd, MOST_OF_SPREAD * spread)
    if channel == "theta" and not (correlated and in_all > sd):
        jitter, beside = stamp_jitter([y for y, _ in series], dt, floor)
    if jitter:
        sd = min(sd, beside)
        notes.append(f"the stamps jitter by {1e3 * jitter:.2g} ms: a moving joint was read that much earlier or later")
    elif correlated:
        notes.append(
            f"neighbouring errors of {channel} are correlated (sd {sd:.2g} from sample to sample, {in_all:.2g} in "
            "all): it was filtered, or made from differences, before it was logged"
        )
        sd = in_all
    elif not settled and sd > floor:
        notes.append(f"the noise of {channel} can hardly be told from its motion: it is sampled coarsely")
    if step == 0.0 and sd < floor:
        notes.append(f"{channel} shows no noise: a sd of {floor:.2g} is taken")
    rounded = step if step > 0.3 * max(sd, floor) else 0.0
    if rounded:
        notes.append(f"{channel} is rounded to steps of {step:.4g}")
    return _ChannelNoise(max(sd, floor), error, jitter, settled and (step > 0.0 or sd > floor), rounded, tuple(notes))


# ---- linear filters that leave the noise and take out the motion -----------------------------------------------------


def _difference(order: int) -> Array:
    """The kernel of the m-th difference."""
    return np.array([(-1.0) ** k * math.comb(order, k) for k in range(order + 1)])


def _beside_cubic(width: int) -> Array:
    """The kernel for a window's middle reading less the cubic that is fitted to the window (Savitzky-Golay)."""
    tau = np.arange(width) - width // 2
    powers = tau[:, None] ** np.arange(4.0)
    kernel = -np.linalg.pinv(powers)[0]
    kernel[width // 2] += 1.0
    return kernel


def _by_differences(spread_after: Callable[[Array], tuple[float, int]]) -> tuple[float, int, bool]:
    """(sd, number of residuals, whether it settled) at the lowest order of difference that the next two confirm."""
    estimates: list[tuple[float, int]] = []
    for order in ORDERS:
        sd, n = spread_after(_difference(order))
        if math.isnan(sd):
            break
        estimates.append((sd, n))
        if len(estimates) >= 3:
            tolerance = 0.01 + 0.6 / math.sqrt(n)
            (first, n), (second, _), (third, _) = estimates[-3:]
            if first <= (1.0 + tolerance) * min(second, third):
                return first, n, True
    if not estimates:
        return math.nan, 0, False
    sd, n = min(estimates)
    return sd, n, len(estimates) < 3


def _by_windows(spread_after: Callable[[Array], tuple[float, int]]) -> float:
    """The sd of correlated errors; 0 where nothing shows that they are correlated.

    White noise leaves the same sd s(w) about cubics in windows of every width w. What is left of the motion grows ever
    faster with w (in the end as w^4; kinks as w^1.5). If s falls at first, or rises at once and then ever more slowly,
    neighbouring errors are correlated, and their sd is s at the width at which it changes least.
    """
    spreads = np.array([(width, *spread_after(_beside_cubic(width))) for width in WIDTHS])
    spreads = spreads[spreads[:, 2] > 0]  # at a width that is too wide for the motion, no residuals are left
    if len(spreads) < 4:
        return 0.0
    widths, s, residuals = spreads.T
    growth = np.diff(np.log(s)) / np.diff(np.log(widths))
    unsure = 1.0 / math.sqrt(residuals[0])
    falls = min(s[1:4]) < s[0] * (0.98 - unsure)
    rises = s[1] > s[0] * (1.04 + unsure) and growth[0] < 1.5 and max(growth[1:3]) < max(0.6, growth[0])
    if not (falls or rises):
        return 0.0
    return float(s[3 + int(np.argmin(np.abs(growth[2:])))])


def _scale(
    series: Sequence[tuple[Array, Array]], kernel: Array, power: int, lags: int, floor: float
) -> tuple[float, int]:
    """The sd of white noise that the filter `kernel` turns into such residuals, and their number; (nan, 0) for too few.

    Residuals beyond 3.3 sd (kinks) are left out, and so are all whose kernel overlaps with theirs.
    """
    targets, regressors, edges = _filtered(series, kernel, power, lags)
    n = len(targets)
    if n < FEWEST_RESIDUALS:
        return math.nan, 0
    regressors = regressors[:, : n // 8]
    gain = float(np.linalg.norm(kernel))
    keep = np.ones(n, dtype=bool)
    residual, used = _fitted(targets, regressors, keep)
    sd = max(float(np.median(np.abs(residual))) / 0.6745 / gain, floor)
    for _ in range(10):
        events = _widened(np.abs(residual) > EVENT * sd * gain, len(kernel) // 2, edges)
        if n - events.sum() < max(FEWEST_RESIDUALS, 0.25 * n):
            break
        same = np.array_equal(~events, keep)
        keep = ~events
        if same:
            break
        residual, used = _fitted(targets, regressors, keep)
        sd = max(float(np.sqrt(np.sum(residual[keep] ** 2) / max(keep.sum() - used, 1))) / gain / KEPT, floor)
    left = int(keep.sum()) - used
    sd = float(np.sqrt(np.sum(residual[keep] ** 2) / max(left, 1))) / gain
    return (sd / KEPT if not keep.all() else sd, left) if left >= FEWEST_RESIDUALS else (math.nan, 0)


def _filtered(
    series: Sequence[tuple[Array, Array]], kernel: Array, power: int, lags: int
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Filtered readings (n,), regressors (n, m) for what the torque did to them, and where each record ends.

    A torque changes the speed by its running sum, and the angle by the running sum of that.
    """
    torque = np.concatenate([u for _, u in series])
    knots = np.quantile(torque, [0.25, 0.5, 0.75]) if len(np.unique(torque)) > 8 else np.empty(0)
    still = bool(np.all(torque == torque[0]))
    targets, regressors = [], []
    for y, u in series:
        if len(u) <= len(kernel) + lags + 4:
            continue
        filtered = np.convolve(y, kernel, "valid")
        if still:
            targets.append(filtered)
            regressors.append(np.empty((len(filtered), 0)))
            continue
        rows = slice(lags, len(filtered) - 2)
        columns = []
        for part in (u, *(np.maximum(u - knot, 0.0) for knot in knots)):
            moved = np.concatenate(([0.0], np.cumsum(part - part.mean())))
            moved = np.convolve(moved if power == 1 else np.cumsum(moved) - 0.5 * moved, kernel, "valid")
            columns += [moved[lags - lag : len(moved) - 2 - lag] for lag in range(-2, lags + 1)]
        targets.append(filtered[rows])
        regressors.append(np.column_stack(columns))
    if not targets:
        return np.empty(0), np.empty((0, 0)), np.empty(0, dtype=np.intp)
    return np.concatenate(targets), np.concatenate(regressors), np.cumsum([len(t) for t in targets])


def _fitted(targets: Array, regressors: Array, keep: NDArray[np.bool_]) -> tuple[Array, int]:
    """Residuals (n,) of a least-squares fit to the rows that are kept, and the degrees of freedom that it used up."""
    if regressors.shape[1] == 0:
        return targets, 0
    A = regressors[keep]
    size, direction = np.linalg.eigh(A.T @ A)
    good = size > 1e-10 * max(float(size[-1]), 1e-300)
    projected = direction[:, good].T @ (A.T @ targets[keep])
    fit = direction[:, good] @ (projected / size[good])
    return targets - regressors @ fit, int(good.sum())


def _widened(events: NDArray[np.bool_], by: int, edges: NDArray[np.intp]) -> NDArray[np.bool_]:
    """The events and `by` neighbours on both sides of each, within a record."""
    wide = events.copy()
    for first, last in pairwise((0, *edges)):
        for k in np.flatnonzero(events[first:last]):
            wide[max(first + k - by, first) : min(first + k + by + 1, last)] = True
    return wide
