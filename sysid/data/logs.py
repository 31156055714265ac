"""Logs: reading what a rig wrote into records in our conventions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Literal, get_args, overload

import numpy as np

from sysid.data import checks, log_files, resampling
from sysid.data.columns import Command, TimeUnit, chosen_columns, in_seconds, likely_columns, wanted_columns, with_signs
from sysid.data.free_part import free_part
from sysid.data.needed_rate import needed_rate
from sysid.data.record import Record, amount_of, without_whole_turns
from sysid.data.resampling import Rows
from sysid.data.sparse_rows import in_rows_of_readings, is_sparse
from sysid.data.table import Table
from sysid.errors import InvalidInput, check_kind, is_real
from sysid.limits import LOG_ROWS, check_size
from sysid.physics.plants import Plant

File = str | PathLike[str] | Any
"""A path, or a pandas DataFrame."""
LEAST_AWAY = 1.5 * math.pi
"""Least angle [rad] from where a joint should hang that is taken for whole turns."""
FEW = 0.1
"""The largest share of rows without a number that may be left out."""


@dataclass(frozen=True, eq=False)
class Log(Sequence[Record]):
    """A log that was read: a sequence of records.

    Attributes
    ----------
    records : tuple of Record
        One for each rollout or, if it has gaps, for each of its pieces.
    notes : tuple of str
        What was done to the log, one sentence each.
    dt : float
        The sample interval of all records [s].
    """

    records: tuple[Record, ...]
    notes: tuple[str, ...]
    dt: float

    def __len__(self) -> int:
        return len(self.records)

    @overload
    def __getitem__(self, index: int) -> Record: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Record, ...]: ...
    def __getitem__(self, index: int | slice) -> Record | tuple[Record, ...]:
        return self.records[index]

    def thinned(self) -> Log:
        """The log at the rate that its motion needs (`needed_rate`), if it was sampled at least twice as fast.

        A faster rate only repeats what a slower one says: its errors are rounding and vibration, and every estimate
        takes time in proportion.
        """
        every = math.floor(1.0 / (needed_rate(self.records) * self.dt) + 0.02)
        if every < 2:
            return self
        records = tuple(r.thinned(every) for r in self.records if len(r) >= every)
        note = f"thinned from {1.0 / self.dt:.4g} Hz: the motion has nothing faster to show (--dt keeps another rate)"
        return Log(records, (*self.notes, note), every * self.dt)

    def __str__(self) -> str:
        channels = " and ".join(c for c in ("theta", "theta_dot") if getattr(self.records[0], c) is not None)
        return "; ".join((f"{amount_of(self.records)} of {channels}", *self.notes))


def notes_of(records: Sequence[Record]) -> tuple[str, ...]:
    """The notes of a Log; records that come from elsewhere have none."""
    return records.notes if isinstance(records, Log) else ()


def read(
    *paths: File | Iterable[File],
    columns: str | Mapping[str, str] | None = None,
    zero: Literal["upright", "hanging"] | float = "upright",
    flip_torque: bool = False,
    degrees: bool = False,
    begin: float | None = None,
    end: float | None = None,
    dt: float | None = None,
    time_unit: TimeUnit | None = None,
    plant: Plant | None = None,
    command: Command = "torque",
    joint: str = "",
    thin: bool = True,
) -> Log:
    """Read logs into evenly sampled records in SI units with theta = 0 upright; a file may hold several rollouts.

    Rows without a number are left out if they are few, or if each column was written in rows of its own
    (`sysid.data.sparse_rows`); their command is kept where it is known. Uneven stamps and gaps are resampled
    (`sysid.data.resampling`). The begin and the end of a free swing are left out where a hand holds it
    (`sysid.data.free_part`).

    Parameters
    ----------
    *paths : path or DataFrame, or iterable of these
        CSV, JSON, .npz, .mat, HDF5, Parquet and Excel files, ROS 2 bags and MCAP, recognised by their content; pandas
        DataFrames, whose index is a column if it has a name. Dates and times become seconds since the first row.
    columns : str or mapping, optional
        "t=time_s,theta=angle_rad,...", or the same as a mapping: the file's names for t [s], theta [rad], theta_dot
        [rad/s] (one of the two is enough), torque [N m] (held from its row's time to the next) and rollout. A log
        without a torque is a free swing. "theta_dot=" leaves a column out; other columns are ignored. The command may
        be called u, command, force or after its kind (see `command`). The columns of a text without a row of names are
        called 1, 2, ... "t=" is for rows without a time that were written every dt seconds.
    zero : {"upright", "hanging"} or float
        What the file's angle 0 means; a number is the file's angle where the joint hangs, so that 0 is "hanging".
    flip_torque : bool
        The file's positive torque (current, voltage) lowers its angle.
    degrees : bool
        The file has degrees and degrees/s.
    begin, end : float, optional
        The window [s] of the file's t that is read.
    dt : float, optional
        A sample interval [s] other than the logs' own.
    time_unit : {"s", "ms", "us"}, optional
        The unit of the file's t; by default it is inferred from the column's name or from the speed.
    plant : Plant, optional
        The machine of the log. A LinearAxis has theta [m], theta_dot [m/s] and torque [N].
    command : {"torque", "current", "voltage", "position"}
        What column "torque" (or "command") holds: a torque, a current [A], a voltage [V] or duty cycle, or the target
        position of a servo, which is converted as the angle is. The model needs the actuator that goes with it.
    joint : str
        Which joint of a bag's sensor_msgs/JointState to read, if there are several; its effort is the torque.
    thin : bool
        Whether a log that was sampled much faster than its motion needs is thinned if no dt is given (`Log.thinned`).

    Returns
    -------
    Log
        A sequence of records, with notes on what was done to the log.

    Raises
    ------
    InvalidInput
        In one sentence, for anything that cannot be a log of a joint.
    """
    hanging = _hanging(zero, degrees)
    check_kind("plant", plant, Plant | None, "a plant, such as RodPendulum()")
    for name, said_so in (("flip_torque", flip_torque), ("degrees", degrees), ("thin", thin)):
        _check_choice(name, said_so, (True, False))
    _check_choice("command", command, get_args(Command))
    _check_choice("time_unit", "s" if time_unit is None else time_unit, get_args(TimeUnit))
    low, high = _window(begin, end, dt)
    sources, wanted = log_files.sources(paths, joint), wanted_columns(columns, command)
    if wanted.get("t") == "":
        if dt is None:
            raise InvalidInput("columns leave out t: expected the interval of the rows in seconds, too (--dt, dt)")
        sources, wanted = (source.timed(dt) for source in sources), wanted | {"t": log_files.CLOCK}
        time_unit = "s"
    rollouts: list[Rows] = []
    notes: list[str] = []
    of_another_unit = False
    for source in sources:
        chosen = chosen_columns(source.name, source.names, wanted, command)
        other = None if "torque" in {*chosen, *wanted} else likely_columns(source.names, chosen).get("torque")
        if other and np.any(np.isfinite(source.load({"t": chosen["t"], "torque": other})["torque"])):
            notes.append(f"{source.name}: column {other!r} is not read: is it the torque (columns torque={other})?")
        whole = in_seconds(source.name, chosen["t"], source.load(chosen), time_unit, notes)
        inside = ~((whole["t"] < low) | (whole["t"] > high))
        table, said = with_signs(source.name, {name: column[inside] for name, column in whole.items()}, chosen)
        notes += said
        if len(table["t"]) == 0:
            span = f" between {low:g} and {high:g} s" if begin is not None or end is not None else ""
            raise InvalidInput(f"{source.name} has no rows{span}")
        if dt is None:
            advice = "in a window (begin, end) or at a longer sample interval (dt)"
            check_size(f"{source.name}: rows:", len(table["t"]), LOG_ROWS, advice)
        checks.check_magnitude(source.name, table, chosen)
        table = _complete(source.name, table, chosen, notes)
        checks.check_time(source.name, table, chosen)
        for name, part in _rollouts(source.title, table):
            known = np.all([np.isfinite(column) for column in part.values()], axis=0)
            said, differs = checks.check_columns(name, {k: v[known] for k, v in part.items()}, degrees)
            notes, of_another_unit = [*notes, *said], of_another_unit or differs
            rollouts.append(_rows(name, part, hanging, flip_torque, degrees, command))
    if of_another_unit:
        rollouts = [r if r.theta is None else replace(r, theta_dot=None) for r in rollouts]
    records, step, more = resampling.evenly(rollouts, dt, thin)
    records = tuple(replace(record, command=command) for record in records)
    if command != "position":  # a position command of 0 is a command, and no free swing
        hangs = zero != "upright" if plant is None else float(plant.largest_gravity_torque) > 0.0
        for mend in (free_part, _about_one_turn) if hangs else (free_part,):
            mended = [mend(record) for record in records]
            records, more = tuple(record for record, _ in mended), (*more, *(said for _, said in mended if said))
    shift = hanging - math.pi  # the file's angles less ours
    log = Log(records, (*notes, *more, *checks.doubts(records, plant, command, shift, degrees)), step)
    return log.thinned() if thin and dt is None else log


def _about_one_turn(record: Record) -> tuple[Record, str]:
    """A free swing that hangs whole turns from our zero, moved by these; and a sentence on that, empty for none.

    Gravity does not tell turns apart, but an offset and a spring would stand for them together.
    """
    if record.theta is None or record.driven or np.ptp(record.theta) > 2.0 * math.pi:
        return record, ""
    away = float(np.median(record.theta)) - math.pi
    turns = round(away / (2.0 * math.pi))
    if abs(away) < LEAST_AWAY:
        return record, ""
    said = f"{record.name}: it swings {abs(turns)} turn{'s' * (abs(turns) > 1)} from its zero, which theta is moved by"
    return replace(record, theta=record.theta - 2.0 * math.pi * turns), said


def _hanging(zero: str | float, degrees: bool) -> float:
    """The file's angle [rad] where the joint hangs; raises InvalidInput for what is no `zero`."""
    if zero in ("upright", "hanging"):
        return 0.0 if zero == "hanging" else math.pi
    if not (is_real(zero) and math.isfinite(zero)):
        raise InvalidInput(f"zero = {zero!r}: expected upright, hanging, or the log's angle where the joint hangs")
    return math.radians(zero) if degrees else float(zero)


def _check_choice(name: str, value: object, choices: Sequence[object]) -> None:
    if value not in choices:
        raise InvalidInput(f"{name} = {value!r}: expected one of {', '.join(map(str, choices))}")


def _window(begin: float | None, end: float | None, dt: float | None) -> tuple[float, float]:
    for name, value in (("begin", begin), ("end", end), ("dt", dt)):
        if value is not None and not is_real(value):
            raise InvalidInput(f"{name} = {value!r}: expected a number of seconds")
    low, high = -math.inf if begin is None else begin, math.inf if end is None else end
    if not low < high:
        raise InvalidInput(f"the window from {low:g} to {high:g} s is empty: expected begin < end")
    return low, high


# ---- rows ------------------------------------------------------------------------------------------------------------


def _complete(log: str, table: Table, titles: Mapping[str, str], notes: list[str]) -> Table:
    """The table without the rows that lack a time or a torque; the last torque of a rollout may be missing.

    A row that lacks a reading stays, with all its readings nan: its torque acted all the same. If many rows lack
    something, they may be sparse (`sysid.data.sparse_rows`).
    """
    table = dict(table)
    for name in list(table):
        if not np.any(np.isfinite(table[name])) and len(table["t"]) > 1:
            if name not in ("theta", "theta_dot") or not {"theta", "theta_dot"} <= set(table):
                raise InvalidInput(f"{log}: column {titles[name]!r} for {name} holds no numbers")
            notes.append(f"{log}: column {titles[name]!r} is empty and left out")
            del table[name]
    if is_sparse(table, FEW):
        rows, table = len(table["t"]), in_rows_of_readings(table)
        notes.append(f"{log}: {len(table['t'])} of {rows} rows hold a reading; the commands in the others are averaged")
    bad = {name: ~np.isfinite(column) for name, column in table.items()}
    if "torque" in table:
        last = np.append(np.diff(table.get("rollout", np.zeros(len(bad["t"])))) != 0.0, True)
        bad["torque"] &= ~last
        table["torque"] = np.where(last & ~np.isfinite(table["torque"]), 0.0, table["torque"])
    lost = np.any(list(bad.values()), axis=0)
    if np.mean(lost) > FEW:
        worst = max(bad, key=lambda name: int(bad[name].sum()))
        raise InvalidInput(
            f"{log}: {lost.sum()} of {len(lost)} rows lack a number, most often {titles[worst]!r}: "
            "expected a few at most"
        )
    readings = [name for name in ("theta", "theta_dot") if name in table]
    unread = np.any([bad[name] for name in readings], axis=0)
    lost = np.any([bad[name] for name in bad if name not in readings], axis=0)
    for rows, what in ((lost, "a number left out"), (unread & ~lost, "a reading")):
        if np.any(rows):
            notes.append(f"{log}: {rows.sum()} row{'s' * (int(rows.sum()) != 1)} without {what}")
    table |= {name: np.where(unread, np.nan, table[name]) for name in readings}
    return {name: column[~lost] for name, column in table.items()}


def _rows(name: str, table: Table, hanging: float, flip_torque: bool, degrees: bool, command: Command) -> Rows:
    """A rollout in our conventions: radians, 0 upright, a positive torque raises theta, angles unwrapped. The file's
    joint hangs at the angle `hanging` [rad].

    Raises InvalidInput for `flip_torque` with a position command, whose sign is that of the angle.
    """
    converted = dict(table)
    angles = ("theta", "torque") if command == "position" else ("theta",)
    if command == "position" and flip_torque:
        raise InvalidInput("flip_torque with command = 'position': a position command has the sign of the angle")
    for column in (*angles, "theta_dot"):
        if degrees and column in converted:
            converted[column] = np.deg2rad(converted[column])
    for column in angles:
        if column in converted:
            converted[column] = converted[column] + (math.pi - hanging)
    if flip_torque and "torque" in converted:
        converted["torque"] = -converted["torque"]
    torque = converted.get("torque", np.zeros(len(table["t"])))
    if "theta" in converted:
        read = np.isfinite(table["theta"])
        converted["theta"] = converted["theta"].copy()
        converted["theta"][read] = without_whole_turns(converted["theta"][read])
    return Rows(name, table["t"], torque, converted.get("theta"), converted.get("theta_dot"))


def _rollouts(title: str, table: Table) -> Iterable[tuple[str, Table]]:
    """The name and the table of each rollout, split by the value of column "rollout"."""
    if "rollout" not in table:
        return [(title, table)]
    values, first = np.unique(table["rollout"], return_index=True)
    ordered = values[np.argsort(first)]
    return [
        (f"{title} rollout {value:g}", {name: v[table["rollout"] == value] for name, v in table.items()})
        for value in ordered
    ]
