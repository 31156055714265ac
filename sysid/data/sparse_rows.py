"""Sparse rows: a logger that writes a row whenever a message comes leaves the columns of all other messages empty."""

from __future__ import annotations

import math

import numpy as np

from sysid.data.resampling import held_means
from sysid.data.table import Table

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
    read[np.flatnonzero(read)[:-1][np.diff(table["t"][read]) == 0.0]] = False  # of the same instant, the last
    rows = {name: column[read] for name, column in table.items()}
    if "theta" in rows and np.mean(np.isfinite(rows.get("theta_dot", rows["t"]))) < BESIDE:
        del rows["theta_dot"]
    if "torque" in rows:
        means = held_means(table["t"][told], table["torque"][told], rows["t"])
        rows["torque"] = np.append(means, math.nan)
    return rows
