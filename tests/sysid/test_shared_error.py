"""An error that neighbouring readings share, as on a film or of a coarse encoder's speed: it is no missing torque."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid import RK4, GeneralJoint, LinearAxis, Model, Record, Sensor, diagnose, effect, simulate, write_report
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.first_fit import with_best_memory
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import fitted_error, widened_sensor
from sysid.estimation.prediction_error import Fit, with_likely_shared_error, with_smooth_error
from sysid.estimation.solver import Settings, fit_parameters, large_disturbances
from sysid.physics.ops import Array
from sysid.physics.simulate import Trajectory
from tests.sysid.planted import accelerated

DT, NOISE, SHARED = 0.08, 6e-4, 0.0136
ALONE = Settings(shared_error=False)
HANGING = GeneralJoint(J=0.1, G=0.925)
MACHINE = Model(HANGING, (effect("drag", c=4e-4),), RK4(substeps=4), DT)


@cache
def swing_of(model: Model, seconds: float) -> Trajectory:
    """A swing from 80 degrees."""
    return simulate(model, np.zeros(round(seconds / model.dt)), math.pi + 1.4, 0.0)


def filmed(seconds: float, T_o: float, seed: int) -> Record:
    """A swing from 80 degrees, of which a film tells the angle with an error that is correlated over T_o [s]."""
    rng, kept = np.random.default_rng(seed), math.exp(-DT / T_o)
    swing = swing_of(MACHINE, seconds)
    steps = SHARED * math.sqrt(1.0 - kept**2) * rng.standard_normal(len(swing.t))
    error = lfilter([1.0], [1.0, -kept], steps) + NOISE * rng.standard_normal(len(swing.t))
    return Record(swing.t, swing.u, swing.theta + error)


def smooth_error(rng: np.random.Generator, t: Array, T_f: float, size: float) -> Array:
    """A smooth error at the times t (M,) [s], of the covariance that defines it."""
    a = 2.0 * np.abs(t[:, None] - t) / T_f
    root = np.linalg.cholesky((1.0 + a) * np.exp(-a) + 1e-9 * np.eye(len(a)))
    return np.asarray(size * root @ rng.standard_normal(len(a)))


def smoothly_filmed(model: Model, seconds: float, T_f: float, seed: int, size: float = 5e-3) -> Record:
    """A swing from 80 degrees, and a film's angle of it with a smooth error of the covariance that defines it."""
    rng, swing = np.random.default_rng(seed), swing_of(model, seconds)
    error = smooth_error(rng, swing.t, T_f, size) + NOISE * rng.standard_normal(len(swing.t))
    return Record(swing.t, swing.u, swing.theta + error)


def fitted(record: Record) -> Fit:
    """The machine fitted to a record whose sensor's noise is known."""
    names = ("G", "drag.c")
    beside = fit_parameters(Samples(MACHINE, [record], Sensor(theta=NOISE)), MACHINE, names)
    return fit_parameters(beside.samples, MACHINE, names, beside, with_likely_shared_error(beside))


@pytest.mark.parametrize(("T_o", "seconds"), [(0.03, 2.0), (0.3, 20.0), (1.0, 2.0)])
def test_the_sensors_noise_is_widened_to_what_predictions_err_by(T_o: float, seconds: float) -> None:
    """Predictions of a right model err by 1 in its units, though the refitted start absorbs much of a slow error."""
    fits = [fitted(filmed(120.0, T_o, seed)) for seed in range(3)]
    sensors = [widened_sensor(fit, seconds) for fit in fits]
    assert all(NOISE < sensor.theta < 1.3 * SHARED for sensor in sensors if sensor.theta is not None)
    errors = [fitted_error(fit, seconds, sensor) for fit, sensor in zip(fits, sensors, strict=True)]
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.15), errors


def test_beside_a_random_torque_or_under_commands_it_is_not() -> None:
    model = Model(HANGING, (effect("viscous", b=0.05),), RK4(substeps=2), 0.02)
    (pushed,), fit = accelerated(model, 1, 1500, 0.5, 0.3)[1], fitted(filmed(40.0, 0.3, 0))
    (swing,) = fit.samples.records
    for record, machine in ((replace(pushed, u=0.0 * pushed.u), model), (replace(swing, u=swing.u + 1e-9), MACHINE)):
        samples = Samples(machine, [record], fit.samples.sensor)
        assert widened_sensor(fit_parameters(samples, machine, ("G",)), 1.0) == samples.sensor


@pytest.mark.parametrize("T_f", [0.1, 0.3, 1.0])
def test_a_smooth_error_is_told_from_a_random_torque(T_f: float) -> None:
    """Its size is found, no random torque stands for it, and predictions of a right model err by 1."""
    fits = []
    for seed in range(3):
        record = smoothly_filmed(MACHINE, 80.0, T_f, seed)
        beside = fit_parameters(Samples(MACHINE, [record], Sensor(theta=NOISE)), MACHINE, ("G", "drag.c"))
        fits.append(fit_parameters(beside.samples, MACHINE, beside.names, beside, with_smooth_error(beside)))
    for fit in fits:
        assert fit.likeliest_torque.s == 0.0 and fit.disturbances.T_f == T_f
        assert fit.disturbances.sigma_f == pytest.approx(5e-3, rel=0.3)
    errors = [fitted_error(f, 2.0, widened_sensor(f, 2.0)) for f in fits]
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.15), errors


def test_a_smooth_error_is_a_stationary_process_of_the_covariance_that_defines_it() -> None:
    """Two steps are one of twice the length, and k steps leave of the variance what the covariance says."""
    error = Disturbances(0.0, sigma_f=0.4, T_f=0.25)
    (once, _, start), (twice, grown, _) = error.discrete(0.02), error.discrete(0.04)
    np.testing.assert_allclose(once @ once, twice, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(twice * start @ twice.T + grown, np.diag(start), rtol=1e-12, atol=1e-15)
    kept = [np.linalg.matrix_power(once, k)[2, 2] * start[2] for k in range(40)]
    np.testing.assert_allclose(kept, error.shared_variance(0.02 * np.arange(40)), rtol=1e-9)


def test_a_joint_that_rests_most_of_the_time_is_read_by_its_angle_all_the_same() -> None:
    """Half a second at rest is one reading: fewer than half of the instants have one then."""
    t = 0.02 * np.arange(2001)
    theta = np.sin(2.0 * np.pi * np.minimum(t, 8.0)) + 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    record, wheel = Record(t=t, u=np.zeros(2000), theta=theta), Model(GeneralJoint(), dt=0.02)
    samples = Samples(wheel, [record], Sensor(theta=1e-3), speeds_share=True)
    assert np.mean(samples.weight[:, 0] > 0.0) < 0.5, "no rest was merged: the law says nothing"
    assert not samples.error_channel, "no speed was read that could share an error"
    assert large_disturbances(samples).sigma_o > 0.0


def test_a_smooth_error_of_speeds_is_told_from_a_random_torque() -> None:
    """A wheel is pushed to and fro by 0.3 N m, and its speed is read with an error of 0.5 rad/s that is smooth over
    0.3 s. A random torque, with which the fit begins, accumulates: beside it the frictions are less sure."""
    wheel = Model(GeneralJoint(J=0.1, G=0.0), (effect("coulomb", tau_c=0.04), effect("drag", c=4e-5)), RK4(2), 0.02)
    u = 0.3 * np.sign(np.sin(0.4 * np.arange(1200) * 0.02 * np.arange(1200) / 1200.0 + 0.1))
    pushed = simulate(wheel, u, 0.0, 10.0)
    names, truth, z = ("coulomb.tau_c", "drag.c"), np.array([0.04, 4e-5]), list[Array]()
    for rng in map(np.random.default_rng, range(4)):
        error = smooth_error(rng, pushed.t, 0.3, 0.5) + 0.05 * rng.standard_normal(1201)
        record = Record(t=pushed.t, u=pushed.u, theta_dot=pushed.theta_dot + error)
        samples = Samples(wheel, [record], Sensor(theta_dot=0.05), speeds_share=True)
        beside = fit_parameters(samples, wheel, names, disturbances=Disturbances(3.0, 0.1), settings=ALONE)
        fit = with_best_memory(beside)
        assert fit.deviance < beside.deviance - 20.0
        assert fit.disturbances.sigma_f == pytest.approx(0.5, rel=0.3) and fit.disturbances.T_f == 0.3
        sds = [np.sqrt(np.diag(f.covariance)) for f in (fit, beside)]
        assert np.all(1.2 * sds[0] < sds[1])
        z.append((fit.values - truth) / sds[0])
    assert np.mean(np.square(z)) < 3.0


@pytest.mark.parametrize("seed", range(2))
def test_a_motion_that_the_model_lacks_is_no_error_of_its_readings(seed: int) -> None:
    """A mass swings on a spring, and the model has none: an error as large as the motion would explain all of it."""
    rng, free = np.random.default_rng(seed), Model(LinearAxis(m=1.0), (), RK4(substeps=2), 0.02)
    spring = free.with_effect(effect("spring", k=110.0)).with_effect(effect("viscous", b=0.17))
    swing = simulate(spring, np.zeros(1000), 0.05, 0.0)
    rough = lfilter([1.0], [1.0, -0.8], 3e-3 * rng.standard_normal(len(swing.t)))
    answer = diagnose(free, [Record(swing.t, swing.u, swing.theta + rough)], effects=("spring", "viscous"))
    assert "spring" in {step.effect for step in answer.steps}, answer
    assert answer.estimate.values["spring.k"] == pytest.approx(110.0, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_two_frictions_of_a_swing_are_named_beside_a_smooth_error(seed: int) -> None:
    """A random torque in its place hides that there are two: one of them stands for both."""
    plain = Model(HANGING, (), RK4(substeps=2), 0.05)
    truth = plain.with_effect(effect("viscous", b=1.2e-3)).with_effect(effect("drag", c=2.2e-3))
    answer = diagnose(plain, [smoothly_filmed(truth, 120.0, 0.3, seed)], parameters=("G",))
    assert {step.effect for step in answer.steps} == {"viscous", "drag"} and answer.verdict == "missing", answer
    for name, number in (("viscous.b", 1.2e-3), ("drag.c", 2.2e-3)):
        assert abs(answer.estimate.values[name] - number) < 4.0 * answer.estimate.sd[name]
    assert answer.shared_error == pytest.approx(5e-3, rel=0.3) and not answer.contacts


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_damping_of_a_filmed_swing_is_named_and_nobody_touched_it(seed: int, tmp_path: Path) -> None:
    """Over five periods viscous friction predicts it about as well; until the amplitude has halved it does not."""
    plain = Model(HANGING, (), MACHINE.integrator, DT)
    answer = diagnose(plain, [filmed(200.0, 0.3, seed)], parameters=("G",))
    assert [step.effect for step in answer.steps] == ["drag"] and answer.verdict == "missing", answer
    assert answer.shared_error == pytest.approx(SHARED, rel=0.25) and not answer.contacts
    assert "share an error of 0.01" in str(answer)
    write_report(answer, tmp_path / "report.html")
    assert "It stands for this: neighbouring readings" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert abs(answer.estimate.values["drag.c"] - 4e-4) < 4.0 * answer.estimate.sd["drag.c"]


@pytest.mark.long
@pytest.mark.parametrize("bent", [0.02, 0.08])
def test_a_films_perspective_is_no_pair_of_zeros_that_make_up_for_each_other(bent: float) -> None:
    """The angle is read `bent` a^2 too large. A base that leans, against an offset, bends it alike."""
    model = Model(GeneralJoint(J=0.1, G=1.735), (effect("viscous", b=6e-4),), RK4(substeps=2), 1.0 / 30.0)
    swing = simulate(model, np.zeros(1650), math.pi + 0.24, 0.0)
    a, noise = swing.theta - math.pi, 3e-4 * np.random.default_rng(0).standard_normal(len(swing.t))
    record = Record(swing.t, swing.u, swing.theta + bent * a**2 + noise)
    answer = diagnose(model.without_effect("viscous"), [record], parameters=("G",))
    named = {step.effect for step in (*answer.steps, *answer.conventions)}
    assert "viscous" in named and named <= {"viscous", "tilt", "torque_bias", "angle_offset"} and len(named) < 3, answer
    assert answer.estimate.values["viscous.b"] == pytest.approx(6e-4, rel=0.1)
    assert answer.estimate.values["G"] == pytest.approx(1.735, rel=2e-3)
