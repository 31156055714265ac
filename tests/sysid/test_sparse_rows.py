"""Sparse rows: a log whose columns were written in rows of their own is the log of its readings."""

import math

import numpy as np
import pytest

from sysid.data.sparse_rows import in_rows_of_readings, is_sparse
from tests.sysid.written import read, rollouts, same, table, write


def scattered(columns, by):
    """Each column in rows of its own, at the same instants; `by` is a generator, which puts the rows of an instant in
    any order."""
    names, rows = [n for n in columns if n != "t"], []
    for k, t in enumerate(columns["t"]):
        rows += [{"t": t, names[i]: columns[names[i]][k]} for i in by.permutation(len(names))]
    return {n: np.array([row.get(n, math.nan) for row in rows]) for n in columns}


@pytest.mark.parametrize("channel", ["theta", "theta_dot"])
def test_a_log_whose_columns_stand_in_rows_of_their_own_is_the_log_itself(channel, tmp_path):
    (record,) = rollouts()
    whole = {name: column for name, column in table(record).items() if name in ("t", channel, "torque")}
    sparse = read(write(tmp_path / "log.csv", scattered(whole, np.random.default_rng(1))))
    same(sparse[0], read(write(tmp_path / "whole.csv", whole))[0], rtol=1e-9)
    assert any("hold a reading" in note for note in sparse.notes)


def test_no_impulse_of_the_commands_is_lost_whenever_they_come():
    rng = np.random.default_rng(2)
    t, told = np.arange(200) * 0.02, np.sort(rng.uniform(0.0, 4.0, 700))
    told[0] = 0.0
    u = rng.normal(size=700)
    both = np.argsort(np.concatenate([t, told]), kind="stable")
    columns = {
        "t": np.concatenate([t, told])[both],
        "theta": np.concatenate([np.sin(t), np.full(700, math.nan)])[both],
        "torque": np.concatenate([np.full(200, math.nan), u])[both],
    }
    assert is_sparse(columns, 0.1)
    rows = in_rows_of_readings(columns)
    np.testing.assert_array_equal(rows["t"], t)
    np.testing.assert_array_equal(rows["theta"], np.sin(t))
    fine = np.linspace(0.0, t[-1], 400_001)[:-1]
    held = np.mean(u[np.searchsorted(told, fine, side="right") - 1]) * t[-1]
    assert np.sum(rows["torque"][:-1]) * 0.02 == pytest.approx(held, abs=1e-3)


def test_readings_before_the_first_command_are_left_out_and_speeds_in_other_rows():
    columns = {
        "t": np.arange(6.0),
        "theta": np.array([1.0, math.nan, 2.0, math.nan, 3.0, math.nan]),
        "theta_dot": np.array([math.nan, 5.0, math.nan, 6.0, math.nan, 7.0]),
        "torque": np.array([math.nan, 0.5, math.nan, 1.5, math.nan, math.nan]),
    }
    rows = in_rows_of_readings(columns)
    assert set(rows) == {"t", "theta", "torque"}
    np.testing.assert_array_equal(rows["t"], [2.0, 4.0])
    np.testing.assert_array_equal(rows["torque"], [1.0, math.nan])


@pytest.mark.parametrize("change", ["time", "order", "rollouts"])
def test_a_table_without_a_clock_that_runs_on_in_one_rollout_is_not_taken_apart(change):
    columns = {"t": np.arange(40.0), "theta": np.where(np.arange(40) % 2, math.nan, 1.0)}
    assert is_sparse(columns, 0.1)
    changed = {
        "time": {"t": np.where(np.arange(40) == 7, math.nan, columns["t"])},
        "order": {"t": columns["t"][::-1]},
        "rollouts": {"rollout": np.zeros(40)},
    }
    assert not is_sparse(columns | changed[change], 0.1)
