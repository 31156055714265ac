"""Resampling: turning rows as a logger stamped them into records with one even sample interval."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sysid.data import digitisation
from sysid.data.needed_rate import FREE_SWING_RATE, SAMPLES, fastest_part, needed_rate
from sysid.data.record import Record
from sysid.data.spikes import spikes
from sysid.errors import InvalidInput
from sysid.limits import SHORTEST_INTERVAL
from sysid.physics.ops import Array

GAP = 3.5
"""A step longer than this many typical steps (or sample intervals, if those asked for are longer) is a gap."""
FARTHEST_ROW = 0.75
"""An instant further than this many steps from any row is interpolated between the rows on both sides."""
FEWEST_PIECE_ROWS = 5
"""Pieces between gaps that have fewer rows are left out if others are longer."""
WITNESS = 0.1
"""Share of a rollout's rows that a piece between gaps must have for its own sample rate to count."""
MOST_APART = 10.0
"""Sample rates that differ by more than this factor come from different machines, or different units of time."""
SHORTEST_PREDICTED = 1.0
"""Seconds over which models predict: a log that gaps cut into shorter pieces is hardly of use."""
COARSEST = 5.0
"""Largest sample interval that bridges gaps of a log in bursts whatever it shows, in intervals of its rows."""
BRIDGED = "an interval of {:g} s bridges {} between rows: the motion has nothing faster to show (--dt keeps another)"
IN_BURSTS = "rows come in bursts: a sample interval of {:g} s bridges {} between them"

Resampled: TypeAlias = tuple[tuple[Record, ...], float, tuple[str, ...]]
"""Records, their sample interval [s], and a note on each thing that was done."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of one rollout as they were logged: t (K,) [s]; torque (K,) [N m], held from its row's time to the next;
    theta (K,) [rad], unwrapped, and theta_dot (K,) [rad/s], None if not measured, nan in rows that lack them. If they
    are a later piece of a rollout, it began at origin [s]."""

    name: str
    t: Array
    torque: Array
    theta: Array | None
    theta_dot: Array | None
    origin: float | None = None

    def take(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice, name: str = "") -> Rows:
        """Some of the rows, perhaps under another name."""
        theta, theta_dot = (None if v is None else v[rows] for v in (self.theta, self.theta_dot))
        return Rows(name or self.name, self.t[rows], self.torque[rows], theta, theta_dot, self.origin)

    @property
    def read(self) -> NDArray[np.bool_]:
        """Whether each row has its readings (K,)."""
        read = np.ones(len(self.t), dtype=bool)
        for channel in (self.theta, self.theta_dot):
            if channel is not None:
                read &= np.isfinite(channel)
        return read

    @property
    def step(self) -> float:
        """The typical step [s]: the median of those that are positive."""
        steps = np.diff(self.t)
        steps = steps[steps > 0.0]
        return float(np.median(steps)) if len(steps) else 0.0


def evenly(rollouts: Sequence[Rows], dt: float | None = None, thin: bool = True) -> Resampled:
    """Resample rollouts to one even interval: the records, the interval [s], and a note on each thing that was done.

    First the rows are put right. They are sorted by time, and readings that jump away and back count as missing
    (`sysid.data.spikes`). If readings are held for several rows, only fresh ones are kept (`sysid.data.digitisation`).
    Rounded stamps are made even; of rows with the same stamp the last is kept. A restart of the clock or a gap (a step
    above 3.5 typical ones, and 3.5 intervals of the grid) starts a new rollout.

    The interval is dt if given, else the mean step, of logs at several rates that of the slowest. A longer one bridges
    all gaps, or nine in ten, if a log may be thinned and its motion needs no faster rate, or if rows come in bursts and
    gaps leave hardly a second in one piece.

    Each instant of the grid gets its nearest row, moved there along the channel's local cubic, so that errors stay
    independent; interpolating between two rows would shrink the sensor's noise to as little as 0.7 times and correlate
    it. The torque becomes its mean over each interval, so that no impulse is lost.

    Raises InvalidInput for rates far apart, a dt shorter than theirs, and where nothing is left.
    """
    tally: Counter[str] = Counter()
    ordered, held = _fresh([_without_spikes(part, tally) for rows in rollouts for part in _restarts(rows, tally)])
    cut = [[_stamps(p, tally) for p in _pieces(part, dt or 0.0)] for part in ordered]
    pieces = [p for parts in cut for p in parts]
    least = FEWEST_PIECE_ROWS if any(_lasts(p, dt, FEWEST_PIECE_ROWS) for p in pieces) else 2
    inner = [_without_short_ends(parts, dt, least) for parts in cut]
    gaps = [float(q.t[0] - p.t[-1]) for parts in inner for p, q in pairwise(parts)]
    used = [kept for parts in inner if (kept := [p for p in parts if _lasts(p, dt, least)])]
    long = [p for parts in used for p in parts]
    if not long:
        came = ", ".join(f"{r.name} ({len(r.t)} row{'s' * (len(r.t) != 1)})" for r in rollouts[:3]) or "nothing"
        raise InvalidInput(f"nothing to work on in {came}: expected at least two rows, better some hundred")
    tally["row(s) in pieces too short to use left out"] += sum(len(p.t) for p in pieces) - sum(len(p.t) for p in long)
    common = _interval(long, _rates(used), dt)
    if not common >= SHORTEST_INTERVAL:
        raise InvalidInput(
            f"{long[0].name}: rows are {common:.3g} s apart: expected at least {SHORTEST_INTERVAL:g} s; check time_unit"
        )
    if gaps and not dt:
        bridged = _bridged(rollouts, gaps, common, thin, _in_bursts(long, ordered))
        if bridged or any(gap <= GAP * common for gap in gaps):
            return bridged or evenly(rollouts, common)
    records = tuple(_record(p, common, tally) for p in long)
    return records, common, (*held, *_notes(long, common, tally, gaps))


def _restarts(rows: Rows, tally: Counter[str]) -> Iterable[Rows]:
    """Split rows where the clock restarts; a few rows that are merely out of order are sorted."""
    back = np.flatnonzero(np.diff(rows.t) < 0.0)
    far = back[(rows.t[back] - rows.t[back + 1]) > 10.0 * rows.step]
    if len(far):
        tally["restart(s) of the clock, each a new rollout"] += len(far)
    tally["row(s) out of order sorted"] += len(back) - len(far)
    edges = [0, *(far + 1), len(rows.t)]
    for k, (first, last) in enumerate(pairwise(edges), start=1):
        part = rows.take(slice(first, last), f"{rows.name} run {k}" if len(far) else "")
        yield part.take(np.argsort(part.t, kind="stable"))


def _without_spikes(rows: Rows, tally: Counter[str]) -> Rows:
    """The rows, with nan for readings that jump away and back."""
    theta, theta_dot = (None if y is None else np.where(spikes(y), np.nan, y) for y in (rows.theta, rows.theta_dot))
    without = replace(rows, theta=theta, theta_dot=theta_dot)
    tally["row(s) with readings that jump away and back"] += int(np.sum(rows.read & ~without.read))
    return without


def _fresh(parts: Sequence[Rows]) -> tuple[Sequence[Rows], tuple[str, ...]]:
    """Keep only rows with fresh readings if a sensor is slower than the log; also notes on that.

    The angle decides which rows are fresh. A speed that is held for longer, or read at other times, is left out.
    Torques become their means between fresh rows.
    """
    read = [p.take(p.read) for p in parts]
    held = {}
    for channel in ("theta", "theta_dot"):
        series = [getattr(p, channel) for p in read]
        if all(values is not None for values in series):
            held[channel] = digitisation.holding(series)
    notes, lead = [], next(iter(held), "")
    if len(held) == 2 and held["theta_dot"] > 1.0:
        longer = held["theta_dot"] > 1.5 * held["theta"]
        both = [(p.theta, p.theta_dot) for p in read]
        together = [digitisation.changes_together(x, v) for x, v in both if x is not None and v is not None]
        if longer or not all(together):
            parts = [replace(p, theta_dot=None) for p in parts]
            read = [replace(p, theta_dot=None) for p in read]
            why = "longer than theta" if longer else "and read at other times than theta"
            notes.append(f"theta_dot is held for {held['theta_dot']:.3g} rows each, {why}: it is left out")
    if not held or held[lead] == 1.0:
        return parts, tuple(notes)
    step = float(np.median([p.step for p in read]))
    notes.append(
        f"{lead} is held for {held[lead]:.3g} rows each (read at {1.0 / (held[lead] * step):.4g} Hz, logged at "
        f"{1.0 / step:.4g} Hz): only fresh readings are kept, with the mean torque between them"
    )
    return [_thinned(p, q, getattr(q, lead), held[lead]) for p, q in zip(parts, read, strict=True)], tuple(notes)


def _thinned(rows: Rows, read: Rows, lead: Array, held: float) -> Rows:
    """The rows with a fresh reading of `lead`, with mean torques in between; `read` are the rows that have readings."""
    if len(read.t) < 2:
        return rows
    fresh = digitisation.fresh(lead, held)
    fresh = fresh[np.append(True, np.diff(read.t[fresh]) > 0.0)]
    kept = read.take(fresh)
    return replace(kept, torque=np.append(held_means(rows.t, rows.torque, kept.t), kept.torque[-1]))


def _stamps(rows: Rows, tally: Counter[str]) -> Rows:
    """Make stamps increase: rounded ones are spaced evenly; otherwise rows with a duplicate stamp are dropped."""
    n = len(rows.t)
    resolution = _resolution(rows.t)
    if n >= 10 and resolution > 0.0:
        k = np.arange(n)
        step, start = np.polyfit(k, rows.t - rows.t[0], 1)
        off = float(np.max(np.abs(rows.t - rows.t[0] - start - step * k)))
        if 0.004 * step < off <= 0.6 * resolution:
            tally[f"rollout(s) with stamps rounded to {resolution:g} s taken as even"] += 1
            return replace(rows, t=rows.t[0] + start + step * k)
    same = np.append(np.diff(rows.t) <= 1e-6 * rows.step, False)
    tally["duplicate stamp(s) dropped"] += int(same.sum())
    return rows.take(~same)


def _resolution(t: Array) -> float:
    """The power of ten [s] to which stamps are rounded, counted from the first; 0 if they have more than six decimals.
    Differences that float64 cannot resolve (a quarter of a microsecond in seconds since 1970) count as none."""
    since = t - t[0]
    equal = 1e-9 * max(1.0, float(np.max(np.abs(since)))) + 4.0 * float(np.spacing(np.max(np.abs(t))))
    for decimals in range(7):
        if np.max(np.abs(since - np.round(since, decimals))) <= equal:
            return float(10.0**-decimals)
    return 0.0


def _pieces(rows: Rows, dt: float) -> Iterable[Rows]:
    """Split rows at gaps in the readings; each piece runs from its first reading to its last."""
    read = np.flatnonzero(rows.read)
    cuts = np.flatnonzero(np.diff(rows.t[read]) > GAP * max(rows.step, dt))
    edges = [0, *(cuts + 1), len(read)]
    for k, (first, last) in enumerate(pairwise(edges), start=1):
        if last > first:
            piece = rows.take(slice(read[first], read[last - 1] + 1), f"{rows.name} part {k}" if len(cuts) else "")
            yield replace(piece, origin=float(rows.t[0])) if k > 1 else piece


def _without_short_ends(pieces: Sequence[Rows], dt: float | None, least: int) -> Sequence[Rows]:
    """The pieces of a rollout from the first to the last that can be used: a few rows before or after them need no
    bridge."""
    lasting = [k for k, piece in enumerate(pieces) if _lasts(piece, dt, least)]
    return pieces[lasting[0] : lasting[-1] + 1] if lasting else ()


def _lasts(rows: Rows, dt: float | None, least: int) -> bool:
    """Whether a piece has at least so many rows and lasts for an interval of the grid."""
    return len(rows.t) >= least and bool(rows.t[-1] - rows.t[0] >= (dt or 0.0))


def _rates(rollouts: Sequence[Sequence[Rows]]) -> dict[str, float]:
    """The typical step [s] of each rollout, and of each piece between gaps that is long enough to have a rate of its
    own."""
    typical = {}
    for pieces in rollouts:
        steps = np.concatenate([np.diff(p.t) for p in pieces])
        typical[pieces[0].name] = float(np.median(steps))
        typical |= {p.name: p.step for p in pieces if len(p.t) >= WITNESS * (len(steps) + len(pieces))}
    return typical


def _interval(pieces: Sequence[Rows], rates: Mapping[str, float], dt: float | None) -> float:
    """The sample interval [s] of all records: dt if given, else the mean step (of the usual steps, if most are alike);
    for logs at several rates, that of the slowest."""
    slow, fast = max(rates, key=rates.__getitem__), min(rates, key=rates.__getitem__)
    if dt is not None:
        if not (math.isfinite(dt) and dt > 0.0):
            raise InvalidInput(f"dt = {dt}: expected a positive number of seconds")
        if dt < 0.8 * rates[slow]:
            raise InvalidInput(f"dt = {dt:g} s is finer than {slow}, sampled every {rates[slow]:.4g} s")
        return dt
    if rates[slow] > MOST_APART * rates[fast]:
        raise InvalidInput(
            f"{fast} is sampled at {1 / rates[fast]:.4g} Hz and {slow} at {1 / rates[slow]:.4g} Hz: expected rates "
            f"apart by a factor of {MOST_APART:g} at most, or a common sample interval (dt); check time_unit"
        )
    if rates[slow] > 1.25 * rates[fast]:
        return rates[slow]
    steps = np.concatenate([np.diff(p.t) for p in pieces])
    core = steps[np.abs(steps - np.median(steps)) <= 0.1 * np.median(steps)]
    if len(core) < 0.8 * len(steps):
        core = steps / np.maximum(np.round(steps / np.median(steps)), 1.0)
    mean = float(np.mean(core))
    nice = float(f"{mean:.5g}")
    return nice if abs(mean - nice) < 1e-6 * mean else mean


def _record(rows: Rows, dt: float, tally: Counter[str]) -> Record:
    """A record on an even grid: the rows themselves if they are even, else the nearest row for each instant."""
    n, read = len(rows.t) - 1, rows.take(rows.read)
    step = (rows.t[-1] - rows.t[0]) / n
    even = (
        np.max(np.abs(rows.t - rows.t[0] - step * np.arange(n + 1))) <= 0.004 * dt and abs(step - dt) * n <= 0.02 * dt
    )
    if even and len(read.t) == n + 1:
        return Record(rows.t, rows.torque[:-1], rows.theta, rows.theta_dot, name=rows.name, origin=rows.origin)
    start = rows.t[0] + float(np.median(rows.t - rows.t[0] - dt * np.round((rows.t - rows.t[0]) / dt)))
    grid = start + dt * np.arange(max(int((rows.t[-1] - start) / dt + 0.5), 1) + 1)
    right = np.clip(np.searchsorted(read.t, grid), 1, len(read.t) - 1)
    nearest = np.where(grid - read.t[right - 1] <= read.t[right] - grid, right - 1, right)
    offset = np.abs(grid - read.t[nearest])
    missing = int(np.sum(offset > FARTHEST_ROW * rows.step))
    near = len(grid) == n + 1 and float(np.max(np.abs(grid - rows.t))) <= 0.02 * dt
    torque = rows.torque[:-1] if near else held_means(rows.t, rows.torque, grid)
    theta, theta_dot = (None if y is None else _moved(read.t, y, grid, nearest) for y in (read.theta, read.theta_dot))
    if not even:
        tally["stamps put right" if near else "resampled"] += 1
    tally["missing row(s) filled in"] += missing
    return Record(grid, torque, theta, theta_dot, name=rows.name, origin=rows.origin)


def held_means(t: Array, torque: Array, grid: Array) -> Array:
    """The mean torque (G - 1,) [N m] over each interval of the grid (G,); between rows t (K,) the torque (K,) is held.

    u_k = (U(g_k+1) - U(g_k)) / dt,   U(t) = the integral of the held torque
    """
    impulse = np.concatenate(([0.0], np.cumsum(torque[:-1] * np.diff(t))))
    at = np.interp(grid, t, impulse)
    at += np.minimum(grid - t[0], 0.0) * torque[0] + np.maximum(grid - t[-1], 0.0) * torque[-1]
    return np.diff(at) / np.diff(grid)


def _moved(t: Array, y: Array, grid: Array, nearest: NDArray[np.intp]) -> Array:
    """A channel at the instants g of the grid: the nearest row k, moved along a cubic to the instant.

    y(g) = y_k + s (g - t_k) + c (g - t_k)^2 / 2, with slope s and curvature c of the cubic fitted to rows k-3 .. k+3.
    An instant further than 3/4 of a step from any row is interpolated linearly. A quantised reading moves by whole
    steps, so that it remains one that this sensor can show.
    """
    step = float(np.median(np.diff(t)))
    shift = np.empty(len(grid))
    for first in range(0, len(grid), 65536):
        rows = slice(first, first + 65536)
        slope, curvature = _cubic(t, y, nearest[rows], step)
        delta = (grid[rows] - t[nearest[rows]]) / step
        shift[rows] = slope * delta + 0.5 * curvature * delta**2
    far = np.abs(grid - t[nearest]) > FARTHEST_ROW * step
    shift[far] = np.interp(grid[far], t, y) - y[nearest[far]]
    rounded = digitisation.quantisation_step([y])
    return y[nearest] + (rounded * np.round(shift / rounded) if rounded > 0.0 else shift)


def _cubic(t: Array, y: Array, rows: NDArray[np.intp], step: float) -> tuple[Array, Array]:
    """Slope (per step) and curvature (per step^2), at some rows, of the cubic fitted to the seven rows about each."""
    width = min(7, len(t))
    degree = max(min(3, width - 2), 1)
    window = np.clip(rows - width // 2, 0, len(t) - width)[:, None] + np.arange(width)
    tau = (t[window] - t[rows, None]) / step
    powers = tau[:, :, None] ** np.arange(degree + 1)
    transposed = np.swapaxes(powers, 1, 2)
    fit = np.linalg.solve(transposed @ powers, transposed @ y[window][:, :, None])[:, :, 0]
    return fit[:, 1], 2.0 * fit[:, 2] if degree > 1 else np.zeros(len(rows))


def _notes(pieces: Sequence[Rows], dt: float, tally: Counter[str], gaps: Sequence[float]) -> tuple[str, ...]:
    """What was done, one short sentence each."""
    done = []
    resampled, near = tally.pop("resampled", 0), tally.pop("stamps put right", 0)
    if resampled or near:
        rates = 1.0 / np.concatenate([np.diff(p.t) for p in pieces])
        slow, fast = np.percentile(rates, [1.0, 99.0])
        before, after = "-".join(dict.fromkeys((f"{slow:.4g}", f"{fast:.4g}"))) + " Hz", f"{1 / dt:.4g} Hz"
        if before != after and (resampled or fast - slow > 0.01 * fast):
            done.append(f"{'resampled' if resampled else 'stamps put right'} from {before} to {after}")
    done += [f"{n} {what.replace('(s)', 's' * (n != 1))}" for what, n in tally.items() if n]
    if gaps:
        longest = f"up to {max(gaps):.2g} s" if len(gaps) > 1 else f"{gaps[0]:.2g} s"
        verb = "each start" if len(gaps) > 1 else "starts"
        done.append(f"{len(gaps)} gap{'s' * (len(gaps) > 1)} of {longest} {verb} a new rollout")
    return tuple(done)


def _bridged(
    rollouts: Sequence[Rows], gaps: Sequence[float], common: float, thin: bool, in_bursts: bool
) -> Resampled | None:
    """The records at a longer interval that bridges gaps; None if the motion may need a faster rate."""
    all_gaps, most = max(gaps) / GAP, float(f"{np.percentile(gaps, 90.0) / GAP:.2g}")
    unit = 10.0 ** (math.floor(math.log10(all_gaps)) - 1)
    for dt, which in ((math.ceil(all_gaps / unit) * unit, "all gaps"), (most, "nine in ten of the gaps")):
        if not (dt > common and (in_bursts or dt <= 1.0 / FREE_SWING_RATE)):
            continue
        records, _, notes = evenly(rollouts, dt)
        if (thin and dt * needed_rate(records) <= 1.0) or (in_bursts and dt * SAMPLES * fastest_part(records) <= 1.0):
            return records, dt, (*notes, BRIDGED.format(dt, which))
        if in_bursts and dt == most < COARSEST * common:
            return records, dt, (*notes, IN_BURSTS.format(dt, which))
    return None


def _in_bursts(pieces: Sequence[Rows], rollouts: Sequence[Rows]) -> bool:
    """Whether rows come in bursts, and gaps leave hardly a window to predict over."""

    def predictable(parts: Sequence[Rows]) -> float:
        lengths = [float(p.t[-1] - p.t[0]) for p in parts]
        return sum(length for length in lengths if length >= SHORTEST_PREDICTED) / sum(lengths)

    return predictable(pieces) < 0.5 <= predictable(rollouts)
