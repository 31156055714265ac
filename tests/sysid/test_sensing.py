"""What sensors make of the state: offsets and scales, a late reading, play."""

import math

import numpy as np
import pytest

from sysid import (
    RK4,
    AngleOffset,
    Backlash,
    Eccentricity,
    FilteredSpeed,
    InvalidInput,
    LeastSquares,
    LinearAxis,
    Model,
    RodPendulum,
    Sensor,
    SensorDelay,
    VelocityBias,
    VelocityGain,
    diagnose,
    simulate,
)
from sysid.physics.effects import Reading
from sysid.planning.excitation import multisine
from tests.sysid.planted import SENSOR, assert_named, assert_recovered, logs, rod, truth

ROD = RodPendulum(m=1.3, l=0.9)
U = multisine(np.random.default_rng(0), 400, 0.02, 2.0, 3.0)


def watch(effect, theta, theta_dot, dt):
    """Readings (2, N+1) of a given motion."""
    memory, readings = effect.rest(theta[0], theta_dot[0], dt), []
    for k, state in enumerate(zip(theta, theta_dot, strict=True)):
        reading, memory = effect.read(Reading(*state), memory, k * dt, dt)
        readings.append(reading)
    return np.array(readings).T


def test_sensors_do_not_move_the_joint():
    plain = simulate(Model(ROD, dt=0.02), U, 2.0, 0.3)
    effects = (AngleOffset(offset=0.1), VelocityBias(bias=0.2), VelocityGain(c=1.1), Backlash(width=0.1))
    run = simulate(Model(ROD, (*effects, SensorDelay(T=0.03)), dt=0.02), U, 2.0, 0.3)
    np.testing.assert_array_equal(run.theta, plain.theta)
    np.testing.assert_array_equal(run.theta_dot, plain.theta_dot)


@pytest.mark.parametrize(
    ("effect", "theta", "theta_dot"),
    [
        (AngleOffset(offset=0.1), lambda run: run.theta + 0.1, lambda run: run.theta_dot),
        (VelocityBias(bias=0.2), lambda run: run.theta, lambda run: run.theta_dot + 0.2),
        (VelocityGain(c=1.1), lambda run: run.theta, lambda run: 1.1 * run.theta_dot),
    ],
)
def test_electronics_act_on_their_own_channel(effect, theta, theta_dot):
    run = simulate(Model(ROD, (effect,), dt=0.02), U, 2.0, 0.3)
    np.testing.assert_allclose(run.theta_read, theta(run), atol=1e-14)
    np.testing.assert_allclose(run.theta_dot_read, theta_dot(run), atol=1e-14)


def test_a_delay_of_the_sensors_shows_only_under_a_command():
    """In a free swing it is another clock, which the state at the begin allows for."""
    t = 0.01 * np.arange(301)
    late, theta = SensorDelay(T=0.1), np.cos(5.0 * t)
    assert late.recurrences(theta, t, np.zeros(300)) == 0.0
    assert late.recurrences(theta, t, np.sin(t[:-1])) == math.inf


@pytest.mark.parametrize("k", [0, 1, 4])
def test_a_sensor_delay_of_whole_samples_shows_the_state_of_then(k):
    run = simulate(Model(ROD, (SensorDelay(T=k * 0.02),), dt=0.02), U, 2.0, 0.3)
    np.testing.assert_allclose(run.theta_read[k:], run.theta[: len(U) + 1 - k], atol=1e-12)
    np.testing.assert_allclose(run.theta_dot_read[k:], run.theta_dot[: len(U) + 1 - k], atol=1e-11)


@pytest.mark.parametrize("T", [0.0, 0.003, 0.013, 0.02, 0.0317, 0.1, 0.2])
def test_a_late_reading_of_a_cubic_motion_is_exact(T):
    dt = 0.02
    t = dt * np.arange(60)
    path = np.polynomial.Polynomial([0.3, -1.0, 2.0, 1.5])
    speed = path.deriv()
    theta, theta_dot = watch(SensorDelay(T=T), path(t), speed(t), dt)
    known = t >= 0.2 - 1e-9
    np.testing.assert_allclose(theta[known], path(t - T)[known], atol=1e-12)
    np.testing.assert_allclose(theta_dot[known], speed(t - T)[known], atol=1e-11)


def test_before_its_log_a_joint_moved_at_its_first_speed():
    theta, theta_dot = watch(SensorDelay(T=0.05), np.full(3, 1.0), np.full(3, 2.0), 0.02)
    assert (theta[0], theta_dot[0]) == pytest.approx((1.0 - 0.05 * 2.0, 2.0))


def test_a_late_reading_between_instants_converges_with_fourth_order():
    errors, steps = [], [0.08, 0.04, 0.02]
    for dt in steps:
        t = dt * np.arange(round(4.0 / dt))
        theta, _ = watch(SensorDelay(T=0.55 * dt), np.sin(3.0 * t), 3.0 * np.cos(3.0 * t), dt)
        errors.append(np.max(np.abs(theta - np.sin(3.0 * (t - 0.55 * dt)))[1:]))
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.15)


def test_play_follows_a_triangle_with_its_known_loop():
    width, dt = 0.2, 0.01
    up = np.arange(0.0, 1.0, dt)
    theta = np.concatenate([up, 1.0 - up, up])
    theta_dot = np.concatenate([np.ones(100), -np.ones(100), np.ones(100)])
    y, y_dot = watch(Backlash(width=width), theta, theta_dot, dt)
    expected = np.concatenate([np.maximum(up - 0.1, 0.0), np.minimum(0.9, 1.1 - up), np.maximum(up - 0.1, 0.1)])
    np.testing.assert_allclose(y, expected, atol=1e-12)
    inside = np.abs(y - theta) < 0.5 * width - 1e-9
    np.testing.assert_array_equal(y_dot[inside], 0.0)
    moved = np.abs(np.diff(y, prepend=y[0])) > 0.5 * dt
    np.testing.assert_array_equal(y_dot[moved], theta_dot[moved])


def test_play_stays_within_its_width_and_moves_only_in_touch():
    run = simulate(Model(ROD, (Backlash(width=0.3),), dt=0.02), U, 2.0, 0.3)
    behind = run.theta_read - run.theta
    assert behind[0] == 0.0
    assert np.max(np.abs(behind)) == pytest.approx(0.15)
    still = np.abs(behind)[1:] < 0.15 - 1e-9
    assert np.any(still)
    np.testing.assert_allclose(np.diff(run.theta_read)[still], 0.0, atol=1e-12)
    assert set(np.unique(run.theta_dot_read[1:][still])) == {0.0}


@pytest.mark.parametrize("step", [0.001, 0.004])
def test_what_rounding_may_be_is_no_play(step):
    """What play of half a step changes, a quarter of a step, is less than the sd of what rounding does."""
    sd = step / math.sqrt(12.0)
    plays = {width: Backlash(width=width * step).resolved(sd, 1.0, None) for width in (0.3, 0.5, 1.0, 2.0)}
    assert plays == {0.3: False, 0.5: False, 1.0: True, 2.0: True}


def test_play_forgets_the_pace():
    """A play operator is rate-independent: only the turning points count."""
    s = np.linspace(0.0, 1.0, 301)
    path = [np.sin(8.0 * warp) * (1.0 - 0.5 * warp) for warp in (s, s**2, 2.0 * s - s**2)]
    ends = [watch(Backlash(width=0.2), theta, 0.0 * theta, 0.01)[0][-1] for theta in path]
    np.testing.assert_allclose(ends, ends[0], atol=2e-3)


def test_mechanics_come_before_timing_and_electronics():
    effects = (VelocityGain(c=2.0), SensorDelay(T=0.02), Backlash(width=0.1))
    model = Model(LinearAxis(m=1.0), effects, dt=0.02)
    assert [e.name for e in model.output_effects] == ["backlash", "sensor_delay", "velocity_gain"]
    run = simulate(model, np.zeros(20), 0.0, 1.0)
    np.testing.assert_allclose(run.theta_read[5:], run.t[5:] - 0.05 - 0.02, atol=1e-12)


def test_readings_are_measured_and_not_the_states():
    run = simulate(Model(ROD, (AngleOffset(offset=0.5),), dt=0.02), np.zeros(4000), math.pi, 0.0)
    (record,) = Sensor(theta=0.01).measure(run, np.random.default_rng(0))
    assert np.mean(record.theta) == pytest.approx(math.pi + 0.5, abs=4.5 * 0.01 / math.sqrt(4000))


def test_what_compares_states_refuses_a_sensor_in_between():
    model = Model(ROD, (SensorDelay(),), RK4(), dt=0.02)
    (record,) = Sensor(0.01, 0.1).measure(simulate(model, U, 2.0, 0.3), np.random.default_rng(0))
    with pytest.raises(InvalidInput, match="LeastSquares compares readings with the state, but sensor_delay stands"):
        LeastSquares(("m",), Sensor(0.01, 0.1)).fit(model, [record])


# a disc beside its centre --------------------------------------------------------------------------------------

ECCENTRIC = Eccentricity(a=0.03, b=-0.02)


def test_an_eccentric_disc_reads_a_wave_a_turn_and_its_derivative():
    t = 0.01 * np.arange(400)
    theta, theta_dot = watch(ECCENTRIC, 3.0 * t, np.full(400, 3.0), 0.01)
    np.testing.assert_allclose(theta, 3.0 * t + 0.03 * np.sin(3.0 * t) - 0.02 * np.cos(3.0 * t), atol=1e-14)
    np.testing.assert_allclose(np.diff(theta), 0.01 * 0.5 * (theta_dot[1:] + theta_dot[:-1]), atol=1e-6)


def test_an_eccentric_disc_comes_back_with_every_turn():
    t = np.linspace(0.0, 10.0, 500)
    assert ECCENTRIC.recurrences(4.0 * np.pi * t / 10.0, t, t) == pytest.approx(2.0)
    assert ECCENTRIC.recurrences(np.pi + 0.5 * np.sin(40.0 * t), t, t) == pytest.approx(1.0 / (2.0 * np.pi), rel=1e-3)


@pytest.mark.long
def test_an_eccentric_disc_is_found_and_named_where_the_joint_turns():
    records = logs(truth(ECCENTRIC), spin=9.0)
    assert_recovered(ECCENTRIC, records)
    assert_named(ECCENTRIC, records)


@pytest.mark.long
def test_where_the_joint_does_not_turn_nobody_speaks_of_an_eccentric_disc():
    diagnosis = diagnose(rod(), logs(truth(ECCENTRIC)), SENSOR)
    assert "eccentricity" not in {s.effect for s in diagnosis.steps}


# a speed that the drive smooths ----------------------------------------------------------------------------------


@pytest.mark.parametrize("T", [0.0, 1e-12, 0.004, 0.03, 0.7])
def test_a_filtered_ramp_is_late_by_its_time_constant(T):
    """Of theta_dot = c t the filter shows  c (t - T (1 - exp(-t/T)))."""
    t = 0.02 * np.arange(100)
    theta, w = watch(FilteredSpeed(T=T), 1.5 * t**2, 3.0 * t, 0.02)
    np.testing.assert_array_equal(theta, 1.5 * t**2)
    np.testing.assert_allclose(w, 3.0 * (t + T * np.expm1(-t / max(T, 1e-300))), atol=1e-12)


@pytest.mark.parametrize(
    "effect",
    [FilteredSpeed(T=0.037), SensorDelay(T=0.05), *(Backlash(width=width) for width in (0.0, 0.03, 0.4, 1.0))],
    ids=lambda e: e.name,
)
def test_a_whole_record_is_read_as_instant_by_instant(effect):
    rng = np.random.default_rng(0)
    theta, theta_dot = np.cumsum(0.1 * rng.standard_normal((3, 77)), axis=-1), rng.standard_normal((3, 77))
    whole = effect.whole(Reading(theta, theta_dot), np.zeros((3, 77)), 0.02)
    for row in range(3):
        shown = watch(effect, theta[row], theta_dot[row], 0.02)
        np.testing.assert_allclose(whole.theta[row], shown[0], atol=1e-14)
        np.testing.assert_allclose(whole.theta_dot[row], shown[1], atol=1e-12)


FILTERED = FilteredSpeed(T=0.03)


@pytest.mark.long
def test_a_filter_of_the_speed_is_found_and_is_no_delay_of_the_sensor():
    records = logs(truth(FILTERED))
    assert_recovered(FILTERED, records)
    diagnosis = assert_named(FILTERED, records)
    assert diagnosis.sensor.theta_dot == SENSOR.theta_dot, "its speed was left out"
    assert "sensor_delay" not in diagnosis.steps[0].indistinguishable


@pytest.mark.long
def test_a_delay_of_both_readings_is_no_filter():
    assert_named(SensorDelay(T=0.03), logs(truth(SensorDelay(T=0.03))))


@pytest.mark.parametrize("effect", [FILTERED, SensorDelay(T=0.03)], ids=lambda e: e.name)
def test_a_speed_alone_tells_how_late_it_is(effect):
    """By filters and delays together; which of them it is takes more than this log."""
    sensor = Sensor(theta_dot=0.05)
    diagnosis = diagnose(rod(), logs(truth(effect), sensor=sensor), sensor)
    late = {"filtered_speed", "sensor_delay", "delay", "lag"}
    assert diagnosis.steps and {s.effect for s in diagnosis.steps} <= late
    assert sum(p["value"] for s in diagnosis.steps for p in s.parameters.values()) == pytest.approx(0.03, abs=0.004)


def test_a_motion_that_runs_away_is_no_error_of_the_sensor() -> None:
    """A candidate's may, in one window of several: the others are read as ever."""
    theta_dot = np.array([[1.0, 2.0, np.inf, np.inf], [1.0, 2.0, 3.0, 4.0]])
    model = Model(ROD, (FilteredSpeed(T=0.05),), dt=0.02)
    both, alone = (model.read_record(0.0 * x, x, 0.0 * x)[1] for x in (theta_dot, theta_dot[1:]))
    assert not np.all(np.isfinite(both[0]))
    np.testing.assert_array_equal(both[1], alone[0])
