"""A speed is relied on where it says something that the angle does not, and where it is the angle's speed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sysid import RK4, FilteredSpeed, GeneralJoint, Model, Record, Sensor, add, effect, fit, simulate
from sysid.estimation.channels import relied_on
from sysid.physics.simulate import Trajectory
from sysid.planning.excitation import multisine

DT = 0.01
JOINT = Model(GeneralJoint(J=0.3, G=2.0), (effect("viscous", b=0.07),), RK4(substeps=2), DT)
ANGLE = 0.002
SIMILAR = 0.02
"""sd [rad/s] of a tachometer as good as the angle's own slope over 0.1 s, which is 0.022."""


def logs(sensor: Sensor, dt: float = DT, seed: int = 0, fast: float = 2.0) -> list[Record]:
    """Two rollouts of 6 s with independent errors of both channels."""
    model, n = replace(JOINT, dt=dt), round(6.0 / dt)
    rng = np.random.default_rng(seed)
    u = np.array([multisine(rng, n, dt, 2.0, fast) for _ in range(2)])
    return sensor.measure(simulate(model, u, math.pi, np.zeros(2)), rng)


def smoothed(T: float, seed: int) -> Trajectory:
    """Two rollouts of which the speed is filtered before it is measured."""
    u = np.array([multisine(np.random.default_rng([seed, k]), 600, DT, 2.0, 2.0) for k in range(2)])
    return simulate(JOINT.with_effect(FilteredSpeed(T=T)), u, math.pi, np.zeros(2))


def late(record: Record, T: float) -> Record:
    """The same log with its speed behind a low-pass filter of time constant T [s], as a drive reports it."""
    kept, shown = math.exp(-record.dt / T), record.theta_dot.copy()
    for k in range(1, len(shown)):
        shown[k] = kept * shown[k - 1] + (1.0 - kept) * record.theta_dot[k]
    return replace(record, theta_dot=shown)


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_an_independent_tachometer_is_kept(dt: float) -> None:
    sensor = Sensor(theta=ANGLE, theta_dot=SIMILAR)
    for seed in range(3):
        assert relied_on(replace(JOINT, dt=dt), logs(sensor, dt, seed), sensor) is sensor


def test_its_offset_and_its_scale_are_no_reason_to_drop_it() -> None:
    """Those are effects that a model can have."""
    sensor = Sensor(theta=ANGLE, theta_dot=SIMILAR)
    for bias, scale in ((0.1, 1.0), (0.0, 1.1), (-0.2, 0.95)):
        records = [replace(r, theta_dot=bias + scale * r.theta_dot) for r in logs(sensor)]
        assert relied_on(JOINT, records, sensor) is sensor


@pytest.mark.parametrize("T", [0.05, 0.1])
def test_a_filtered_late_speed_is_dropped_however_smooth_it_is(T: float) -> None:
    for seed in range(3):
        records = [late(r, T) for r in logs(Sensor(theta=ANGLE, theta_dot=SIMILAR), seed=seed)]
        sensor = Sensor(theta=ANGLE, theta_dot=0.5 * SIMILAR)
        assert relied_on(JOINT, records, sensor) == Sensor(theta=ANGLE)


@pytest.mark.parametrize("T", [0.005, 0.02, 0.05])
def test_a_speed_that_was_filtered_before_its_error_is_kept(T: float) -> None:
    """Its error is white and its filter an effect that a model can have."""
    sensor = Sensor(theta=ANGLE, theta_dot=SIMILAR)
    for seed in range(3):
        run = smoothed(T, seed)
        assert relied_on(JOINT, sensor.measure(run, np.random.default_rng(seed)), sensor) is sensor


def test_a_filtered_speed_that_leads_a_search_astray_is_dropped() -> None:
    """It is off by many times its error."""
    sensor = Sensor(theta=ANGLE, theta_dot=0.2 * SIMILAR)
    records = sensor.measure(smoothed(0.1, 0), np.random.default_rng(0))
    assert relied_on(JOINT, records, sensor) == Sensor(theta=ANGLE)


def test_better_speeds_stay_and_worse_ones_go() -> None:
    """There is one limit: once a speed is too noisy to be worth its risk, a noisier one is, too."""
    kept = []
    for factor in (0.1, 1.0, 2.0, 5.0, 30.0):
        sensor = Sensor(theta=ANGLE, theta_dot=factor * SIMILAR)
        kept.append(relied_on(JOINT, logs(sensor), sensor).theta_dot is not None)
    assert kept == sorted(kept, reverse=True) and kept[0] and not kept[-1]


@pytest.mark.parametrize("name", ["velocity_bias", "velocity_gain", "sensor_delay"])
def test_a_model_of_the_sensor_keeps_its_readings(name: str) -> None:
    """Whoever models the sensor asks about it, and nothing is said of it without its readings."""
    sensor = Sensor(theta=ANGLE, theta_dot=20.0 * SIMILAR)
    records = [late(r, 0.1) for r in logs(sensor)]
    assert relied_on(JOINT, records, sensor).theta_dot is None
    assert relied_on(JOINT.with_effect(effect(name)), records, sensor) is sensor


def test_one_channel_is_all_there_is() -> None:
    for sensor in (Sensor(theta=ANGLE), Sensor(theta_dot=5.0)):
        records = logs(Sensor(theta=ANGLE, theta_dot=5.0))
        assert relied_on(JOINT, records, sensor) is sensor


@pytest.mark.long
def test_a_fit_relies_on_what_a_diagnosis_relies_on() -> None:
    """The late speed of a drive bends no fit; whoever asks whether it is late gets its readings."""
    records = [late(r, 0.1) for r in logs(Sensor(theta=ANGLE, theta_dot=SIMILAR))]
    estimate = fit(JOINT, records)
    assert estimate.sensor is not None and estimate.sensor.theta_dot is None
    for name, value in estimate.values.items():
        assert abs(value - float(JOINT.parameters[name].value)) < 4.0 * estimate.sd[name], name
    bent = fit(JOINT, records, Sensor(theta=ANGLE, theta_dot=0.2 * SIMILAR))
    assert any(abs(v - float(JOINT.parameters[n].value)) > 4.0 * bent.sd[n] for n, v in bent.values.items())
    for begun in (JOINT, estimate):
        asked = add(begun, "filtered_speed", records).estimate
        assert asked.sensor is not None and asked.sensor.theta_dot is not None
        assert abs(asked.values["filtered_speed.T"] - 0.1) < 0.02
