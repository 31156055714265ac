"""Sensor: which readings count, where, and how well."""

import dataclasses
import math

import numpy as np
import pytest

from sysid import InvalidInput, Record, Sensor

ALL = Record(0.05 * np.arange(11), np.zeros(10), np.linspace(3.0, 4.0, 11), np.arange(11.0))


def test_a_start_angle_alone_is_one_reading():
    start, speeds = Sensor(theta=0.001, theta_dot=1.0).readings(dataclasses.replace(ALL, theta=ALL.theta[:1]))
    assert (start.index.tolist(), start.value.tolist(), start.sd.tolist()) == ([0], [3.0], [0.001])
    assert speeds.index.tolist() == list(range(11))


def test_an_encoder_reads_every_angle_once():
    (angles,) = Sensor(theta=0.01).readings(ALL)
    assert angles.index.tolist() == list(range(11)) and np.all(angles.sd == 0.01)


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
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(InvalidInput, match=message):
        Sensor(**settings)


def test_channels_that_the_record_lacks_are_named():
    record = Record(ALL.t, ALL.u, theta=ALL.theta, name="log")
    with pytest.raises(InvalidInput, match="log has no theta_dot readings, but the sensor gives them a sd of 1"):
        Sensor(theta_dot=1.0).readings(record)
