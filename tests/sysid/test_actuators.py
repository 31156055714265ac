"""A command that is no torque: a current, a voltage, the position that a servo was told."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from sysid import (
    RK4,
    BackEmf,
    Coulomb,
    DCMotor,
    Delay,
    Drag,
    Effect,
    GeneralJoint,
    InvalidInput,
    Lag,
    LinearAxis,
    LoadFriction,
    Model,
    PositionServo,
    Record,
    Saturation,
    Sensor,
    TorqueConstant,
    TorqueSpeedLimit,
    Viscous,
    diagnose,
    fit,
    load,
    read,
    save,
    simulate,
)
from sysid.estimation.first_fit import first_fit
from sysid.estimation.initial_guess import initial_guesses
from sysid.estimation.linearisation import LinearisedModel, Samples, smoothed_motion
from sysid.estimation.scores import scores
from sysid.physics.parameters import Extent
from sysid.planning.excitation import multisine, steps

SENSOR = Sensor(0.001, 0.02)
ACTUATORS = (TorqueConstant(k_t=0.6), DCMotor(k=0.4, k_e=0.5), PositionServo(k_p=8.0, k_d=0.4, limit=2.5))


def joint(*effects: Effect) -> Model:
    return Model(GeneralJoint(J=0.05, G=1.2), effects, dt=0.01)


def swings(truth: Model, n: int = 3, seconds: float = 6.0, about: float = 0.0, seed: int = 0) -> list[Record]:
    """Rollouts under multisines of amplitude 1.5 about `about`, which begin at rest where the pendulum hangs."""
    rng = np.random.default_rng(seed)
    u = about + np.stack([multisine(rng, round(seconds / truth.dt), truth.dt, 1.5, 2.0) for _ in range(n)])
    return SENSOR.measure(simulate(truth, u, np.full(n, math.pi), np.zeros(n)), rng)


@pytest.mark.long
@pytest.mark.parametrize("actuator", ACTUATORS, ids=lambda a: a.name)
def test_numpy_casadi_and_torch_agree(actuator: Effect, agree: Callable[..., None]) -> None:
    agree(joint(actuator, Viscous(b=0.02), Delay(T=0.013)))


def test_a_voltage_is_a_torque_beside_back_emf() -> None:
    u = np.sin(np.arange(400) / 20.0)
    volts = simulate(joint(DCMotor(k=0.4, k_e=0.5)), u, math.pi, 0.0)
    torque = simulate(joint(BackEmf(k=0.2)), 0.4 * u, math.pi, 0.0)
    np.testing.assert_allclose(volts.theta, torque.theta, rtol=0.0, atol=1e-12)


def test_a_servo_comes_to_rest_where_gravity_holds_its_torque() -> None:
    model = joint(PositionServo(k_p=8.0, k_d=0.4))
    end = simulate(model, np.full(1000, 2.0), math.pi, 0.0).theta[-1]
    assert 1.2 * math.sin(end) + 8.0 * (2.0 - end) == pytest.approx(0.0, abs=1e-6)
    limited = simulate(
        joint(PositionServo(k_p=8.0, k_d=0.4, limit=0.3), Viscous(b=0.1)), np.full(2000, 2.0), math.pi, 0.0
    )
    assert 1.2 * math.sin(limited.theta[-1]) == pytest.approx(0.3, abs=1e-6), "no more than its limit"


@pytest.mark.parametrize("lagging", [Delay(T=0.035), Lag(T=0.03)], ids=lambda e: e.name)
def test_a_servo_held_its_first_command_before_the_log(lagging: Effect) -> None:
    model = joint(PositionServo(k_p=8.0, k_d=0.4), lagging)
    u = np.array([3.0, 3.0, 2.5, 2.0, 2.0, 2.4, 2.4, 2.4, 2.4, 2.4])
    np.testing.assert_allclose(model.drive_record(u), list(model.drives(u.tolist())), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(model.drive_record(u)[:2], 3.0, rtol=0.0, atol=1e-12)
    resting = model.initial_state(3.0, 0.0)
    assert model.drive(3.0, resting.memory)[0] == pytest.approx((3.0, 3.0), abs=1e-12)


def test_a_push_acts_behind_the_actuator() -> None:
    """It is a torque [N m] also where the command is an angle, and beyond the servo's limit."""
    servo = joint(PositionServo(k_p=8.0, k_d=0.4, limit=0.3))
    without = servo.acceleration(math.pi, 0.0, 0.0, 1.0)
    assert servo.acceleration(math.pi, 0.0, 0.0, 1.0, push=0.5) - without == pytest.approx(0.5 / 0.05)


@pytest.mark.parametrize(
    ("actuator", "truth", "about"),
    [
        (TorqueConstant(), {"J": 0.05 / 0.6, "G": 2.0, "viscous.b": 0.05}, 0.0),
        (DCMotor(), {"J": 0.05 / 0.4, "G": 3.0, "dc_motor.k_e": 0.5 + 0.03 / 0.4}, 0.0),
        (PositionServo(), {"J": 0.05 / 8.0, "G": 0.15, "position_servo.k_d": (0.4 + 0.03) / 8.0}, math.pi),
    ],
    ids=lambda a: getattr(a, "name", ""),
)
def test_numbers_come_relative_to_the_constant_that_motion_cannot_show(
    actuator: Effect, truth: dict[str, float], about: float
) -> None:
    """Viscous friction beside back-EMF or a servo's damping does not show either: theirs hold its part."""
    hidden = next(a for a in ACTUATORS if a.name == actuator.name)
    if isinstance(hidden, PositionServo):
        hidden = PositionServo(k_p=8.0, k_d=0.4)
    free = (Viscous(),) if isinstance(actuator, TorqueConstant) else ()
    estimate = fit(joint(actuator, *free), swings(joint(hidden, Viscous(b=0.03)), about=about), SENSOR)
    assert set(estimate.names) == set(truth)
    for name, value in truth.items():
        assert abs(estimate.values[name] - value) < 4.0 * estimate.sd[name] < 0.2 * value, name


def test_back_emf_hides_viscous_friction() -> None:
    records = swings(joint(DCMotor(k=0.4, k_e=0.5)))
    model = joint(DCMotor(k=0.4))
    samples, tested = Samples(model, records, SENSOR), ("viscous", "coulomb")
    assert set(scores(first_fit(samples, model, ("J", "G", "dc_motor.k_e")), tested)) == {"coulomb"}
    assert set(scores(first_fit(samples, model, ("J", "G")), tested)) == {"viscous", "coulomb"}, "where k_e is known"


def test_the_loop_that_a_servo_is_matched_with_is_one_that_steps_of_dt_follow() -> None:
    """One that follows a clean command at once looks overdamped, with a mode that would run away."""
    t = 0.01 * np.arange(601)
    u = math.pi + np.sin(2.0 * t)
    stiff = Record(t, u[:-1], np.append(u[0], u[:-1]))
    model = joint(PositionServo(k_p=8.0))
    for guess in initial_guesses(model, ("J", "position_servo.k_d"), [stiff], Sensor(1e-4)):
        lin = LinearisedModel(samples := Samples(guess, [stiff], Sensor(1e-4)), guess, smoothed_motion(samples, 1.0))
        assert np.max(np.abs(np.linalg.eigvals(lin.system.A[:-1, :, :2]))) < 1.0


@pytest.mark.long
def test_dry_friction_and_a_late_command_are_found_behind_a_servo() -> None:
    servo = PositionServo(k_p=8.0, k_d=0.4)
    records = swings(joint(servo, Coulomb(tau_c=0.15), Delay(T=0.04)), n=4, about=math.pi)
    diagnosis = diagnose(joint(PositionServo(k_p=8.0)), records, SENSOR)
    assert {s.effect for s in diagnosis.steps} == {"coulomb", "delay"}, str(diagnosis)
    estimate = diagnosis.estimate
    for name, value in {"coulomb.tau_c": 0.15, "delay.T": 0.04, "position_servo.k_d": 0.4}.items():
        assert abs(estimate.values[name] - value) < 4.0 * estimate.sd[name], name
    assert ("position_servo.k_d", "viscous", "back_emf") in diagnosis.not_identifiable


@pytest.mark.long
@pytest.mark.parametrize("unit", [1.0, 1000.0], ids=["metres", "millimetres"])
def test_an_axis_is_answered_in_whatever_unit_its_positions_came(unit: float) -> None:
    """A servo at the limit of its speed, which travels a centimetre: nothing of it is of the size of a radian."""
    servo, limit = PositionServo(k_p=1.0, k_d=6e-3), TorqueSpeedLimit(limit=3e-4, k=3e-4 / 0.045)
    bounds = {"m": (1e-7, 1e4)}
    truth = Model(LinearAxis(m=6e-5, bounds=bounds), (servo, limit), dt=0.01)
    t = truth.dt * np.arange(1000)
    run = simulate(truth, 0.005 * np.sin(2.0 * math.pi * (0.3 + 1.5 * t / t[-1]) * t)[None], np.zeros(1), np.zeros(1))
    (record,) = Sensor(theta=1e-5).measure(run, np.random.default_rng(0))
    scaled = dataclasses.replace(record, u=unit * record.u, theta=unit * np.asarray(record.theta))
    diagnosis = diagnose(
        Model(LinearAxis(bounds=bounds), (PositionServo(),), dt=0.01), [scaled], Sensor(theta=1e-5 * unit)
    )
    assert [s.effect for s in diagnosis.steps] == ["torque_speed_limit"], str(diagnosis)
    values = diagnosis.estimate.values
    assert values["torque_speed_limit.limit"] == pytest.approx(3e-4 * unit, rel=0.02)
    assert values["torque_speed_limit.k"] == pytest.approx(3e-4 / 0.045, rel=0.02)
    assert values["m"] == pytest.approx(6e-5, rel=0.02)
    assert diagnosis.error.ratio < 1.1


@pytest.mark.parametrize("w", [10.0, 50.0, 150.0])
@pytest.mark.parametrize("known", [False, True], ids=["unknown inertia", "known inertia"])
def test_the_loop_of_a_servo_is_matched_however_stiff(w: float, known: bool) -> None:
    """A stiff one errs from its command by little more than it lags: a regression on that error finds nothing."""
    truth = Model(GeneralJoint(J=8.0 / w**2, G=0.8), (PositionServo(k_p=8.0, k_d=11.2 / w),), dt=0.01)
    records = swings(truth, about=math.pi)
    given = {"J": 8.0 / w**2} if known else {"position_servo.k_p": 8.0}
    model = joint(PositionServo()).with_parameters(given)
    names = ("G", "position_servo.k_d", "position_servo.k_p" if known else "J")
    guess = initial_guesses(model, names, records, SENSOR)[1].parameters
    late = float(guess["position_servo.k_d"].value) / float(guess["position_servo.k_p"].value)
    assert late == pytest.approx(1.4 / w, rel=0.5), "how far it lags shows in any motion, its frequency in fast ones"
    fitted = fit(model, records, SENSOR, names).model.parameters
    for name in names:
        assert fitted[name].value == pytest.approx(float(truth.parameters[name].value), rel=0.1), name


SLOW = joint(PositionServo(k_p=8.0, k_d=0.4), TorqueSpeedLimit(limit=1.5, k=0.3), Coulomb(tau_c=0.1))
AT_ITS_LIMIT = Model(
    GeneralJoint(J=5e-4, G=0.05),
    (PositionServo(k_p=1.0, k_d=0.03), TorqueSpeedLimit(limit=0.08, k=0.01), Coulomb(tau_c=0.004)),
    dt=0.02,
)


@pytest.mark.long
@pytest.mark.parametrize("truth", [SLOW, AT_ITS_LIMIT], ids=["slow", "at its limit"])
def test_the_limit_of_a_servo_that_falls_with_speed_is_found(truth: Model) -> None:
    """A drive that is at its limit most of the time follows no loop; a search from a matched one ends elsewhere."""
    k_p = float(truth.parameters["position_servo.k_p"].value)
    swung = swings(truth, n=4, about=math.pi)
    records = [dataclasses.replace(r, theta_dot=None) for r in swung]
    diagnosis = diagnose(Model(GeneralJoint(), (PositionServo(k_p=k_p),), dt=truth.dt), records, Sensor(theta=0.001))
    assert {s.effect for s in diagnosis.steps} == {"torque_speed_limit", "coulomb"}, str(diagnosis)
    assert diagnosis.error.ratio < 1.5
    assert "position_servo (k_d = " in str(diagnosis), (
        "what the drive is fitted with is told beside the plant's numbers"
    )
    servo = truth.actuator
    assert servo is not None
    torques = [servo.torque(r.u, r.theta[:-1], r.theta_dot[:-1]) for r in swung[:3]]
    asked = float(np.sqrt(np.mean(np.square(torques))))
    assert diagnosis.torque.drive == pytest.approx(asked, rel=0.3), (
        "a torque, and not the angle that the drive was told"
    )


def test_an_input_effect_is_told_in_the_unit_of_the_command() -> None:
    assert joint(DCMotor(), Saturation(limit=5.0)).parameters["saturation.limit"].unit == "V"
    assert joint(TorqueConstant(), Coulomb()).parameters["coulomb.tau_c"].unit == "N m"


def test_a_saved_model_keeps_its_actuator(tmp_path) -> None:
    model = joint(PositionServo(k_p=8.0, k_d=0.4, limit=2.5), Delay(T=0.02))
    save(model, tmp_path / "model.json")
    back = load(tmp_path / "model.json")
    assert {n: p.value for n, p in back.model.parameters.items()} == {n: p.value for n, p in model.parameters.items()}
    assert back.model.actuator is not None and back.free == ("J", "G", "position_servo.k_d", "delay.T")


def test_a_position_command_is_read_as_the_angle_is(tmp_path) -> None:
    rows = "\n".join(f"{0.1 * k},{k},{10 * k}" for k in range(12))
    (tmp_path / "servo.csv").write_text(f"t,theta,goal\n{rows}\n")
    log = read(tmp_path / "servo.csv", columns="command=goal", zero="hanging", degrees=True, command="position")
    np.testing.assert_allclose(log[0].u, math.pi + np.deg2rad(10.0 * np.arange(11)))
    with pytest.raises(InvalidInput, match="a position command has the sign of the angle"):
        read(tmp_path / "servo.csv", columns="command=goal", flip_torque=True, command="position")
    with pytest.raises(InvalidInput, match="expected one of torque, current, voltage, position"):
        read(tmp_path / "servo.csv", columns="command=goal", command="duty")  # type: ignore[arg-type]


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 2])
def test_a_servo_whose_speed_is_limited_is_no_gear_that_takes_all_of_the_load(seed: int) -> None:
    """It is so light that its limit and the slope of that are known by their ratio alone, which is the speed."""
    truth = Model(
        GeneralJoint(J=0.02, G=0.0),
        (PositionServo(k_p=1.0, k_d=0.9), TorqueSpeedLimit(limit=0.12, k=1.9)),
        RK4(substeps=4),
        dt=0.05,
    )
    sensor, records = Sensor(theta=1e-4), list[Record]()
    for k, (target, n) in enumerate(((0.03, 120), (0.06, 120), (0.13, 140), (0.25, 180), (0.5, 240), (0.76, 300))):
        run = simulate(truth, np.full((1, n), target), np.zeros(1), np.zeros(1))
        records += sensor.measure(run, np.random.default_rng(10 * seed + k))
    start = Model(GeneralJoint(J=0.1, G=0.0), (PositionServo(k_p=1.0, k_d=0.5),), RK4(substeps=2), dt=0.05)
    diagnosis = diagnose(start, records, sensor, parameters=("J", "position_servo.k_d"))
    assert [s.effect for s in diagnosis.steps] == ["torque_speed_limit"]
    speed = diagnosis.steps[0].parameters["torque_speed_limit.no_load_speed"]
    assert speed["value"] == pytest.approx(0.12 / 1.9, rel=0.02) and speed["unit"] == "rad/s"
    assert (
        "no_load_speed = 0.06" in str(diagnosis)
        and "torque_speed_limit.no_load_speed" not in diagnosis.model.parameters
    )
    assert not LoadFriction(mu=0.9999).plausible and LoadFriction(mu=0.3).plausible


def fast_motor(*effects: Effect) -> Record:
    """A small motor with a propeller, up to 3,000 rad/s under steps of its voltage, of which the speed is read."""
    rng = np.random.default_rng(0)
    model = Model(GeneralJoint(J=1e-5, G=0.0), (DCMotor(k_e=1.4e-4), *effects), RK4(substeps=2), 0.01)
    u = np.abs(steps(rng, 2000, 0.01, 1.0, 0.4))
    return Sensor(theta_dot=1.0).measure(simulate(model, u, 0.0, 0.0), rng)[0]


@pytest.mark.parametrize(
    "hidden", [(Drag(c=1.3e-8),), (Drag(c=1.3e-8), Coulomb(tau_c=0.03))], ids=["drag", "drag and coulomb"]
)
def test_frictions_of_a_fast_motor_are_found(hidden: tuple[Effect, ...]) -> None:
    """They are a millionth of what they would be at a joint's speed, where a fit may not begin."""
    model = Model(GeneralJoint(J=3e-5, G=0.0), (DCMotor(k_e=2e-4),), RK4(substeps=2), 0.01)
    diagnosis = diagnose(model, [fast_motor(*hidden)], parameters=["J", "dc_motor.k_e"])
    assert {s.effect for s in diagnosis.steps} == {e.name for e in hidden}
    numbers, sd = diagnosis.estimate.values, diagnosis.estimate.sd
    for effect in hidden:
        for field, number in effect.parameters.items():
            name = f"{effect.name}.{field}"
            assert abs(numbers[name] - float(number.value)) < 3.0 * sd[name]


@pytest.mark.parametrize("kind", [Viscous, Drag])
def test_a_friction_begins_with_a_torque_that_the_log_allows(kind: type[Effect]) -> None:
    for speed in (3.0, 8.0, 300.0, 1e4):
        begun = kind().at_beginning(Extent(dt=0.01, duration=10.0, u_max=2.0, speed=speed))
        (number,) = begun.parameters.values()
        power = 2 if kind is Drag else 1
        assert 0.0 < float(number.value) * speed**power < 0.5 * 2.0
