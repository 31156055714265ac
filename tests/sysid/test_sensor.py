"""Sensor: which readings count, where, and how well."""

import math

import numpy as np
import pytest

from sysid import InvalidInput, Record, Sensor, paper_model, paper_rollouts

(PAPER,) = paper_rollouts(paper_model(), 1, np.random.default_rng(0), length=10)


def test_the_papers_protocol_reads_every_interior_speed_twice():
    readings = Sensor(theta_dot=1.0, theta_0=0.001).readings(PAPER)
    speeds = [r for r in readings if r.channel == "theta_dot"]
    count = np.bincount(np.concatenate([r.index for r in speeds]), minlength=11)
    assert count.tolist() == [1, *(9 * [2]), 1]
    (start,) = [r for r in readings if r.channel == "theta"]
    assert (start.index.tolist(), start.value.tolist(), start.sd) == ([0], [PAPER.theta[0]], 0.001)


def test_an_encoder_reads_every_angle_once():
    (angles,) = Sensor(theta=0.01).readings(PAPER)
    assert angles.index.tolist() == list(range(11)) and angles.sd == 0.01


def test_a_known_start_adds_nothing_to_measured_angles():
    assert len(Sensor(theta=0.01, theta_0=0.001).readings(PAPER)) == 1


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "the sensor measures nothing: give the sd of theta, of theta_dot or of both"),
        ({"theta_0": 0.1}, "the sensor measures nothing"),
        ({"theta": 0.0}, "sensor sd of theta is 0.0: expected a positive number, or None"),
        ({"theta_dot": -1.0}, "sensor sd of theta_dot is -1.0"),
        ({"theta_dot": math.nan}, "sensor sd of theta_dot is nan"),
        ({"theta_dot": math.inf}, "sensor sd of theta_dot is inf"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(InvalidInput, match=message):
        Sensor(**settings)


def test_channels_that_the_record_lacks_are_named():
    record = Record(PAPER.t, PAPER.u, theta=PAPER.theta, name="log")
    with pytest.raises(InvalidInput, match="log has no theta_dot readings, but the sensor gives them a sd of 1"):
        Sensor(theta_dot=1.0).readings(record)
    record = Record(PAPER.t, PAPER.u, theta_dot=PAPER.theta_dot, theta_dot_after=PAPER.theta_dot_after, name="log")
    with pytest.raises(InvalidInput, match="log has no theta, but the sensor says that its first value is known"):
        Sensor(theta_dot=1.0, theta_0=0.001).readings(record)
