"""First fits from far off: of machines that friction rules, under torques that are no Gaussian process."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from sysid import (
    RK4,
    CoastingDrive,
    Coulomb,
    DCMotor,
    GeneralJoint,
    Model,
    PositionServo,
    Record,
    Saturation,
    Sensor,
    TorqueSpeedLimit,
    Viscous,
    diagnose,
    simulate,
)
from sysid.diagnosis.search import Search
from sysid.estimation.first_fit import (
    BLOCKS,
    COMMON,
    HORIZON,
    first_fit,
    first_fits,
    with_best_memory,
    with_common,
    without_common,
)
from sysid.estimation.initial_guess import (
    _least_inertia,
    coasting_guess,
    initial_guess,
    initial_guesses,
    limited_guess,
)
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import left_out_errors
from sysid.estimation.prediction_error import with_likely_shared_error
from sysid.estimation.scores import scores
from sysid.estimation.smoothed_start import smooth_states
from sysid.estimation.solver import HELD, fit_parameters
from sysid.estimation.torque_regression import telling_motion
from sysid.planning.excitation import multisine
from tests.sysid.planted import DT, under_control, with_memory

SENSOR = Sensor(theta=0.0005, theta_dot=0.01)
ROBOT = Model(GeneralJoint(J=0.5, G=3.0), (Viscous(b=3.0), Coulomb(tau_c=2.5)), dt=DT)
NAMES = ("J", "G", "viscous.b", "coulomb.tau_c")
TRUTH = np.array([0.5, 3.0, 3.0, 2.5])


def driven(
    frequencies: tuple[float, ...], seconds: float, rms: float, jolt: float = 0.0, seed: int = 0
) -> list[Record]:
    """The joint of a robot, a sine motion of 1 rad/s by each of these frequencies [Hz], friction fed forward.

    Its gear adds a random torque, rms [N m] and T = 0.05 s, and at each reversal a jolt [N m] along the motion.
    """
    rng, N = np.random.default_rng(seed), round(seconds / DT)
    w = 2.0 * math.pi * np.array(frequencies)[:, None]
    phase = w * DT * np.arange(N)
    theta, theta_dot, theta_ddot = math.pi + np.sin(phase) / w, np.cos(phase), -w * np.sin(phase)
    J, G, b, tau_c = TRUTH
    u = J * theta_ddot - G * np.sin(theta) + b * theta_dot + tau_c * np.tanh(theta_dot / 0.1)
    gear = with_memory(rms * rng.standard_normal(u.shape), 0.05)
    gear += jolt * np.sign(theta_dot) * (np.abs(theta_dot) < 0.06)
    run = simulate(ROBOT, u + gear, np.full(len(w), math.pi), np.ones(len(w)))
    return [dataclasses.replace(r, u=command) for r, command in zip(SENSOR.measure(run, rng), u, strict=True)]


def guessed(samples: Samples, start: Model) -> Model:
    """Inertia and gravity by regression."""
    return initial_guess(start, ("J", "G"), samples.records, samples.sensor)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_friction_far_above_gravity_and_inertia_is_found_from_a_default_joint(seed: int) -> None:
    """Neither inertia nor gravity means anything before both frictions are known."""
    records = driven((0.2, 0.4, 0.3), 7.0, 0.15, seed=seed)
    diagnosis = diagnose(Model(GeneralJoint(), dt=DT), records, SENSOR, hold_out=1)
    assert {s.effect for s in diagnosis.steps} == {"viscous", "coulomb"}
    for name, value in zip(NAMES, TRUTH, strict=True):
        assert diagnosis.estimate.values[name] == pytest.approx(value, rel=0.15)
    assert diagnosis.error.ratio < 0.2 * diagnosis.base_error.ratio


def test_the_memory_that_predicts_is_preferred_to_the_likeliest() -> None:
    """A gear that jolts at each reversal: under the likeliest memory the numbers suit the jolts."""
    records = driven((0.2, 0.3), 10.0, 0.15, jolt=2.5)
    samples = Samples(ROBOT, records, SENSOR)
    began = fit_parameters(samples, ROBOT, NAMES)
    chosen = with_best_memory(began)
    likely = with_likely_shared_error(began)
    others = [fit_parameters(samples, began.model, NAMES, began, likely.with_memory(T)) for T in (0.01, 0.1)]
    maximum_likelihood = min(others, key=lambda fit: fit.deviance)
    assert chosen.disturbances.T != maximum_likelihood.disturbances.T, (
        "the log does not tell likelihood from prediction"
    )
    gain, sd = left_out_errors(chosen, HORIZON, BLOCKS).gain(left_out_errors(maximum_likelihood, HORIZON, BLOCKS))
    assert gain > sd
    assert np.linalg.norm(chosen.values / TRUTH - 1.0) < np.linalg.norm(maximum_likelihood.values / TRUTH - 1.0)


def test_a_first_fit_ends_in_the_plain_model_with_numbers_that_friction_has_not_bent() -> None:
    start = Model(GeneralJoint(), dt=DT)
    samples = Samples(start, driven((0.2, 0.4), 7.0, 0.0), SENSOR)
    helped = with_common(samples, guessed(samples, start), ("J", "G"))
    assert {e.name for e in helped.model.effects} == {"viscous", "coulomb", "torque_bias"}
    values = [float(helped.model.parameters[n].value) for n in NAMES]
    np.testing.assert_allclose(values, TRUTH, rtol=0.02)
    plain = first_fit(samples, start, ("J", "G"))
    assert not plain.model.effects and plain.names == ("J", "G")
    assert plain.deviance > helped.deviance + 100.0


def test_friction_and_offset_as_the_first_fit_found_them_are_candidates() -> None:
    """With their numbers, all together and without the least telling."""
    start, records = Model(GeneralJoint(), dt=DT), driven((0.2, 0.4), 7.0, 0.15)
    samples, search = Samples(start, records, SENSOR), Search(records, SENSOR)
    helped = with_common(samples, guessed(samples, start), ("J", "G"))
    plain = without_common(helped, start, ("J", "G"))
    search.last = scores(plain, ("viscous", "coulomb", "torque_bias"))
    trials = search._common(plain, helped)
    assert [t.effects for t in trials] == [("viscous", "coulomb", "torque_bias"), ("viscous", "coulomb")]
    assert trials[0].fit is helped and all(t.merit > 100.0 for t in trials)


def spun_up(rms: float = 0.0) -> list[Record]:
    """A motor that turns one way, under a constant torque from rest: dry friction and an offset are one to it."""
    rng, rotor = np.random.default_rng(0), GeneralJoint(J=1e-4, G=0.0)
    truth = Model(rotor, (Viscous(b=1e-4), Coulomb(tau_c=0.03)), dt=DT)
    u = np.repeat([[0.06], [0.07], [0.065]], 200, axis=1)
    return Sensor(0.005, 0.3).measure(
        simulate(truth, u + rms * rng.standard_normal(u.shape), np.zeros(3), np.zeros(3)), rng
    )


def test_friction_and_an_offset_that_no_motion_tells_apart_do_not_run_away() -> None:
    records = spun_up(rms=0.01)
    model = Model(GeneralJoint(J=0.1, G=0.0), dt=DT)
    samples = Samples(model, records, Sensor(0.005, 0.3))
    fit = with_common(samples, initial_guess(model, ("J",), records, samples.sensor), ("J",))
    values = dict(zip(fit.names, fit.values, strict=True))
    assert values["coulomb.tau_c"] - values["torque_bias.tau_0"] == pytest.approx(0.03, rel=0.05)
    assert abs(values["coulomb.tau_c"]) < 0.7 and abs(values["torque_bias.tau_0"]) < 0.7
    assert values["J"] == pytest.approx(1e-4, rel=0.05)


def test_dry_friction_stands_for_an_offset_that_it_cannot_be_told_from() -> None:
    model = Model(GeneralJoint(J=0.1, G=0.0), dt=DT)
    diagnosis = diagnose(model, spun_up(), Sensor(0.005, 0.3), hold_out=1, parameters=("J",))
    assert {s.effect for s in diagnosis.steps} == {"viscous", "coulomb"}
    assert diagnosis.error.ratio < 1.1


def test_a_model_whose_numbers_are_all_known_is_diagnosed_too() -> None:
    """Its masses come from the scales; what is missing is asked all the same."""
    truth = Model(GeneralJoint(J=0.1, G=2.0), (Coulomb(tau_c=0.05),), dt=DT)
    rng = np.random.default_rng(0)
    theta = math.pi + rng.uniform(0.5, 1.2, 4)
    records = Sensor(0.003, 0.05).measure(simulate(truth, np.zeros((4, 300)), theta, np.zeros(4)), rng)
    model = Model(GeneralJoint(J=0.1, G=2.0), dt=DT)
    diagnosis = diagnose(model, records, Sensor(0.003, 0.05), hold_out=1, parameters=())
    assert [s.effect for s in diagnosis.steps] == ["coulomb"] and diagnosis.estimate.names == ("coulomb.tau_c",)
    assert diagnosis.estimate.values["coulomb.tau_c"] == pytest.approx(0.05, rel=0.02)


def test_the_inertia_of_a_quick_step_is_guessed() -> None:
    """Steps that a stiff loop takes in less than a tenth of a second are over before the usual span is."""
    rng, dt, (theta, theta_dot) = np.random.default_rng(0), 0.001, (0.0, 0.0)
    angles, torques = [0.0], []
    for k in range(12000):
        goal = 1.5 * (k // 500 % 2)
        torque = 25.0 * (goal - theta) - 1.0 * theta_dot
        theta_dot += dt * (torque - 0.28 * math.tanh(theta_dot / 0.01)) / 0.015
        theta += dt * theta_dot
        angles.append(theta)
        torques.append(torque)
    record = Record(dt * np.arange(12001), np.array(torques), np.array(angles) + 1e-4 * rng.standard_normal(12001))
    guess = initial_guess(Model(GeneralJoint(J=0.1, G=0.0), dt=dt), ("J",), [record], Sensor(theta=1e-4))
    assert float(guess.parameters["J"].value) == pytest.approx(0.015, rel=0.3)


@pytest.mark.long
def test_a_run_up_into_the_speed_limit_of_the_drive() -> None:
    """One ramp shows the inertia, though not surely, and then the drive gives no more than friction takes."""
    rng = np.random.default_rng(0)
    limit = TorqueSpeedLimit(limit=4.0, k=0.15)
    machine = Model(GeneralJoint(J=0.016, G=0.0), (Coulomb(tau_c=0.2), limit), RK4(substeps=4), dt=0.01)
    u = np.where(np.arange(500) < 100, 0.0, np.array([[1.0], [0.8]]))
    records = Sensor(theta=5e-4).measure(simulate(machine, u, np.zeros(2), np.zeros(2)), rng)
    diagnosis = diagnose(Model(GeneralJoint(G=0.0), integrator=RK4(substeps=4), dt=0.01), records, parameters=("J",))
    assert "torque_speed_limit" in {s.effect for s in diagnosis.steps}
    values = diagnosis.estimate.values
    assert values["J"] == pytest.approx(0.016, rel=0.1)
    assert values["torque_speed_limit.limit"] / values["torque_speed_limit.k"] == pytest.approx(4.0 / 0.15, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("coasts", [True, False])
def test_a_drive_that_lets_the_joint_coast_is_told_from_one_that_brakes_it(coasts: bool) -> None:
    """It runs up within 0.1 s and coasts for seconds: one inertia and one friction explain either, but not both."""
    rng, dt = np.random.default_rng(0), 0.01
    drive = (DCMotor(k_e=0.02), CoastingDrive(k=0.4)) if coasts else (DCMotor(k_e=0.42),)
    machine = Model(GeneralJoint(J=0.04, G=0.0), (*drive, Coulomb(tau_c=0.15)), RK4(substeps=2), dt)
    commands = np.repeat(np.array([[2.0, 0.0, -2.0, 0.0, 1.5, 0.0], [-1.5, 0.0, 2.0, 0.0, -2.0, 0.0]]), 200, axis=1)
    records = Sensor(theta=0.002).measure(simulate(machine, commands, np.full(2, math.pi), np.zeros(2)), rng)
    start = Model(GeneralJoint(G=0.0), (DCMotor(),), RK4(substeps=2), dt)
    guess = coasting_guess(start, ("J", "dc_motor.k_e"), records, Sensor(theta=0.002))
    assert (guess is not None) == coasts
    diagnosis = diagnose(start, records, parameters=("J", "dc_motor.k_e"))
    assert {s.effect for s in diagnosis.steps} == ({"coulomb", "coasting_drive"} if coasts else {"coulomb"}), str(
        diagnosis
    )
    values, sd = diagnosis.estimate.values, diagnosis.estimate.sd
    for name, value in {n: float(p.value) for n, p in machine.parameters.items() if n in values}.items():
        assert values[name] == pytest.approx(value, abs=4.0 * sd[name]), name


def test_a_motor_of_ten_thousand_units_is_followed_without_a_bias() -> None:
    """Its speed counts encoder steps, say, and is noisy by tens of them; it stands for a second and runs for one."""
    rng, dt = np.random.default_rng(0), 0.005
    t = dt * np.arange(401)
    speed = np.where(t > 1.0, 13_000.0 * (1.0 - np.exp(-(t - 1.0) / 0.1)), 0.0)
    record = Record(t, np.zeros(400), None, speed + 25.0 * rng.standard_normal(401))
    theta_dot = smooth_states(record, Sensor(None, 25.0))[:, 1]
    for part in (t < 0.9, t > 1.8):
        assert abs(np.mean(theta_dot[part] - speed[part])) < 10.0


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_a_motor_that_answers_within_a_sample_shows_its_back_emf(seed: int) -> None:
    """Its inertia takes next to nothing of the voltage; begun at a large one, a random torque would move it instead.

    Rows that tell a voltage of half a sample ago make a regression's inertia negative.
    """
    rng, dt = np.random.default_rng(seed), 0.007
    t = dt * np.arange(400)
    u = 0.25 * np.sin(2.0 * math.pi * (1.0 + 0.5 * t) * t)[None]
    fine = Model(GeneralJoint(J=2.6e-5, G=0.0), (DCMotor(k_e=0.0087),), RK4(substeps=40), dt)
    rollout = Sensor(theta=0.0015).measure(simulate(fine, u, np.full(1, math.pi), np.zeros(1)), rng)[0]
    theta = np.asarray(rollout.theta)
    records = [Record(rollout.t[:-1], rollout.u[:-1], 0.5 * (theta[:-1] + theta[1:]))]
    start = Model(GeneralJoint(G=0.0), (DCMotor(),), RK4(substeps=4), dt)
    names = ("J", "dc_motor.k_e")
    fit = first_fit(Samples(start, records, Sensor(theta=0.0015)), start, names)
    assert fit.values[0] < 2e-4
    assert fit.values[1] == pytest.approx(0.0087, rel=0.03)


@pytest.mark.parametrize(("torque", "G"), [(0.018, 0.09), (0.018, 1.0), (0.1, 1.0), (1.0 / 3.0, 1.0)])
def test_a_torque_that_never_changes_shows_an_inertia_and_no_friction(torque: float, G: float) -> None:
    """It moves the middle about which a weight swings; what rounding leaves of its changes explains nothing."""
    held = np.full((1, 600), torque)
    machine = Model(GeneralJoint(J=0.021, G=G), (Viscous(b=0.002),), dt=DT)
    records = SENSOR.measure(simulate(machine, held, np.full(1, math.pi), np.zeros(1)), np.random.default_rng(0))
    guess = initial_guess(Model(GeneralJoint(), dt=DT), ("J", "G"), records, SENSOR)
    np.testing.assert_allclose([guess.plant.parameters[n].value for n in ("J", "G")], [0.021, G], rtol=0.1)
    assert _least_inertia(telling_motion(machine, ("J", "G"), records, SENSOR)) == {}


def asked_for(gain: float, seed: int, limit: float = 5.0) -> Record:
    """A joint that a controller steps to and fro; the log has what it asked for, which the driver limits."""
    rng, n, dt = np.random.default_rng(seed), 1500, 0.02
    effects = (Viscous(b=1.5), Coulomb(tau_c=0.4), Saturation(limit=limit))
    truth = Model(GeneralJoint(J=0.25, G=0.0), effects, dt=dt)
    target = math.pi + np.repeat(rng.uniform(-1.0, 1.0, n // 100), 100)
    asked, exact = lambda k, theta, theta_dot: gain * (target[k] - theta - 0.1 * theta_dot), np.zeros((n + 1, 2))
    u, x = under_control(truth, asked, math.pi, exact)
    return Record(dt * np.arange(n + 1), u, x[:, 0] + 1e-3 * rng.standard_normal(n + 1), name="asked for")


@pytest.mark.parametrize("seed", range(4))
def test_a_limit_far_below_the_commands_is_guessed_with_the_inertia_that_goes_with_it(seed: int) -> None:
    plain, sensor = Model(GeneralJoint(G=0.0), dt=0.02), Sensor(theta=1e-3)
    for gain in (15.0, 30.0):
        guess = limited_guess(plain, ("J",), [asked_for(gain, seed)], sensor)
        assert guess is not None
        assert float(guess.inertia()) == pytest.approx(0.25, rel=0.3)
        assert float(guess.parameters["saturation.limit"].value) == pytest.approx(5.0, rel=0.3)
        assert limited_guess(plain, ("J",), [asked_for(gain, seed, limit=100.0)], sensor) is None
        assert limited_guess(guess, ("J",), [asked_for(gain, seed)], sensor) is None, "it has one"


@pytest.mark.long
@pytest.mark.parametrize(("gain", "seed"), [(15.0, 1), (30.0, 0)])
def test_a_limit_that_is_reached_nearly_always_is_no_inertia(gain: float, seed: int) -> None:
    diagnosis = diagnose(Model(GeneralJoint(G=0.0), dt=0.02), [asked_for(gain, seed)], parameters=("J",))
    assert {s.effect for s in diagnosis.steps} == {"viscous", "coulomb", "saturation"}
    for name, value in {"J": 0.25, "viscous.b": 1.5, "coulomb.tau_c": 0.4, "saturation.limit": 5.0}.items():
        assert diagnosis.estimate.values[name] == pytest.approx(value, rel=0.02)


def test_first_fits_free_what_was_asked_for_and_common_effects_and_nothing_else() -> None:
    """The gain of a servo is known, wherever its loop is guessed to be."""
    servo = PositionServo(k_p=20.0, k_d=2.0)
    machine = Model(GeneralJoint(J=0.05, G=0.0), (servo, Coulomb(tau_c=0.3)), RK4(10), dt=DT)
    u = multisine(np.random.default_rng(0), 300, DT, 1.0, 1.0)
    run = simulate(machine, u, u[0], 0.0)
    (record,) = SENSOR.measure(run, np.random.default_rng(1))
    start = Model(GeneralJoint(J=0.05, G=0.0), (PositionServo(k_p=20.0),), RK4(10), dt=DT)
    names = ("J", "position_servo.k_d")
    fits = first_fits(Samples(start, [record], SENSOR), start, names)
    assert fits
    for fit in fits:
        assert {fit.model.parameters[n].owner for n in set(fit.names) - set(names)} <= set(COMMON)


def test_two_guesses_of_a_servo_whose_inertia_is_known_are_two_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """They end at the same inertia, and at other gains."""
    machine = Model(GeneralJoint(J=0.05, G=0.0), (PositionServo(k_p=20.0, k_d=2.0),), RK4(10), dt=DT)
    u = multisine(np.random.default_rng(0), 300, DT, 1.0, 1.0)
    (record,) = SENSOR.measure(simulate(machine, u, u[0], 0.0), np.random.default_rng(1))
    start = Model(GeneralJoint(J=0.05, G=0.0), (PositionServo(),), RK4(10), dt=DT)
    samples, names = Samples(start, [record], SENSOR), ("position_servo.k_p", "position_servo.k_d")
    guesses = initial_guesses(start, names, [record], SENSOR)
    monkeypatch.setattr(
        "sysid.estimation.first_fit.with_common",
        lambda _, begun, free: fit_parameters(samples, begun, (), settings=HELD),
    )
    gains = [float(fit.model.parameters["position_servo.k_p"].value) for fit in first_fits(samples, start, names)]
    assert gains == [float(guess.parameters["position_servo.k_p"].value) for guess in guesses]
