"""Laws of the torque regression: what friction takes of a torque is found along a motion that somebody prescribes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sysid import (
    RK4,
    DCMotor,
    GeneralJoint,
    LinearAxis,
    Model,
    Plant,
    Record,
    Sensor,
    Viscous,
    diagnose,
    effect,
    simulate,
)
from sysid.diagnosis.explanation import friction_shown
from sysid.estimation.torque_regression import FrictionAlong, friction_along, regression, telling_motion

DT, SENSOR = 0.008, Sensor(theta=5e-5)
JOINT = GeneralJoint()
B, TAU_C = 0.06, 0.22
"""Viscous and dry friction of the joint."""


def followed(J: float, b: float, tau_c: float, scatter: float, seed: int = 0, seconds: float = 24.0) -> Record:
    """A joint that a controller holds to a path, whatever the torque for it: what no model foresees is slow."""
    rng, t = np.random.default_rng(seed), DT * np.arange(round(seconds / DT) + 1)
    w, size = 2.0 * np.pi * np.array([0.11, 0.19, 0.31]), np.array([0.9, 0.4, 0.2])
    theta = np.sin(t[:, None] * w) @ size
    theta_dot, theta_ddot = np.cos(t[:, None] * w) @ (size * w), -np.sin(t[:, None] * w) @ (size * w * w)
    slow = np.convolve(rng.standard_normal(len(t) + 30), np.hanning(31), "valid")
    torque = J * theta_ddot + b * theta_dot + tau_c * np.sign(theta_dot) + scatter * slow / np.std(slow)
    return Record(t, torque[:-1], theta + SENSOR.theta * rng.standard_normal(len(t)), name="followed")


def along(
    record: Record, plant: Plant = JOINT, names: tuple[str, ...] = ("J", "G"), sensor: Sensor = SENSOR
) -> FrictionAlong | None:
    """Friction along the first three quarters of a record, if the last one has it, too."""
    cut = 3 * len(record) // 4
    first, last = record.head(cut), record.part(cut, len(record), "last")
    return friction_along(Model(plant, dt=record.dt), names, [first], [last], sensor)


@pytest.mark.parametrize("seed", range(4))
def test_friction_is_found_within_its_error_where_the_inertia_does_not_show(seed: int) -> None:
    friction = along(followed(0.002, B, TAU_C, 0.03, seed=seed))
    assert friction is not None
    assert abs(friction.viscous[0] - B) < 4.0 * friction.viscous[1]
    assert abs(friction.coulomb[0] - TAU_C) < 4.0 * friction.coulomb[1] + 0.02 * TAU_C, "smoothed readings reverse late"
    assert friction.share > 0.9


def test_a_drive_that_is_late_is_no_inertia() -> None:
    """A speed loop's torque comes 0.1 s late, against a friction of 1 N m s/rad: that looks like an inertia of 0.1."""
    truth = Model(GeneralJoint(J=0.02, G=0.0), (effect("viscous", b=1.0), effect("delay", T=0.1)), RK4(4), 0.03)
    rng = np.random.default_rng(0)
    run = simulate(truth, np.repeat(rng.uniform(-20.0, 20.0, 100), 10), 0.0, 0.0)
    record = Record(t=run.t, u=run.u, theta_dot=run.theta_dot + 0.2 * rng.standard_normal(len(run.t)))
    first, last, sensor = record.head(750), record.part(750, len(record), "last"), Sensor(theta_dot=0.2)
    late = truth.without_effect("viscous")
    fits: Any = [SimpleNamespace(model=m, names=("J",)) for m in (late.without_effect("delay"), late)]
    search: Any = SimpleNamespace(records=[first], sensor=sensor)
    on_time, delayed = (friction_shown(search, fits[0], end, [last]) for end in fits)
    assert on_time is not None and delayed is not None
    assert on_time.contradicts(0.02, 2.0) and on_time.inertia[0] > 0.06
    assert delayed.inertia[0] == pytest.approx(0.02, abs=0.01) and delayed.viscous[0] == pytest.approx(1.0, rel=0.02)


def led_along_a_sine(frequency: float, seed: int = 0, seconds: float = 10.0) -> Record:
    """A joint with inertia 0.01, viscous and dry friction that a controller leads along a sine."""
    rng, dt = np.random.default_rng(seed), 0.002
    t, w = dt * np.arange(round(seconds / dt) + 1), 2.0 * np.pi * frequency
    theta, middle = 0.35 * np.sin(w * t) + SENSOR.theta * rng.standard_normal(len(t)), t[:-1] + 0.5 * dt
    theta_dot = 0.35 * w * np.cos(w * middle)
    torque = -0.01 * w * w * 0.35 * np.sin(w * middle) + B * theta_dot + TAU_C * np.sign(theta_dot)
    return Record(t, torque + 0.01 * rng.standard_normal(len(middle)), theta, name="sine")


@pytest.mark.parametrize("frequency", (1.5, 3.0, 6.0))
def test_a_sine_of_any_frequency_tells_dry_friction_from_viscous(frequency: float) -> None:
    """Spans of a quarter of its period would be of one kind, and their friction could be either."""
    friction = along(led_along_a_sine(frequency), GeneralJoint(G=0.0), ("J",))
    assert friction is not None and not friction.one_speed
    assert abs(friction.viscous[0] - B) < 4.0 * friction.viscous[1] + 0.02 * B
    assert abs(friction.coulomb[0] - TAU_C) < 4.0 * friction.coulomb[1] + 0.02 * TAU_C
    assert friction.inertia[0] == pytest.approx(0.01, rel=0.02)


@pytest.mark.parametrize("G", (0.0, 1.5))
def test_a_known_gravity_does_not_stand_for_inertia(G: float) -> None:
    """Along a sine a weight is as good as an inertia, if it is free."""
    record = led_along_a_sine(3.0)
    assert record.theta is not None
    record = replace(record, u=record.u - G * np.sin(record.theta[:-1]))
    terms = telling_motion(Model(GeneralJoint(G=G), dt=record.dt), ("J",), [record], SENSOR)
    result = regression(terms.columns, terms.speed_change)
    assert result.value[:2] == pytest.approx([0.0, 100.0], rel=0.02) and result.sd[1] < 1.0


def test_a_joint_that_rests_with_its_drive_released_says_nothing_of_friction() -> None:
    """A worm that holds its load moves for a third of the time; at rest its readings are noise of either sign."""
    rng, t = np.random.default_rng(0), 0.04 * np.arange(1001)
    turns = np.select([t % 12.0 < 2.0, (t % 12.0 > 6.0) & (t % 12.0 < 8.0)], [1.0, -1.0], 0.0)
    theta_dot = np.where(t < 20.0, 21.0, 5.0) * turns
    theta = np.concatenate([[0.0], np.cumsum(0.04 * theta_dot[:-1])]) + 0.002 * rng.standard_normal(len(t))
    torque = np.where(theta_dot == 0.0, 0.0, B * theta_dot + 3.0 * np.sign(theta_dot) + 0.4)
    torque += 0.05 * rng.standard_normal(len(t)) * (theta_dot != 0.0)
    record = Record(t, torque[:-1], theta, name="worm")
    friction = along(record, sensor=Sensor(theta=0.002))
    assert friction is not None
    assert friction.coulomb[0] == pytest.approx(3.0, rel=0.05)
    assert friction.viscous[0] == pytest.approx(B, rel=0.1)
    assert friction.load[0] == pytest.approx(0.4, rel=0.1)


def led_past_gravity(seed: int, scatter: float, tau_c: float = TAU_C, wave: float = 0.01, way: float = 1.0) -> Record:
    """A joint that a controller leads in one direction past the top, from rest to rest; at one speed but for a wave."""
    rng, t = np.random.default_rng(seed), DT * np.arange(730)
    ramp = np.clip(t / 0.1, 0.0, 1.0) * np.clip((t[-1] - t) / 0.1, 0.0, 1.0)
    theta_dot = way * 0.37 * ramp * (1.0 + wave * np.sin(9.0 * t))
    theta = np.concatenate([[0.0], np.cumsum(0.5 * DT * (theta_dot[1:] + theta_dot[:-1]))]) - 1.05 * way
    slow = np.convolve(rng.standard_normal(len(t) + 6), np.hanning(7), "valid")
    torque = 0.024 * np.gradient(theta_dot, DT) - 0.37 * np.sin(theta) + tau_c * np.sign(theta_dot)
    torque += scatter * slow / np.std(slow)
    return Record(t, torque[:-1], theta + SENSOR.theta * rng.standard_normal(len(t)), name="led")


@pytest.mark.parametrize("way", (1.0, -1.0))
def test_a_motion_in_one_direction_does_not_tell_friction_from_a_load(way: float) -> None:
    """A half of each would be certain and wrong: both together are told as what they may be."""
    friction = along(led_past_gravity(0, 0.003, wave=0.5, way=way))
    assert friction is not None and friction.one_way and not friction.one_speed
    assert friction.load == (0.0, 0.0)
    assert abs(friction.coulomb[0] - TAU_C) < 4.0 * friction.coulomb[1]


@pytest.mark.parametrize("seed", range(3))
def test_a_motion_at_one_speed_does_not_tell_dry_friction_from_viscous(seed: int) -> None:
    friction = along(led_past_gravity(seed, 0.03))
    assert friction is not None and friction.one_way and friction.one_speed
    assert friction.viscous == (0.0, 0.0)
    assert abs(friction.coulomb[0] - TAU_C) < 4.0 * friction.coulomb[1] < 0.2 * TAU_C


@pytest.mark.parametrize(("tau_c", "b"), ((9.0, 0.0), (0.0, 1.0), (5.0, 0.5)))
def test_nor_does_one_speed_forth_and_another_back(tau_c: float, b: float) -> None:
    """Two speeds are two numbers, of a dry and a viscous friction and a load; at a third speed there are three."""

    def stroked(*speeds: float) -> Record:
        rng, t = np.random.default_rng(1), 0.01 * np.arange(6000)
        stroke, since = np.floor(t / 5.0).astype(int) % len(speeds), t % 5.0
        theta_dot = np.array(speeds)[stroke] * np.clip(np.minimum(since, 4.0 - since) / 0.05, 0.0, 1.0)
        theta = np.cumsum(0.01 * theta_dot) + 0.005 * rng.standard_normal(len(t))
        slow = np.convolve(rng.standard_normal(len(t) + 40), np.hanning(41), "valid")
        force = tau_c * np.sign(theta_dot) + b * theta_dot + 250.0 + 0.5 * slow / np.std(slow)
        return Record(t, force[:-1], theta, name="stroked")

    two, three = (
        along(stroked(*speeds), LinearAxis(), ("m",), Sensor(theta=0.005))
        for speeds in ((6.0, -11.0), (6.0, -11.0, 2.0))
    )
    assert two is not None and two.one_speed and not two.one_way
    assert two.viscous == (0.0, 0.0)
    assert two.coulomb[0] == pytest.approx(tau_c + 8.5 * b, rel=0.03), "what both have in common is half the difference"
    assert three is not None and not three.one_speed
    assert three.viscous[0] == pytest.approx(b, abs=0.1)


@pytest.mark.long
@pytest.mark.parametrize("seed", (0, 3, 4))
def test_no_limit_that_cuts_off_a_drive_stands_for_a_controller(seed: int) -> None:
    """A drive that gave nothing of what it is told, but a speed, would move just like this joint."""
    diagnosis = diagnose(Model(JOINT, dt=DT), [led_past_gravity(seed, 0.04, tau_c=0.3)])
    named, values = {step.effect for step in diagnosis.steps}, diagnosis.estimate.values
    assert named <= {"viscous", "coulomb"}
    if diagnosis.friction is None:
        friction = values.get("viscous.b", 0.0) * 0.37 + values.get("coulomb.tau_c", 0.0)
    else:
        friction = diagnosis.friction.coulomb[0] + 0.37 * diagnosis.friction.viscous[0]
    assert friction == pytest.approx(0.3, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("seed", (0, 1, 2, 6))
def test_the_frictions_of_a_heavy_arm_that_is_led_slowly_are_told_whatever_predicts_its_path(seed: int) -> None:
    """For a second, its path goes on as it does, for a friction or an inertia that is far too large."""
    rng, dt = np.random.default_rng(seed), 0.01
    t, edges, speeds = dt * np.arange(801), np.array([0.0, 3.0, 4.0, 5.2, 8.1]), np.array([0.5, -0.3, 0.65, -0.6])
    leg = np.searchsorted(edges, t, side="right") - 1
    speed = speeds[leg] * np.clip(np.minimum(t - edges[leg], edges[leg + 1] - t) / 0.3, 0.0, 1.0)
    theta = np.concatenate([[0.0], np.cumsum(0.5 * dt * (speed[1:] + speed[:-1]))]) - 0.9
    slow = np.convolve(rng.standard_normal(len(t) + 30), np.hanning(31), "valid")
    torque = 18.0 * np.gradient(speed, dt) - 140.0 * np.sin(theta) + 20.0 * speed + 20.0 * np.sign(speed)
    torque += 3.0 * slow / np.std(slow)
    record = Record(t, torque[:-1], theta + 7e-5 * rng.standard_normal(len(t)), name="led")
    answer = diagnose(Model(JOINT, dt=dt), [record], Sensor(theta=7e-5))
    if answer.friction is None:
        values, sd = answer.estimate.values, answer.estimate.sd
        frictions = [(values[name], sd[name]) for name in ("viscous.b", "coulomb.tau_c")]
    else:
        frictions = [answer.friction.viscous, answer.friction.coulomb]
        J, sd = answer.friction.inertia
        assert abs(J - 18.0) < 3.0 * sd + 1.0
        assert (f"an inertia of {J:.3g} +- " in answer.finding) is answer.friction.tells_inertia
    for value, error in frictions:
        assert abs(value - 20.0) < 3.0 * error + 1.0, answer


def test_unseen_data_that_rest_speak_neither_for_friction_nor_against_it() -> None:
    """A record that rests throughout is slow beside the others, however its own noise moves."""
    fitted, seen = (followed(0.002, B, TAU_C, 0.03, seed=seed) for seed in (0, 1))
    theta = np.ones(len(seen) + 1) + SENSOR.theta * np.random.default_rng(2).standard_normal(len(seen) + 1)
    rests = replace(seen, theta=theta, u=np.zeros(len(seen)), name="rests")
    shares = [
        friction_along(Model(JOINT, dt=DT), ("J", "G"), [fitted], unseen, SENSOR) for unseen in ([seen], [seen, rests])
    ]
    assert shares[0] is not None and shares[0] == shares[1]


def test_a_torque_without_friction_or_with_hardly_any_shows_none() -> None:
    assert along(followed(1.0, 0.0, 0.0, 0.03)) is None
    assert along(followed(0.002, B, TAU_C, 1.0)) is None


def test_along_a_free_swing_no_torque_shows_a_friction() -> None:
    """Though a gravity that is known drives it."""
    model = Model(GeneralJoint(J=0.1, G=1.0), (Viscous(b=0.02),), dt=0.02)
    swing = simulate(model, np.zeros(1000), np.pi - 1.0, 0.0)
    (record,) = SENSOR.measure(swing, np.random.default_rng(0))
    assert friction_along(model.without_effect("viscous"), ("J",), [record], [record], SENSOR) is None


@pytest.mark.parametrize(("inertia", "contradicts"), [(1.0, False), (1.4, False), (1.6, True), (0.6, True)])
def test_an_inertia_is_contradicted_only_by_one_that_surely_shows(inertia: float, contradicts: bool) -> None:
    for sd, shows in ((0.25, True), (0.5, False)):
        friction = FrictionAlong((0.1, 0.01), (0.2, 0.01), (0.0, 0.1), (1.0, sd), 0.95)
        assert friction.contradicts(inertia, 1.5) is (shows and contradicts)
        assert not friction.tells_inertia, "it is shown, but not sure enough to be told"


def test_no_dry_friction_drives() -> None:
    """A torque that goes with the speed's sign is no friction, and what is left of it is viscous."""
    friction = along(followed(0.01, 4.0 * B, -0.2 * TAU_C, 0.01))
    assert friction is not None and friction.coulomb == (0.0, 0.0) and 0.0 < friction.viscous[0] < 4.0 * B


def test_a_friction_that_held_out_records_do_not_have_is_none() -> None:
    model, fitted = Model(GeneralJoint(), dt=DT), followed(0.002, B, TAU_C, 0.03)
    for other, there in ((followed(0.002, B, TAU_C, 0.03, seed=1), True), (followed(0.002, 0.5, 0.0, 0.03), False)):
        friction = friction_along(model, ("J", "G"), [fitted], [other], SENSOR)
        assert (friction is not None) is there


@pytest.mark.parametrize("G", [0.0, 0.4])
def test_a_gravity_that_is_known_is_taken_off_and_one_that_is_free_is_part_of_the_load(G: float) -> None:
    joint = followed(0.002, B, TAU_C, 0.03)
    assert joint.theta is not None
    gravity = G * np.sin(joint.theta[:-1])
    record = replace(joint, u=joint.u - gravity + 0.1)
    weight = float(np.mean(gravity[: 3 * len(gravity) // 4]))
    for plant, names, load in ((GeneralJoint(G=G), ("J",), 0.1), (GeneralJoint(), ("J", "G"), 0.1 - weight)):
        friction = along(record, plant, names)
        assert friction is not None
        assert abs(friction.load[0] - load) < 4.0 * friction.load[1] + 0.005, (
            "the middle of where it moves is not that of all"
        )
        assert abs(friction.coulomb[0] - TAU_C) < 4.0 * friction.coulomb[1] + 0.02 * TAU_C


def test_the_load_of_an_axis_is_that_in_the_middle_of_its_motion() -> None:
    joint = followed(0.002, B, TAU_C, 0.03)
    assert joint.theta is not None
    record = replace(
        joint, theta=joint.theta + 40.0, u=joint.u + 0.02 * (joint.theta[:-1] - np.mean(joint.theta)) + 0.1
    )
    friction = along(record, LinearAxis(), ("m",))
    assert friction is not None
    assert abs(friction.load[0] - 0.1) < 4.0 * friction.load[1] + 0.005, (
        "the middle of what was fitted is not that of all"
    )


@pytest.mark.parametrize("k_e", [0.2, 0.3])
def test_a_constant_voltage_explains_nothing_by_itself(k_e: float) -> None:
    """What back-EMF takes from it is exactly a friction that falls with speed."""
    motor = Model(GeneralJoint(J=0.2, G=0.0), (DCMotor(k_e=0.25),), dt=DT)
    run = simulate(motor, np.ones(round(8.0 / DT)), 0.0, 0.3)
    (record,) = Sensor(theta=1e-4).measure(run, np.random.default_rng(0))
    first, last = record.head(len(record) // 2), record.part(len(record) // 2, len(record), "last")
    model, names = motor.with_parameters({"dc_motor.k_e": k_e}), ("J", "dc_motor.k_e")
    assert friction_along(model, names, [first], [last], Sensor(theta=1e-4)) is None


def test_a_command_of_one_size_in_each_direction_tells_no_friction() -> None:
    """It is the direction's sign to the last digit, whatever brakes the joint."""
    joint = Model(GeneralJoint(J=0.2, G=0.0), (effect("viscous", b=0.1),), dt=DT)
    u = np.outer([0.5, -0.5], np.ones(round(8.0 / DT)))
    runs = simulate(joint, u, np.zeros(2), np.zeros(2))
    seen, unseen = (Sensor(theta=1e-4).measure(runs, np.random.default_rng(seed)) for seed in range(2))
    assert friction_along(Model(joint.plant, dt=DT), ("J",), seen, unseen, Sensor(theta=1e-4)) is None


def test_a_log_that_is_too_short_for_one_span_shows_none() -> None:
    short, long = followed(0.002, B, TAU_C, 0.03).head(20), followed(0.002, B, TAU_C, 0.03)
    for plant in (LinearAxis(), GeneralJoint()):
        for fitted, unseen in ((short, long), (long, short), (short, short)):
            assert friction_along(Model(plant, dt=DT), tuple(plant.parameters), [fitted], [unseen], SENSOR) is None


def test_standard_errors_cover() -> None:
    rng, truth, inside = np.random.default_rng(3), np.array([2.0, -1.0]), 0
    for _ in range(400):
        columns = rng.standard_normal((50, 2)) * [1.0, 1e-6]
        result = regression(columns, columns @ (truth / [1.0, 1e-6]) + rng.standard_normal(50))
        inside += abs(result.value[1] - truth[1] * 1e6) < 1.96 * result.sd[1]
    assert 0.92 < inside / 400 < 0.98


@pytest.mark.long
@pytest.mark.parametrize("b", [B, -B])
def test_a_diagnosis_tells_the_friction_of_a_joint_that_only_follows_its_path(b: float) -> None:
    """Of dry friction that falls with speed, too, and names nothing else in its place."""
    answer = diagnose(Model(GeneralJoint(), dt=DT), [followed(0.002, b, TAU_C, 0.03, seconds=12.0)], SENSOR)
    assert answer.verdict == "partly" and not answer.steps and not answer.conventions
    assert answer.friction is not None
    assert abs(answer.friction.coulomb[0] - TAU_C) < 0.03
    assert "dry friction of 0.2" in answer.finding and "of how the drive's torque varies" in answer.finding
    assert ("friction that falls with speed by 0.0" in answer.finding) is (b < 0.0)
    assert "follows a path" in answer.doubts[-1]
    assert answer.to_dict()["friction_along_the_motion"]["share"] > 0.9
