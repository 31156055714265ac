"""What real logs are like (jitter, gaps, lost rows, rounded stamps) becomes records of one even sample interval."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid import RK4, Sensor
from sysid.data.logs import read
from sysid.estimation.fit import fit
from sysid.planning.excitation import multisine
from tests.sysid.written import MODEL, SENSOR, rollouts, table, write


def jittered(spread, seconds=10.0, gap=0.0):
    """The rows of a rig whose steps vary by `spread`, its torque held from row to row; `gap` [s] in the middle."""
    rng = np.random.default_rng(3)
    n = round(seconds / MODEL.dt)
    steps = MODEL.dt * (1.0 + spread * rng.uniform(-1.0, 1.0, n))
    steps[n // 2] += gap
    u = multisine(rng, n, MODEL.dt, 3.0, 2.0)
    state = MODEL.initial_state(math.pi + 1.0, 0.0)
    states = [state]
    for step, torque in zip(steps, u, strict=True):
        state = replace(MODEL, dt=step, integrator=RK4(substeps=max(4, round(step / 0.005)))).advance(state, torque)
        states.append(state)
    theta, theta_dot = (np.array([getattr(s, c) for s in states]) for c in ("theta", "theta_dot"))
    noise = rng.standard_normal((2, n + 1))
    rows = {"t": np.concatenate(([0.0], np.cumsum(steps))), "theta": theta, "theta_dot": theta_dot}
    rows["theta"], rows["theta_dot"] = theta + 0.003 * noise[0], theta_dot + 0.05 * noise[1]
    return rows | {"torque": np.append(u, 0.0)}


@pytest.mark.parametrize("spread", [0.0, 0.03, 0.2], ids=str)
def test_jitter_costs_nothing_but_its_own_noise(spread, tmp_path):
    log = read(write(tmp_path / "log.csv", jittered(spread, seconds=6.0)))
    assert log.dt == pytest.approx(0.02, rel=0.02 if spread else 1e-6)
    assert any("resampled from" in note for note in log.notes) == (spread > 0.0)
    model = replace(MODEL, dt=log.dt)
    estimate = fit(model, log, SENSOR)
    for name, truth in (("m", 1.0), ("l", 1.0), ("viscous.b", 0.05)):
        assert abs(estimate.values[name] - truth) < 3.5 * estimate.sd[name], name
    variance = estimate.cost / (estimate.n_readings - 5)
    assert abs(variance - 1.0) < 4.0 * math.sqrt(2.0 / estimate.n_readings) + 0.5 * spread


def test_impulses_are_kept_when_torque_is_resampled(tmp_path):
    rows = jittered(0.3)
    record = read(write(tmp_path / "log.csv", rows))[0]
    held = np.interp(record.t, rows["t"], np.concatenate(([0.0], np.cumsum(rows["torque"][:-1] * np.diff(rows["t"])))))
    np.testing.assert_allclose(np.cumsum(record.u) * record.dt, held[1:] - held[0], atol=0.05 * record.dt)


def test_a_gap_starts_a_new_rollout_and_is_told(tmp_path):
    log = read(write(tmp_path / "log.csv", jittered(0.0, gap=0.4)))
    assert [r.name for r in log] == ["log part 1", "log part 2"] and "1 gap of 0.42 s starts a new rollout" in log.notes
    assert log[1].t[0] - log[0].t[-1] == pytest.approx(0.42)


def polled():
    """The rows of a swing whose logger is often kept waiting: steps of 5 to 40 ms, and now and then up to 0.3 s."""
    rng = np.random.default_rng(5)
    steps = rng.uniform(0.005, 0.04, round(30.0 / 0.024))
    late = rng.random(len(steps)) < 0.05
    steps = np.where(late, rng.uniform(0.1, 0.3, len(steps)), steps)
    t = np.cumsum(steps)
    return {"t": t, "theta": np.pi + np.sin(2.0 * t), "torque": np.zeros(len(t))}


def test_the_few_rows_between_gaps_of_an_uneven_log_have_no_rate_of_their_own(tmp_path):
    assert len(read(write(tmp_path / "log.csv", polled()), dt=0.025)) > 20


def test_rows_in_bursts_are_taken_at_an_interval_that_bridges_most_gaps(tmp_path):
    rows = polled()
    log = read(write(tmp_path / "log.csv", rows))
    assert any("rows come in bursts: a sample interval of 0.078 s bridges nine in ten" in note for note in log.notes)
    long = [r for r in log if r.t[-1] - r.t[0] >= 1.0]
    assert sum(r.t[-1] - r.t[0] for r in long) > 0.9 * (rows["t"][-1] - rows["t"][0])
    for record in log:
        np.testing.assert_allclose(record.theta, np.pi + np.sin(2.0 * record.t), atol=0.07)
    # what is as far apart as the bursts last would be lost on such a grid
    bursts = rows["t"] % 1.0 < 0.4
    apart = read(write(tmp_path / "bursts.csv", {name: v[bursts] for name, v in rows.items()}))
    assert apart.dt < 0.04 and len(apart) > 20


@pytest.mark.parametrize("frequency", [0.4, 8.0])
def test_gaps_are_bridged_where_a_swing_has_nothing_faster_to_show(frequency, tmp_path):
    """A logger at 100 Hz is kept waiting for 60 ms now and then."""
    t = 0.01 * np.arange(3000)
    t = np.delete(t, [k + j for k in range(200, 3000, 200) for j in range(5)])
    rows = {"t": t, "theta": np.pi + np.sin(2.0 * np.pi * frequency * t), "torque": np.zeros(len(t))}
    log = read(write(tmp_path / "log.csv", rows))
    bridged = any("bridges all gaps between rows: the motion has nothing faster to show" in n for n in log.notes)
    assert bridged == (frequency < 1.0) and (len(log) == 1) == bridged
    if bridged:
        np.testing.assert_allclose(log[0].theta, np.pi + np.sin(2.0 * np.pi * frequency * log[0].t), atol=0.01)
    kept = read(tmp_path / "log.csv", thin=False)
    assert len(kept) == 15 and kept.dt == pytest.approx(0.01)


@pytest.mark.parametrize(("first", "last"), [(1, 0), (0, 3), (2, 2)])
def test_a_few_rows_apart_from_the_rest_are_left_out_and_need_no_bridge(first: int, last: int, tmp_path):
    """Before a logger is in step, or after it was stopped: the records are those of the other rows."""
    t = np.concatenate([0.005 * np.arange(first), 1.0 + 0.005 * np.arange(1000), 6.017 + 0.005 * np.arange(last)])
    t[:first] += 0.978 - 0.005 * (first - 1)
    rows = {"t": t, "theta": np.pi + np.sin(2.5 * t), "torque": np.sign(np.sin(2.5 * t))}
    log = read(write(tmp_path / "log.csv", rows))
    other = read(write(tmp_path / "rest.csv", {name: v[first : len(t) - last] for name, v in rows.items()}))
    assert log.dt == other.dt and len(log) == len(other) == 1
    assert np.array_equal(log[0].theta, other[0].theta) and np.array_equal(log[0].u, other[0].u)
    assert any("too short to use" in note for note in log.notes)


def test_a_step_that_is_no_gap_at_the_rate_of_the_slowest_rollout_cuts_nothing(tmp_path):
    """Two rollouts, of which the faster lacks rows now and then, for no longer than the other's steps are."""
    t = 0.002 * np.arange(2000)
    fast, slow = np.delete(t, [k + j for k in range(100, 2000, 100) for j in range(4)]), t[::3]
    for name, times in (("fast", fast), ("slow", slow)):
        write(tmp_path / f"{name}.csv", {"t": times, "theta": np.sin(2.0 * times), "torque": np.zeros(len(times))})
    log = read([tmp_path / "fast.csv", tmp_path / "slow.csv"], thin=False)
    assert log.dt == pytest.approx(0.006) and len(log) == 2 and not any("gap" in note for note in log.notes)


def test_a_step_that_is_no_gap_at_the_interval_asked_for_cuts_nothing(tmp_path):
    rows = polled()
    log = read(write(tmp_path / "log.csv", rows), dt=0.1)
    assert len(log) == 1 and log[0].t[-1] - log[0].t[0] > 0.98 * (rows["t"][-1] - rows["t"][0])
    assert not any("gap" in note or "pieces" in note for note in log.notes)
    np.testing.assert_allclose(log[0].theta, np.pi + np.sin(2.0 * log[0].t), atol=0.05)


def test_a_missing_row_is_filled_in_and_a_doubled_stamp_dropped(tmp_path):
    rows = jittered(0.0)
    keep = np.delete(np.arange(len(rows["t"])), 77)
    doubled = np.sort(np.append(keep, [10, 200, 300]))
    log = read(write(tmp_path / "log.csv", {name: v[doubled] for name, v in rows.items()}))
    assert len(log) == 1 and len(log[0]) == len(rows["t"]) - 1
    assert {"3 duplicate stamps dropped", "1 missing row filled in"} <= set(log.notes)
    others = np.delete(np.arange(len(rows["t"])), 77)
    np.testing.assert_allclose(log[0].theta[others], rows["theta"][others], atol=1e-6)
    assert log[0].theta[77] == pytest.approx(np.mean(rows["theta"][[76, 78]]), abs=1e-9)


@pytest.mark.parametrize("decimals", [2, 3])
def test_rounded_stamps_are_taken_as_even(decimals, tmp_path):
    model = replace(MODEL, dt=1.0 / 150.0)
    (record,) = rollouts(model=model)
    log = read(write(tmp_path / "log.csv", table(record) | {"t": np.round(record.t, decimals)}))
    assert log.dt == pytest.approx(record.dt, rel=1e-4)
    assert any(f"stamps rounded to {10.0**-decimals:g} s taken as even" in note for note in log.notes)
    np.testing.assert_array_equal(log[0].theta, record.theta)
    np.testing.assert_array_equal(log[0].u, record.u)


def test_wrapped_angles_are_unwrapped_before_they_are_resampled(tmp_path):
    rng = np.random.default_rng(0)
    t = np.cumsum(0.02 * (1.0 + 0.2 * rng.uniform(-1.0, 1.0, 500)))
    turning = 6.0 * t + np.sin(t)
    wrapped = (turning + math.pi) % (2.0 * math.pi) - math.pi
    record = read(write(tmp_path / "log.csv", {"t": t, "theta": wrapped}))[0]
    expected = 6.0 * record.t + np.sin(record.t)
    offset = record.theta - expected
    np.testing.assert_allclose(offset, 2.0 * math.pi * np.round(offset[0] / (2.0 * math.pi)), atol=1e-4)


@pytest.mark.parametrize("rows", [1, 4])
def test_a_motor_that_makes_more_than_half_a_turn_between_two_readings_keeps_its_angles(tmp_path, rows):
    t = 0.005 * np.arange(2000)
    theta = (350.0 * t + 20.0 * np.sin(t))[np.arange(2000) // rows * rows]
    record = read(write(tmp_path / "log.csv", {"t": t, "theta": theta}))[0]
    assert np.ptp(record.theta) == pytest.approx(np.ptp(theta), rel=0.01)


def test_a_longer_sample_interval_can_be_asked_for(tmp_path):
    (record,) = rollouts(sensor=Sensor(theta=1e-6, theta_dot=1e-6))
    log = read(write(tmp_path / "log.csv", table(record)), dt=0.06)
    assert log.dt == 0.06 and log[0].dt == pytest.approx(0.06)
    np.testing.assert_allclose(log[0].theta, record.theta[::3], atol=1e-5)
    np.testing.assert_allclose(log[0].u, record.u.reshape(-1, 3).mean(axis=1), atol=1e-9)


def test_a_few_rows_without_a_number_are_left_out_and_counted(tmp_path):
    (record,) = rollouts()
    columns = {name: v.copy() for name, v in table(record).items()}
    columns["theta"][[20, 150]] = math.nan
    columns["torque"][[21, -1]] = math.nan
    log = read(write(tmp_path / "log.csv", columns))
    assert log.notes[:2] == ("log.csv: 1 row without a number left out", "log.csv: 2 rows without a reading")
    assert len(log) == 1 and len(log[0]) == len(record)


def test_the_torque_of_a_row_without_a_reading_acts_all_the_same(tmp_path):
    """Of a log that lacks a reading here and there, every impulse is kept."""
    (record,) = rollouts()
    columns = {name: v.copy() for name, v in table(record).items()}
    lacking = np.random.default_rng(0).choice(np.arange(1, len(record)), 20, replace=False)
    columns["theta"][lacking] = columns["theta_dot"][lacking] = math.nan
    read_back = read(write(tmp_path / "log.csv", columns))[0]
    np.testing.assert_allclose(read_back.u, record.u, atol=1e-12)
    kept = np.setdiff1d(np.arange(len(record) + 1), lacking)
    np.testing.assert_allclose(read_back.theta[kept], record.theta[kept], atol=1e-12)


def test_stamps_in_seconds_since_1970_are_as_good_as_any(tmp_path):
    """A log that lost rows, stamped by a clock: microseconds at 1.7e9 s."""
    (record,) = rollouts()
    rng = np.random.default_rng(0)
    kept = np.sort(rng.choice(len(record) + 1, 290, replace=False))
    columns = {name: v[kept] for name, v in table(record).items()}
    columns["t"] = columns["t"] + np.round(rng.uniform(-1e-3, 1e-3, len(kept)), 6)
    near = read(write(tmp_path / "near.csv", columns))
    far = read(write(tmp_path / "far.csv", columns | {"t": columns["t"] + 1.7e9}))
    assert far.dt == pytest.approx(near.dt, rel=1e-6) and far.notes == near.notes
    np.testing.assert_allclose(far[0].theta, near[0].theta, atol=1e-5)


def test_behind_a_gap_the_clock_goes_on_and_the_commands_are_not_known(tmp_path):
    (record,) = rollouts()
    columns = {name: np.delete(v, slice(100, 120)) for name, v in table(record).items()}
    first, second = read(write(tmp_path / "gap.csv", columns))
    assert (first.starts_midway, second.starts_midway) == (False, True)
    assert second.time_since_start[0] == pytest.approx(second.t[0]) and len(second.previous_commands) == 0
