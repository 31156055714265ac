"""Record: the log of one rollout, checked when it is made; writing it as CSV."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.data.files import save_csv
from sysid.data.jitter import speed_about
from sysid.errors import InvalidInput
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.parameters import Extent

COLUMNS = ("t", "u", "theta", "theta_dot")
PAST = 10.0
"""Seconds of commands before it that a piece of a rollout keeps: what drives remember is shorter."""


@dataclass(frozen=True, eq=False)
class Record:
    """One rollout of N control intervals, checked when it is made.

    A piece of a longer rollout (`part`, or what follows a gap) also carries what came before it.

    Attributes
    ----------
    t : array (N+1,)
        Instants [s], evenly spaced, increasing.
    u : array (N,)
        The command held from t[k] to t[k+1], a torque [N m] where the model has no actuator.
    theta : array (N+1,), (1,) or None
        Angle readings [rad], 0 upright; jumps of whole turns are taken out (unwrapped); (1,) where only the start angle
        is known.
    theta_dot : array (N+1,) or None
        Speed readings [rad/s].
    name : str
        What answers call it.
    origin : float or None
        The instant [s] from which effects that depend on time count; by default t[0].
    before : array (M,) or None
        The commands of the M intervals before t[0], which drives remember; by default none.

    Raises
    ------
    InvalidInput
        For empty, ragged or non-finite data and for time that does not increase evenly.
    """

    t: Array
    u: Array
    theta: Array | None = None
    theta_dot: Array | None = None
    name: str = "record"
    origin: float | None = None
    before: Array | None = None

    def __post_init__(self) -> None:
        for column in (*COLUMNS, "before"):
            value: ArrayLike | None = getattr(self, column)
            if value is not None:
                object.__setattr__(self, column, self._array(column, value))
            elif column in ("t", "u"):
                raise InvalidInput(f"{self.name} has no {column}: expected t (N+1,) and u (N,)")
        if self.theta is None and self.theta_dot is None:
            raise InvalidInput(f"{self.name} has no readings: expected theta, theta_dot or both")
        if len(self.u) == 0:
            raise InvalidInput(f"{self.name} is empty: expected at least one control interval (two instants)")
        n = len(self.u)
        for column in ("t", "theta", "theta_dot"):
            series = getattr(self, column)
            if column == "theta" and series is not None and len(series) == 1:
                continue
            if series is not None and len(series) != n + 1:
                came = f"{column} has {len(series)} values"
                raise InvalidInput(f"{self.name} is ragged: {came}, expected {n + 1} for {n} commands u")
        self._check_time()
        if not self.time_since_start[0] >= 0.0:
            raise InvalidInput(f"{self.name} begins at {self.t[0]:g} s, before its rollout does ({self.origin} s)")
        if self.theta is not None and self.has_angles:
            unwrapped = without_whole_turns(self.theta)
            unwrapped.setflags(write=False)
            object.__setattr__(self, "theta", unwrapped)

    def _array(self, column: str, value: ArrayLike) -> Array:
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            problem = f"{column} is ragged or not numeric"
            raise InvalidInput(f"{self.name}: {problem}: expected a list of numbers") from None
        if array.ndim != 1:
            raise InvalidInput(f"{self.name}: {column} has shape {array.shape}: expected one dimension")
        bad = np.flatnonzero(~np.isfinite(array))
        if len(bad):
            came = f"{column}[{bad[0]}] is {array[bad[0]]} ({len(bad)} such values)"
            raise InvalidInput(f"{self.name}: {came}: expected finite numbers")
        array.setflags(write=False)
        return array

    def _check_time(self) -> None:
        steps = np.diff(self.t)
        if np.any(steps <= 0.0):
            k = int(np.argmax(steps <= 0.0))
            came = f"{self.t[k]:g} s, then {self.t[k + 1]:g} s"
            raise InvalidInput(f"{self.name}: time does not increase at sample {k + 1} ({came})")
        worst = float(np.max(np.abs(steps - self.dt)))
        if worst > 0.01 * self.dt:
            raise InvalidInput(
                f"{self.name}: time steps differ by up to {worst:.3g} s from their mean {self.dt:.4g} s: "
                "expected even sampling (resample the log first)"
            )

    def __len__(self) -> int:
        """The number of control intervals N."""
        return len(self.u)

    def head(self, n: int) -> Record:
        """The first n control intervals (all of them where there are fewer)."""
        return self if n >= len(self) else self.part(0, n)

    def part(self, first: int, last: int, name: str = "") -> Record:
        """The control intervals first .. last-1 with the instants at both ends, and what came before them."""
        parts: dict[str, Any] = {}
        for column in COLUMNS:
            value = getattr(self, column)
            if value is None:
                continue
            if column == "theta" and len(value) == 1:
                parts[column] = value if first == 0 else None
            else:
                parts[column] = value[first : last + (len(value) > len(self))]
        kept = math.ceil(PAST / self.dt)
        before = self.commands[: len(self.previous_commands) + first][-kept:]
        origin = float(self.t[0]) if self.origin is None else self.origin
        return replace(self, **parts, name=name or self.name, origin=origin, before=before)

    def thinned(self, every: int) -> Record:
        """The readings of every `every`-th instant, under the means of the commands between them; what is left of the
        record's end is dropped."""
        n = len(self) // every
        if every == 1 or n < 1:
            return self

        def instants(series: Array | None) -> Array | None:
            return series if series is None or len(series) == 1 else series[: n * every + 1 : every]

        past = self.previous_commands[len(self.previous_commands) % every :].reshape(-1, every).mean(axis=1)
        return replace(
            self,
            t=self.t[: n * every + 1 : every],
            u=self.u[: n * every].reshape(n, every).mean(axis=1),
            theta=instants(self.theta),
            theta_dot=instants(self.theta_dot),
            before=None if self.before is None else past,
            origin=float(self.t[0]) if self.origin is None else self.origin,
        )

    @property
    def time_since_start(self) -> Array:
        """Seconds since the rollout began (N+1,)."""
        return self.t - (self.t[0] if self.origin is None else self.origin)

    @property
    def previous_commands(self) -> Array:
        """`before`, or no commands (0,)."""
        return np.zeros(0) if self.before is None else self.before

    @cached_property
    def commands(self) -> Array:
        """All that drives remember and are told (M+N,): `past`, then u."""
        return np.concatenate([self.previous_commands, self.u])

    @property
    def has_angles(self) -> bool:
        """Whether the angle was read, and not at the start alone."""
        return self.theta is not None and len(self.theta) > 1

    @property
    def starts_midway(self) -> bool:
        """Whether it begins in the middle of a rollout, after commands that are not known."""
        known = (len(self.previous_commands) + 0.5) * self.dt
        return bool(self.time_since_start[0] > known and known < PAST)

    @property
    def dt(self) -> float:
        """Length of a control interval [s]."""
        return float(self.t[-1] - self.t[0]) / len(self.u)


def without_whole_turns(theta: Array) -> Array:
    """Angles (K,) [rad] without jumps of whole turns; what covers more than a turn was never wrapped."""
    wrapped = len(theta) > 0 and bool(np.ptp(theta) < 2.0 * math.pi + 1e-6)
    return np.unwrap(theta) if wrapped else theta.copy()


def check_records(model: Model, records: Sequence[Record]) -> tuple[Record, ...]:
    """The records as a tuple, once they fit the model: at least one, the model's dt, torque within its limit.

    Raises InvalidInput with the record's name, what came and what was expected.
    """
    given = tuple(records) if isinstance(records, Iterable) else (records,)
    if not given:
        raise InvalidInput("no records were given: expected at least one")
    for record in given:
        if not isinstance(record, Record):
            raise InvalidInput(f"records holds {record!r}: expected Record objects, as read and measure make them")
        if abs(record.dt - model.dt) * len(record) > 0.02 * model.dt:  # within a fiftieth of an interval at its end
            raise InvalidInput(
                f"{record.name} is sampled every {record.dt:.7g} s, the model steps every {model.dt:.7g} s: expected a "
                "model with the log's dt"
            )
        largest = float(np.max(np.abs(record.u)))
        if largest > model.u_max * (1.0 + 1e-9):
            command = "torque" if model.actuator is None else model.actuator.command
            raise InvalidInput(
                f"{record.name} has a {command} of {largest:g} {model.command_unit}, beyond the model's limit "
                f"|u| <= {model.u_max:g} {model.command_unit}"
            )
    return given


def unique_names(records: Sequence[Record]) -> tuple[Record, ...]:
    """The records under names of their own: an answer names stretches of them."""
    names = [r.name for r in records]
    return tuple(replace(r, name=f"{r.name} {i}") if names.count(r.name) > 1 else r for i, r in enumerate(records))


def check_direct(model: Model, method: str) -> None:
    """Raise InvalidInput where sensors show something else than the state, or the log's torques are shifted."""
    between = [e.name for e in model.effects if e.of_log or e in model.output_effects]
    if between:
        came = f"{', '.join(between)} stands between the two"
        raise InvalidInput(
            f"{method} compares readings with the state, but {came}: expected a model without, or sysid.fit"
        )


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record as CSV that `read` brings back exactly, one row an instant; cells without a value stay empty.

    Parameters
    ----------
    record : Record
        What is written.
    path : path
        The file.

    Raises
    ------
    InvalidInput
        For a file that cannot be written, and a record that has the start angle alone.
    """
    if record.theta is not None and not record.has_angles:
        raise InvalidInput(f"{record.name} has the start angle alone: expected the angle of every instant, or of none")
    columns = {c: getattr(record, c) for c in COLUMNS if getattr(record, c) is not None}
    cells = ([repr(value) for value in values.tolist()] for values in columns.values())
    save_csv(path, columns, zip_longest(*cells, fillvalue=""))


def amount_of(records: Sequence[Record]) -> str:
    """How much was recorded: "8 rollouts, 3200 samples (64 s) at 50 Hz"."""
    n, dt, many = sum(len(r) for r in records), records[0].dt, "s" * (len(records) != 1)
    return f"{len(records)} rollout{many}, {n} samples ({n * dt:.4g} s) at {1.0 / dt:.4g} Hz"


def first_samples(records: Sequence[Record], most: int) -> tuple[Record, ...]:
    """The first samples of a log, at most so many."""
    shown = []
    for record in records:
        if most > 0:
            shown.append(record.head(most))
        most -= len(record)
    return tuple(shown)


def is_part(name: str, whole: str) -> bool:
    """Whether a record of that name is the whole one, or one of the parts that are made of it."""
    return name == whole or name.startswith(f"{whole}, ")


def in_a_row(instants: Sequence[Array]) -> Array:
    """Where each rollout begins [s] on one axis of time, with a gap between them of 3 % of the longest."""
    lengths = np.array([t[-1] - t[0] for t in instants])
    taken = lengths + 0.03 * np.max(lengths, initial=0.0)
    begins: Array = np.cumsum(taken) - taken
    return begins


def extent_of(records: Sequence[Record], turns: bool = True) -> Extent:
    """What probes may depend on, of a plant that turns or does not."""
    reach = 1.0 if turns else _half_of_travel(records)
    extent = Extent(
        dt=records[0].dt,
        duration=max(len(r) * r.dt for r in records),
        u_max=max(float(np.max(np.abs(r.u))) for r in records),
        reach=reach,
    )
    speed = _largest_speed(records)
    return extent._replace(speed=speed / reach) if speed > 0.0 else extent


def _largest_speed(records: Sequence[Record]) -> float:
    """The speed that one sample in a hundred exceeds [rad/s], by the angles, or where none were read by the speeds."""
    angles = [np.abs(speed_about(r.theta, r.dt)) for r in records if r.theta is not None and r.has_angles]
    speeds = angles or [np.abs(r.theta_dot) for r in records if r.theta_dot is not None]
    return float(np.nanquantile(np.concatenate(speeds), 0.99)) if speeds else 0.0


def _half_of_travel(records: Sequence[Record]) -> float:
    """Half of how far an axis goes, or as far as its speed goes in a second where no position was read [m]."""
    places = [r.theta for r in records if r.theta is not None and r.has_angles]
    speeds = [r.theta_dot for r in records if r.theta_dot is not None]
    half = 0.5 * float(np.ptp(np.concatenate(places))) if places else float(np.std(np.concatenate(speeds)))
    return half or 1.0
