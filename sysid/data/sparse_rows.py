"""Sparse rows: a logger that writes a row whenever a message comes leaves the columns of all other messages empty."""

from __future__ import annotations

import math

import numpy as np

from sysid.data.table import Table
from sysid.physics.ops import Array

BESIDE = 0.9
"""Least share of the angles beside which a speed has to stand: fewer speeds are left out."""


def is_sparse(table: Table, few: float) -> bool:
    """Whether more than a `few` (a share) of a table's rows lack a reading or a command, though they have a time; its
    clock runs on, and it is one rollout."""
    known = {name: np.isfinite(column) for name, column in table.items()}
    read, told = known["theta" if "theta" in table else "theta_dot"], known.get("torque", known["t"])
    if "rollout" in table or not np.all(known["t"]) or np.any(np.diff(table["t"]) < 0.0):
        return False
    lacking = 1.0 - float(np.mean(np.all(list(known.values()), axis=0)))
    return lacking > few and bool(np.any(read) and np.any(told))


def in_rows_of_readings(table: Table) -> Table:
    """A sparse table's rows in which the angle (or, without one, the speed) was read.

    A command holds until the next one comes. Each row gets the mean of the commands that held until the next reading,
    so that no impulse is lost. Readings before the first command are left out, and so is a speed that stands in other
    rows than the angle.
    """
    read = np.isfinite(table["theta" if "theta" in table else "theta_dot"])
    told = np.isfinite(table.get("torque", table["t"]))
    read &= table["t"] >= table["t"][told][0]
    rows = {name: column[read] for name, column in table.items()}
    if "theta" in rows and np.mean(np.isfinite(rows.get("theta_dot", rows["t"]))) < BESIDE:
        del rows["theta_dot"]
    if "torque" in rows:
        rows["torque"] = _held_means(table["t"][told], table["torque"][told], rows["t"])
    return rows


def _held_means(told: Array, commands: Array, t: Array) -> Array:
    """The means (N,) of commands (K,), each held from the instant when it was `told` (K,), from each of the instants t
    (N,) to the next; nan for the last. Between instants that are the same it is the command itself."""
    impulses = np.concatenate([[0.0], np.cumsum(commands[:-1] * np.diff(told))])
    last = np.searchsorted(told, t, side="right") - 1
    until = impulses[last] + commands[last] * (t - told[last])
    span = np.diff(t)
    return np.append(np.divide(np.diff(until), span, where=span > 0.0, out=commands[last[:-1]].copy()), math.nan)
