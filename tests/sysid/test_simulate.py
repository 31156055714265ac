"""Simulation, and what a sensor reads of it."""

import dataclasses
import math

import numpy as np
import pytest

from study.paper.protocol import paper_model
from sysid import InvalidInput, Record, Sensor, simulate

MODEL = paper_model(2.0, 1.5)
ALL = Record(0.05 * np.arange(11), np.zeros(10), np.linspace(3.0, 4.0, 11), np.arange(11.0))


@pytest.mark.parametrize("sensor", [Sensor(0.01, 1.0), Sensor(0.2), Sensor(None, 0.3)])
def test_readings_have_the_stated_sd_and_no_bias(sensor):
    n, rollouts = 400, 60
    run = simulate(MODEL, np.random.default_rng(1).uniform(-2.0, 2.0, (rollouts, n)), 2.0, 0.0)
    records = sensor.measure(run, np.random.default_rng(2))
    errors = {"theta": [], "theta_dot": []}
    for i, record in enumerate(records):
        assert (record.theta is None, record.theta_dot is None) == (sensor.theta is None, sensor.theta_dot is None)
        values, sds = sensor.readings(record)
        for column, channel in enumerate(errors):
            if np.all(np.isfinite(sds[:, column])):
                errors[channel].append((values[:, column] - getattr(run, channel)[i]) / sds[:, column])
    for channel, parts in errors.items():
        if not parts:
            assert getattr(sensor, channel) is None
            continue
        e = np.concatenate(parts)
        # 4.5 standard errors of a standard deviation and of a mean
        assert np.std(e) == pytest.approx(1.0, abs=4.5 / math.sqrt(2.0 * len(e)))
        assert np.mean(e) == pytest.approx(0.0, abs=4.5 / math.sqrt(len(e)))


def test_reading_errors_are_independent_between_instants_rollouts_and_channels():
    run = simulate(MODEL, np.zeros((40, 500)), math.pi, 0.0)
    records = Sensor(1.0, 1.0).measure(run, np.random.default_rng(3))
    e = np.stack([np.concatenate([r.theta_dot - run.theta_dot[0], r.theta - run.theta[0]]) for r in records])
    e = e[:, :501]
    assert abs(np.mean(e[:, 1:] * e[:, :-1])) < 4.5 / math.sqrt(e.size)
    assert abs(np.mean(e[1:] * e[:-1])) < 4.5 / math.sqrt(e.size)


def test_same_seed_same_numbers():
    run = simulate(MODEL, np.zeros((3, 20)), 1.0, 0.0)
    one, same, other = (Sensor(0.01, 1.0).measure(run, np.random.default_rng(s)) for s in (7, 7, 8))
    for a, b, c in zip(one, same, other, strict=True):
        np.testing.assert_array_equal(a.theta, b.theta)
        np.testing.assert_array_equal(a.theta_dot, b.theta_dot)
        assert not np.any(a.theta_dot == c.theta_dot)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros(0), 0.0, 0.0), r"u has shape \(0,\): expected \(..., N\) with at least one"),
        ((0.0, 0.0, 0.0), r"u has shape \(\): expected"),
        (([0.0, math.nan], 0.0, 0.0), "u has values that are not finite"),
        (([0.0, 2.5], 0.0, 0.0), r"\|u\| reaches 2.5 N m, beyond the model's limit 2 N m"),
        (([0.0, 1.0], math.nan, 0.0), "the start state is not finite"),
        (([0.0, 1.0], 0.0, [1.0, math.inf]), "the start state is not finite"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(InvalidInput, match=message):
        simulate(MODEL, *arguments)


def test_every_reading_counts_once_also_a_start_angle_alone():
    values, sds = Sensor(theta=0.001, theta_dot=1.0).readings(dataclasses.replace(ALL, theta=ALL.theta[:1]))
    assert (values[0, 0], sds[0, 0]) == (3.0, 0.001)
    assert np.all(np.isinf(sds[1:, 0])) and np.all(sds[:, 1] == 1.0)
    assert np.all(Sensor(theta=0.01).readings(ALL)[1] == [0.01, np.inf])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "the sensor measures nothing: give the sd of theta, of theta_dot or of both"),
        ({"theta": 0.0}, "sensor sd of theta is 0.0: expected a positive number, or None"),
        ({"theta_dot": -1.0}, "sensor sd of theta_dot is -1.0"),
        ({"theta_dot": math.nan}, "sensor sd of theta_dot is nan"),
        ({"theta_dot": math.inf}, "sensor sd of theta_dot is inf"),
        ({"theta": 0.01, "jitter": -0.001}, "the sensor's jitter is -0.001 s: expected zero or more"),
        ({"theta": 0.01, "jitter": math.nan}, "the sensor's jitter is nan s"),
    ],
)
def test_bad_settings_of_a_sensor_are_refused(settings, message):
    with pytest.raises(InvalidInput, match=message):
        Sensor(**settings)


def test_channels_that_the_record_lacks_are_named():
    record = Record(ALL.t, ALL.u, theta=ALL.theta, name="log")
    with pytest.raises(InvalidInput, match="log has no theta_dot readings, but the sensor gives them a sd of 1"):
        Sensor(theta_dot=1.0).readings(record)
