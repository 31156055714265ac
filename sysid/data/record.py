"""Records: the log of one rollout, which is checked when it is made, and what is computed from several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.data.files import save_csv
from sysid.data.jitter import speed_about
from sysid.errors import InvalidInput, check_kind, described, is_real, items_of
from sysid.limits import LONGEST_INTERVAL, check_size
from sysid.physics.model import Model, check_model
from sysid.physics.ops import Array
from sysid.physics.parameters import Extent

COLUMNS = ("t", "u", "theta", "theta_dot")
PREVIOUS_SECONDS = 10.0
"""Seconds of earlier commands that a piece of a rollout keeps; the memory of drives (delay, lag) is shorter."""


@dataclass(frozen=True, eq=False)
class Record:
    """One rollout of N control intervals, checked when it is made.

    A piece that `part` makes also carries the commands before it; one behind a gap knows only when its rollout began.

    Attributes
    ----------
    t : array (N+1,)
        Instants [s], evenly spaced, increasing.
    u : array (N,)
        Commands: u[k] is held from t[k] to t[k+1] (zero-order hold); a torque [N m] where the model has no actuator.
    theta : array (N+1,), (1,) or None
        Angle readings [rad], 0 upright; jumps of whole turns are taken out (unwrapped); (1,) where only the start angle
        is known.
    theta_dot : array (N+1,) or None
        Speed readings [rad/s].
    name : str
        The name by which answers mention it.
    origin : float or None
        The instant [s] at which the rollout began, from which time-dependent effects count; by default t[0].
    before : array (M,) or None
        The commands of the M intervals before t[0], which drives remember; by default none.
    whole : Record or None
        The record that it was thinned from, whose readings show the noise best; None if it was not thinned.
    command : str
        What u holds, "torque", "current", "voltage" or "position"; empty where nobody said so.

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
    whole: Record | None = field(default=None, repr=False)
    command: str = ""

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
        if self.origin is not None and not (is_real(self.origin) and self.origin <= self.t[0]):
            began = f"before its rollout does (origin = {self.origin!r})"
            raise InvalidInput(f"{self.name} begins at {self.t[0]:g} s, {began}")
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
        """The piece of control intervals first .. last-1, with the instants at both ends and the commands before it."""
        parts: dict[str, Any] = {}
        for column in COLUMNS:
            value = getattr(self, column)
            if value is None:
                continue
            if column == "theta" and len(value) == 1:
                parts[column] = value if first == 0 else None
            else:
                parts[column] = value[first : last + (len(value) > len(self))]
        kept = math.ceil(PREVIOUS_SECONDS / self.dt)
        before = self.commands[: len(self.previous_commands) + first][-kept:]
        origin = float(self.t[0]) if self.origin is None else self.origin
        return replace(self, **parts, name=name or self.name, origin=origin, before=before)

    def thinned(self, every: int) -> Record:
        """The record at every `every`-th instant, with the mean of the commands in between; an incomplete interval at
        the end is dropped."""
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
            whole=self.whole or self,
        )

    @property
    def time_since_start(self) -> Array:
        """Seconds since the rollout began (N+1,)."""
        return self.t - (self.t[0] if self.origin is None else self.origin)

    @property
    def previous_commands(self) -> Array:
        """`before`, or an empty array (0,)."""
        return np.zeros(0) if self.before is None else self.before

    @cached_property
    def commands(self) -> Array:
        """The commands before the record, then its own (M+N,)."""
        return np.concatenate([self.previous_commands, self.u])

    @property
    def driven(self) -> bool:
        """Whether the record holds any command; a free swing holds none."""
        return bool(np.any(self.u))

    @property
    def has_angles(self) -> bool:
        """Whether the angle was read at more than the first instant."""
        return self.theta is not None and len(self.theta) > 1

    @property
    def starts_midway(self) -> bool:
        """Whether the record begins in the middle of a rollout, and drives may remember commands that are not known."""
        known = (len(self.previous_commands) + 0.5) * self.dt
        return bool(self.time_since_start[0] > known and known < PREVIOUS_SECONDS)

    @property
    def dt(self) -> float:
        """Length of a control interval [s]."""
        return float(self.t[-1] - self.t[0]) / len(self.u)


def without_whole_turns(theta: Array) -> Array:
    """Unwrap angles (K,) [rad]; angles that span more than a turn were never wrapped and stay as they are."""
    wrapped = len(theta) > 0 and bool(np.ptp(theta) < 2.0 * math.pi + 1e-6)
    return np.unwrap(theta) if wrapped else theta.copy()


def tuple_of_records(records: Sequence[Record]) -> tuple[Record, ...]:
    """Return the records as a tuple. Raises InvalidInput where there are none, and for what is no Record."""
    given = items_of(records)
    if not given:
        raise InvalidInput("no records were given: expected at least one")
    for record in given:
        if not isinstance(record, Record):
            came = f"records holds {described(record)}"
            raise InvalidInput(f"{came}: expected Record objects, as read makes them of files and DataFrames")
    return given


def check_records(model: Model, records: Sequence[Record]) -> tuple[Record, ...]:
    """Return the records as a tuple if they fit the model: at least one, sampled at its dt, commands within its limit.

    Raises InvalidInput with the record's name, what came and what was expected.
    """
    check_model(model)
    given = tuple_of_records(records)
    for record in given:
        ask = "or are its times in milliseconds?"
        check_size(f"{record.name} has a sample interval [s] of", record.dt, LONGEST_INTERVAL, ask)
        if abs(record.dt - model.dt) * len(record) > 0.02 * model.dt:  # off by a fiftieth of an interval at its end
            raise InvalidInput(
                f"{record.name} is sampled every {record.dt:.7g} s, the model steps every {model.dt:.7g} s: expected a "
                "model with the log's dt"
            )
        largest = float(np.max(np.abs(record.u)))
        if record.command not in ("", model.command) and largest > 0.0:
            raise InvalidInput(
                f"{record.name} was read with command = {record.command!r}, and the model is driven by a "
                f"{model.command} command: expected a model with the actuator of that command, or read(command=...)"
            )
        if largest > model.u_max * (1.0 + 1e-9):
            raise InvalidInput(
                f"{record.name} has a {model.command} of {largest:g} {model.command_unit}, beyond the model's limit "
                f"|u| <= {model.u_max:g} {model.command_unit}"
            )
    return given


def as_read(records: Sequence[Record]) -> list[Record]:
    """The records that these were thinned from, each once, and those that were not thinned."""
    return list(dict.fromkeys(r.whole or r for r in records))


def unique_names(records: Sequence[Record]) -> tuple[Record, ...]:
    """The records, numbered where several share a name: answers refer to stretches of a record by its name."""
    names = [r.name for r in records]
    return tuple(replace(r, name=f"{r.name} {i}") if names.count(r.name) > 1 else r for i, r in enumerate(records))


def check_direct(model: Model, method: str) -> None:
    """Raise InvalidInput if an effect stands between state and log: at the sensors, or in the stamps of the torques."""
    between = [e.name for e in model.effects if e.of_log or e in model.output_effects]
    if between:
        came = f"{', '.join(between)} stands between the two"
        raise InvalidInput(
            f"{method} compares readings with the state, but {came}: expected a model without, or sysid.fit"
        )


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record as CSV: one row for each instant, missing values as empty cells. `read` brings it back exactly,
    if it does not thin it.

    Parameters
    ----------
    record : Record
        The record to write.
    path : path
        The file.

    Raises
    ------
    InvalidInput
        For a file that cannot be written, and a record that has the start angle alone.
    """
    check_kind("record", record, Record, "a Record, such as records[0]")
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
    """The records that hold the first `most` samples of a log."""
    shown = []
    for record in records:
        if most > 0:
            shown.append(record.head(most))
        most -= len(record)
    return tuple(shown)


def is_part(name: str, whole: str) -> bool:
    """Whether `name` is that of the record `whole` or of a part that was cut from it."""
    return name == whole or name.startswith(f"{whole}, ")


def in_a_row(instants: Sequence[Array]) -> Array:
    """Where each rollout begins [s] on a common axis of time, with gaps of 3 % of the longest rollout between them."""
    lengths = np.array([t[-1] - t[0] for t in instants])
    taken = lengths + 0.03 * np.max(lengths, initial=0.0)
    return np.cumsum(taken) - taken


def extent_of(records: Sequence[Record], turns: bool = True) -> Extent:
    """The Extent of a log, on which the probes of parameters depend; `turns` says whether its plant turns."""
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
    """The 99th percentile of the speed [rad/s], from the angles or, where none were read, from the speed readings."""
    angles = [np.abs(speed_about(r.theta, r.dt)) for r in records if r.theta is not None and r.has_angles]
    speeds = angles or [np.abs(r.theta_dot) for r in records if r.theta_dot is not None]
    return float(np.quantile(np.concatenate(speeds), 0.99)) if speeds else 0.0


def _half_of_travel(records: Sequence[Record]) -> float:
    """Half of an axis' travel [m]; where no position was read, the way that its typical speed takes it in a second."""
    places = [r.theta for r in records if r.theta is not None and r.has_angles]
    speeds = [r.theta_dot for r in records if r.theta_dot is not None]
    half = 0.5 * float(np.ptp(np.concatenate(places))) if places else float(np.std(np.concatenate(speeds)))
    return half or 1.0
