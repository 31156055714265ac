"""Rests: what a joint at rest repeats is no evidence, and does not bend its friction."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sysid import Coulomb, GeneralJoint, Model, Record, Sensor, Viscous, simulate
from sysid.data.rests import AROUND, readings_at_rest_merged
from sysid.estimation.linearisation import Samples
from sysid.estimation.solver import fit_parameters

DT = 0.02
SENSOR = Sensor(theta=0.001)
T = DT * np.arange(500)


def record(theta: np.ndarray | None, theta_dot: np.ndarray | None = None) -> Record:
    rng, N = np.random.default_rng(0), len(theta if theta is not None else np.asarray(theta_dot)) - 1
    noisy = [None if y is None else y + 0.001 * rng.standard_normal(N + 1) for y in (theta, theta_dot)]
    return Record(DT * np.arange(N + 1), np.zeros(N), *noisy)


def repeated(rollout: Record, sensor: Sensor) -> np.ndarray:
    """At which samples no reading is left, since another one stands for it."""
    ((_, sds),) = readings_at_rest_merged([rollout], sensor)
    return np.all(np.isinf(sds), axis=1)


def test_of_a_rest_one_reading_is_kept_in_half_a_second() -> None:
    theta = np.where(T < 4.0, 0.3 * np.cos(3.0 * T), 0.3 * math.cos(12.0))
    at = repeated(record(theta), SENSOR)
    inside = (T > 4.0 + 2.0 * AROUND) & (T < 10.0 - 2.0 * AROUND)
    assert not np.any(at[T < 4.0])
    assert np.mean(~at[inside]) == pytest.approx(DT / AROUND, rel=0.4)


def test_a_motor_that_stands_at_first_stands_in_the_fit() -> None:
    """Backwards its damped motion grows without bound, up to the first reading."""
    truth = Model(GeneralJoint(J=0.1, G=0.0), (Viscous(b=3.0),), dt=DT)
    u = np.where((T[:-1] < 2.0) | (T[:-1] > 7.0), 0.0, 3.0)
    (motor,) = SENSOR.measure(simulate(truth, u, 0.0, 0.0), np.random.default_rng(0))
    motor = Record(motor.t, motor.u, motor.theta)
    assert not repeated(motor, SENSOR)[0] and np.mean(repeated(motor, SENSOR)[:50]) > 0.9
    found = fit_parameters(Samples(truth, [motor], SENSOR), truth, ("J", "viscous.b"))
    assert np.all(np.abs(found.motion.x[T < 1.5, 1]) < 0.05)


def test_what_turns_steadily_does_not_rest() -> None:
    """Neither as fast as a speed alone can tell it, nor as slowly as an angle can."""
    assert not np.any(repeated(record(None, np.full(500, 2.0)), Sensor(theta_dot=0.001)))
    assert not np.any(repeated(record(0.05 * T), SENSOR))
    assert np.any(repeated(record(None, np.where(T < 2.0, 2.0, 0.0)), Sensor(theta_dot=0.001)))


def test_readings_under_a_command_that_changes_are_no_repetitions() -> None:
    """Each says that the joint is held against another torque."""
    theta, u = np.minimum(T, 2.0), np.where(T[:-1] < 2.0, 1.0, 0.0)
    assert np.any(repeated(Record(T, u, theta), SENSOR))
    assert np.any(repeated(Record(T, np.full(499, 0.018), theta), SENSOR)), "one that never changes"
    assert not np.any(repeated(Record(T, np.where(u > 0.0, u, 0.5 * np.sin(7.0 * T[:-1])), theta), SENSOR))


def test_a_piece_of_constant_readings_is_as_rounded_as_the_whole_log() -> None:
    q = 0.003
    swing, rest = (
        Record(T, np.zeros(499), q * np.round(0.3 * y / q), name=name)
        for name, y in (("swing", np.cos(3.0 * T)), ("rest", np.ones(500)))
    )
    _, (_, sds) = readings_at_rest_merged([swing, rest], Sensor(theta=q / math.sqrt(12.0)))
    left = sds[np.isfinite(sds)]
    assert len(left) < 50
    np.testing.assert_allclose(left, q / math.sqrt(12.0), rtol=1e-3)


def test_a_speed_with_an_offset_rests_where_the_angle_does() -> None:
    both = record(np.minimum(T, 2.0), 0.4 + (T < 2.0))
    assert np.any(repeated(both, Sensor(theta=0.001, theta_dot=0.001)))


def weights(rollout: Record, sensor: Sensor) -> np.ndarray:
    """1 / sd of the angle's readings, as a fit counts them."""
    return Samples(Model(GeneralJoint(J=0.1, G=0.0), dt=DT), [rollout], sensor).weight[:, 0]


def test_a_mean_at_rest_is_as_sure_as_its_readings_together() -> None:
    weight = weights(record(np.minimum(T, 0.5)), SENSOR)
    assert np.count_nonzero(weight) < 150
    assert np.sum(weight**2) == pytest.approx(500 / SENSOR.theta**2)


def test_a_piece_of_a_log_that_does_nothing_but_rest_rests() -> None:
    """By itself it might be any slow motion."""
    swing, rest = record(0.3 * np.cos(3.0 * T)), record(np.full(500, 0.3))
    alone, beside = (
        Samples(Model(GeneralJoint(J=0.1, G=0.0), dt=DT), records, SENSOR).weight[-501:, 0]
        for records in ([rest], [swing, rest])
    )
    assert np.count_nonzero(alone) == 500 and np.count_nonzero(beside) < 100


def test_what_noise_hides_is_no_rest() -> None:
    hidden = Record(T, np.zeros(499), None, np.sin(T) + np.random.default_rng(0).standard_normal(500))
    assert not np.any(repeated(hidden, Sensor(theta_dot=1.0)))


def test_a_mean_of_rounded_readings_is_no_surer_than_rounding() -> None:
    q = 0.003
    read = Record(T, np.zeros(499), q * np.round(np.where(T < 2.0, 0.3 * np.cos(3.0 * T), 0.3 * math.cos(6.0)) / q))
    weight = weights(read, Sensor(theta=q / math.sqrt(12.0)))
    assert np.max(weight) == pytest.approx(math.sqrt(12.0) / q, rel=1e-3)


def shaken(seed: int) -> tuple[Record, int]:
    """A free swing that a white torque shakes as long as it is fast, and the sample at which it has come to rest."""
    rng, push = np.random.default_rng(seed), np.zeros((1, 1500))
    truth = Model(GeneralJoint(J=0.1, G=4.8), (Coulomb(tau_c=0.05), Viscous(b=0.012)), dt=DT)
    for _ in range(3):  # where it is fast depends on the torque, a little
        run = simulate(truth, push, np.array([0.5 * math.pi]), np.zeros(1))
        fast = np.abs(run.theta_dot[:, :-1]) > 1.0
        push = 0.3 * np.random.default_rng(seed).standard_normal(fast.shape) * fast
    swing = SENSOR.measure(simulate(truth, push, np.array([0.5 * math.pi]), np.zeros(1)), rng)[0]
    return Record(swing.t, np.zeros(len(swing)), swing.theta), int(np.flatnonzero(np.abs(run.theta_dot[0]) > 1e-3)[-1])


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_friction_is_found_however_long_the_joint_rests_afterwards(seed: int) -> None:
    """The random torque that the swing needs is not there any more, and is no measure of what holds the joint."""
    whole, moving = shaken(seed)
    assert len(whole) > moving + 360
    model = Model(GeneralJoint(J=0.1, G=4.8), (Coulomb(tau_c=0.05), Viscous(b=0.012)), dt=DT)
    estimate = fit_parameters(Samples(model, [whole], SENSOR), model, ("G", "coulomb.tau_c", "viscous.b")).estimate()
    assert abs(estimate.values["coulomb.tau_c"] - 0.05) < 3.0 * estimate.sd["coulomb.tau_c"]
