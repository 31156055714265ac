"""Record: the log of one rollout, checked when it is made; writing it as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import InvalidInput

if TYPE_CHECKING:
    from sysid.model import Model

Array = NDArray[np.float64]
COLUMNS = ("t", "u", "theta", "theta_dot", "theta_dot_after")


@dataclass(frozen=True, eq=False)
class Record:
    """One rollout of N control intervals.

    t (N+1,)                [s]      instants, evenly spaced, increasing
    u (N,)                  [N m]    the command held from t[k] to t[k+1]
    theta (N+1,) or None    [rad]    angle readings, 0 upright; jumps of whole turns are taken out (unwrapped);
                                     (1,) where only the start angle is known
    theta_dot               [rad/s]  speed readings, (N+1,); (N,) where theta_dot_after is given
    theta_dot_after (N,)    [rad/s]  a second speed reading, of instant k+1, independent of theta_dot[k+1]:
                                     the paper's protocol reads before and after each step

    Raises InvalidInput for empty, ragged or non-finite data and for time that does not increase evenly.
    """

    t: Array
    u: Array
    theta: Array | None = None
    theta_dot: Array | None = None
    theta_dot_after: Array | None = None
    name: str = "record"

    def __post_init__(self) -> None:
        for column in COLUMNS:
            value: ArrayLike | None = getattr(self, column)
            if value is None and column in ("t", "u"):
                raise InvalidInput(f"{self.name} has no {column}: expected t (N+1,) and u (N,)")
            if value is not None:
                object.__setattr__(self, column, self._array(column, value))
        if self.theta is None and self.theta_dot is None:
            raise InvalidInput(f"{self.name} has no readings: expected theta, theta_dot or both")
        if len(self.u) == 0:
            raise InvalidInput(f"{self.name} is empty: expected at least one control interval (two instants)")
        n = len(self.u)
        speeds = n if self.theta_dot_after is not None else n + 1
        expected = {"t": n + 1, "theta": n + 1, "theta_dot": speeds, "theta_dot_after": n}
        for column, size in expected.items():
            series = getattr(self, column)
            if column == "theta" and series is not None and len(series) == 1:
                continue
            if series is not None and len(series) != size:
                came = f"{column} has {len(series)} values"
                raise InvalidInput(f"{self.name} is ragged: {came}, expected {size} for {n} commands u")
        self._check_time()
        if self.theta is not None:
            unwrapped = np.unwrap(self.theta)
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
        if n >= len(self):
            return self
        cut: dict[str, Any] = {}
        for column in COLUMNS:
            value = getattr(self, column)
            if value is not None:
                cut[column] = value[: n + (len(value) > len(self))]
        return replace(self, **cut)

    @property
    def dt(self) -> float:
        """Length of a control interval [s]."""
        return float(self.t[-1] - self.t[0]) / len(self.u)


def check_records(model: Model, records: Sequence[Record]) -> tuple[Record, ...]:
    """The records as a tuple, once they fit the model: at least one, the model's dt, torque within its limit.

    Raises InvalidInput with the record's name, what came and what was expected.
    """
    given = (
        (records,) if isinstance(records, Record) else tuple(records) if isinstance(records, Iterable) else (records,)
    )
    if not given:
        raise InvalidInput("no records were given: expected at least one")
    for record in given:
        if not isinstance(record, Record):
            raise InvalidInput(f"records holds {record!r}: expected Record objects, as read and measure make them")
        if abs(record.dt - model.dt) > 0.01 * model.dt:
            raise InvalidInput(f"{record.name} is sampled every {record.dt:g} s, the model steps every {model.dt:g} s")
        largest = float(np.max(np.abs(record.u)))
        if largest > model.u_max * (1.0 + 1e-9):
            raise InvalidInput(
                f"{record.name} has a torque of {largest:g} N m, beyond the model's limit |u| <= {model.u_max:g} N m"
            )
    return given


def check_direct(model: Model, method: str) -> None:
    """Raise InvalidInput where sensors show something else than the state, or the log's torques are shifted."""
    between = [e.name for e in model.effects if e.of_log or e in model.output_effects]
    if between:
        came = f"{', '.join(between)} stands between the two"
        raise InvalidInput(
            f"{method} compares readings with the state, but {came}: expected a model without, or sysid.fit"
        )


def write_csv(record: Record, path: str | Path) -> None:
    """Write a record as CSV that `read` brings back exactly, one row an instant; cells without a value stay empty."""
    columns = {c: getattr(record, c) for c in COLUMNS if getattr(record, c) is not None}
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for k in range(len(record) + 1):
            writer.writerow([repr(float(v[k])) if k < len(v) else "" for v in columns.values()])
