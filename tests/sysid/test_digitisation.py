"""A sensor that is slower than the log: its held readings are noticed, and the fresh ones alone are kept."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid import RK4
from sysid.data.digitisation import fresh, holding
from sysid.data.logs import read
from sysid.estimation.fit import fit
from tests.sysid.written import MODEL, SENSOR, rollouts, table, write

FAST = replace(MODEL, dt=0.002, integrator=RK4(substeps=1))
CHANNELS = ("theta", "theta_dot")


def held(columns, rows, channels=CHANNELS, first=0):
    """The columns with readings that come every `rows` rows (2.5: after 2 and 3 in turn) and are repeated till then."""
    k = np.arange(len(columns["t"]))
    last = np.maximum(np.floor(np.floor((k - first) / rows + 1e-9) * rows + 1e-9).astype(int) + first, 0)
    return columns | {name: columns[name][last] for name in channels}


@pytest.fixture(scope="module")
def record():
    return rollouts(model=FAST, seconds=8.0)[0]


@pytest.mark.parametrize("rows", [2, 2.5, 4, 4.5, 10, 25, 45])
def test_held_readings_are_noticed_and_the_fresh_ones_kept(rows, record, tmp_path):
    log = read(write(tmp_path / "log.csv", held(table(record), rows)), thin=False)
    note = next(note for note in log.notes if "is held for" in note)
    assert f"theta is held for {rows:.3g} rows each" in note and "logged at 500 Hz" in note
    assert log.dt == pytest.approx(0.002 * rows, rel=0.01)
    if rows == int(rows):
        n = len(log[0])
        np.testing.assert_allclose(log[0].theta, record.theta[:: int(rows)][: n + 1], atol=1e-9)
        np.testing.assert_allclose(log[0].u, record.u[: n * int(rows)].reshape(n, -1).mean(axis=1), atol=1e-9)


def test_readings_that_come_after_any_number_of_rows_are_held_too(record):
    """If they are rounded: an encoder that is not held shows another step in every row of so fast a motion."""
    rng, k = np.random.default_rng(0), np.arange(len(record) + 1)
    came = np.unique(np.minimum(np.cumsum(rng.integers(1, 20, len(k))), k[-1]))
    last = np.append(0, came)[np.searchsorted(came, k, side="right")]
    rounded = 1e-3 * np.round(record.theta / 1e-3)
    assert 8.0 <= holding([rounded[last]]) <= 12.0
    assert holding([rounded]) == 1.0


def test_where_two_clocks_meet_readings_that_come_twice_are_fresh(record):
    columns = held(table(record), 1.5)
    assert holding([columns["theta"]]) == 1.0


def test_the_truth_is_found_from_held_readings(record, tmp_path):
    log = read(write(tmp_path / "log.csv", held(table(record), 10)))
    estimate = fit(replace(MODEL, dt=log.dt), log, SENSOR)
    for name, truth in (("m", 1.0), ("l", 1.0), ("viscous.b", 0.05)):
        assert abs(estimate.values[name] - truth) < 4.0 * estimate.sd[name], name


def test_a_speed_that_is_held_for_longer_or_at_other_times_is_left_out(record, tmp_path):
    columns = held(table(record), 20, ["theta_dot"])
    log = read(write(tmp_path / "longer.csv", columns), thin=False)
    assert log[0].theta_dot is None and len(log[0]) == len(record)
    assert any("theta_dot is held for 20 rows each, longer than theta" in note for note in log.notes)
    columns = held(held(table(record), 10, ["theta"]), 10, ["theta_dot"], first=5)
    log = read(write(tmp_path / "apart.csv", columns))
    assert log[0].theta_dot is None and log.dt == pytest.approx(0.02)
    assert any("read at other times than theta" in note for note in log.notes)


def test_a_fresh_speed_beside_a_held_angle_is_kept_where_the_angle_is_fresh(record, tmp_path):
    log = read(write(tmp_path / "log.csv", held(table(record), 10, ["theta"])))
    assert log.dt == pytest.approx(0.02)
    np.testing.assert_allclose(log[0].theta_dot, record.theta_dot[::10][: len(log[0]) + 1], atol=1e-9)


@pytest.mark.parametrize("q", [0.0, 1e-3, 0.02, 0.2])
@pytest.mark.parametrize("speed", ["swing", "crawl", "rest", "stick and slip"])
def test_an_encoder_or_a_machine_at_rest_is_not_held(q, speed):
    t, rng = 0.002 * np.arange(6000), np.random.default_rng(0)
    motion = {
        "swing": np.sin(3.0 * t),
        "crawl": 0.05 * t,
        "rest": np.full(len(t), 1.0),
        "stick and slip": 0.3 * np.floor(t) + 0.3 * np.clip((t % 1.0) / 0.05, 0.0, 1.0),
    }[speed]
    for noise in (0.0, 0.3 * q):
        theta = motion + noise * rng.standard_normal(len(t))
        assert holding([q * np.round(theta / q) if q else theta]) == 1.0


def test_a_log_with_rests_keeps_its_even_rate(record, tmp_path):
    """Where the machine stands, a coarse sensor shows the same again and again: no gap."""
    columns = table(record)
    t = columns["t"]
    columns["theta"] = 0.003 * np.round((math.pi + np.sin(3.0 * t) * (t % 4.0 > 2.0)) / 0.003)
    log = read(write(tmp_path / "log.csv", held(columns | {"theta_dot": columns["theta_dot"]}, 10, ["theta"])))
    assert len(log) == 1 and log.dt == pytest.approx(0.02, rel=1e-3)


def test_fresh_rows_are_counted_within_rests():
    values = np.repeat([1.0, 2.0, 2.0, 2.0, 3.0], 4)
    np.testing.assert_array_equal(fresh(values, 4.0), [0, 4, 8, 12, 16])
    np.testing.assert_array_equal(fresh(values[2:], 4.0), [2, 6, 10, 14])
