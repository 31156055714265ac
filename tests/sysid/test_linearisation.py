"""A model along a chain of records: slopes are derivatives, and what moves with a number is what the model says."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi
import numpy as np
import pytest

from sysid import RK4, Effect, GeneralJoint, Model, PositionServo, Record, Sensor, effect, simulate
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.linearisation import LinearisedModel, Motion, Samples, level, smoothed_motion
from sysid.planning.excitation import multisine

DT = 0.02
SENSOR = Sensor(theta=0.003, theta_dot=0.05)
JOINT = Model(GeneralJoint(J=0.3, G=2.1), integrator=RK4(substeps=2), dt=DT)
SMOOTH = replace(
    JOINT, effects=(effect("viscous", b=0.07), effect("spring", k=0.3), effect("periodic", a=0.2, b=0.1, f=1.7))
)
SHOWN = {
    "viscous": (effect("viscous", b=0.07),),
    "coulomb": (effect("coulomb", tau_c=0.11),),
    "drift": (effect("drift", r=0.05),),
    "delay": (effect("delay", T=0.0337, longest=0.06),),
    "lag": (effect("lag", T=0.061),),
    "stamp": (effect("stamp", s=-0.37),),
    "sensor delay": (effect("sensor_delay", T=0.027, longest=0.06),),
    "gain": (effect("velocity_gain", c=1.06),),
    "all at once": (
        effect("viscous", b=0.07),
        effect("delay", T=0.0337, longest=0.06),
        effect("lag", T=0.061),
        effect("sensor_delay", T=0.047, longest=0.06),
        effect("angle_offset", offset=0.03),
    ),
}


def records(model: Model, lengths: tuple[int, ...] = (40, 11, 60)) -> list[Record]:
    """Rollouts of different lengths, without noise."""
    rng = np.random.default_rng(0)
    made = []
    for i, n in enumerate(lengths):
        u = multisine(rng, n, model.dt, 2.0, 3.0)
        run = simulate(model, u, math.pi + rng.uniform(-1.0, 1.0), rng.uniform(-2.0, 2.0))
        made.append(Record(run.t, u, run.theta_read, run.theta_dot_read, name=f"rollout {i}"))
    return made


def near(samples: Samples) -> Motion:
    """Some motion that is none of the model's, d and all."""
    rng = np.random.default_rng(1)
    x = samples.smoothed + rng.standard_normal((len(samples), 2)) * (0.05, 0.3)
    return Motion(x, rng.standard_normal(len(samples)), np.zeros((len(samples), 3)))


def stepped(model: Model, samples: Samples, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Ends (M, 2) of the steps and readings (M, 2), in units of the sensor's sd, one instant after the other."""
    ends, seen = np.zeros((len(samples), 2)), np.zeros((len(samples), 2))
    for record, first in zip(samples.records, samples.first, strict=False):
        drives = list(model.drives(record.commands.tolist()))[len(record.previous_commands) :]
        sensing = model.sensing(*motion.x[first])
        for k in range(len(record) + 1):
            x, now = motion.x[first + k], float(record.time_since_start[k])
            reading, sensing = model.read(x[0], x[1], sensing, now)
            seen[first + k] = np.array(reading) * samples.weight[first + k]
            if k < len(record):
                torque = float(model.inertia()) * motion.d[first + k]
                ends[first + k] = model.move(x[0], x[1], tuple(u + torque for u in drives[k]), now)
    return ends, seen


def ahead(values: np.ndarray, samples: Samples, by: tuple[int, int]) -> np.ndarray:
    """Readings (M, 2) at the instants that they show: `by` rows earlier, 0 where their record has none."""
    moved = np.zeros_like(values)
    for first, last in zip(samples.first[:-1], samples.first[1:], strict=True):
        for channel, rows in enumerate(by):
            moved[first : last - rows, channel] = values[first + rows : last, channel]
    return moved


def test_records_of_all_lengths_stand_one_after_the_other_and_count_from_their_own_start() -> None:
    given = records(JOINT, (7, 1, 30))
    given[2] = replace(given[2], t=given[2].t + 7.0)
    samples = Samples(JOINT, given, SENSOR)
    assert len(samples) == 8 + 2 + 31 and samples.readings == 2 * len(samples)
    np.testing.assert_array_equal(np.bincount(samples.number), [8, 2, 31])
    assert np.flatnonzero(~samples.follows).tolist() == [7, 9, 40]
    for column, name in enumerate(("theta", "theta_dot")):
        np.testing.assert_allclose(samples.y[:, column], np.concatenate([getattr(r, name) for r in given]), atol=1e-12)
    np.testing.assert_allclose(samples.weight, np.tile(1.0 / np.array([0.003, 0.05]), (len(samples), 1)))
    np.testing.assert_allclose(samples.t, np.concatenate([r.t for r in given]), atol=1e-12)
    np.testing.assert_allclose(samples.time_since_start, np.concatenate([r.t - r.t[0] for r in given]), atol=1e-12)
    np.testing.assert_array_equal(samples.drives(JOINT)[samples.follows, 0], np.concatenate([r.u for r in given]))


def test_records_of_the_same_length_are_driven_as_each_alone() -> None:
    model = Model(GeneralJoint(), SHOWN["all at once"], dt=DT)
    first, *others = records(model, (40, 11, 40, 1))
    pieces = [first.part(first_row, last_row) for first_row, last_row in ((5, 25), (20, 40))]
    samples = Samples(model, [first, *others, *pieces], Sensor(theta=1e-3))
    for record, begin in zip(samples.records, samples.first, strict=False):
        alone = model.drive_record(record.commands)[len(record.previous_commands) :]
        np.testing.assert_array_equal(samples.drives(model)[begin : begin + len(record)], alone)


def test_slopes_are_the_models_derivatives() -> None:
    """Against those that CasADi takes of the same equations, exactly."""
    samples = Samples(SMOOTH, records(SMOOTH), SENSOR)
    motion = near(samples)
    system = LinearisedModel(samples, SMOOTH, motion).system
    z, u, t = casadi.SX.sym("z", 3), casadi.SX.sym("u"), casadi.SX.sym("t")
    end = casadi.vertcat(*SMOOTH.move(z[0], z[1], (u + SMOOTH.inertia() * z[2],) * 2, t))
    slope = casadi.Function("slope", [z, u, t], [casadi.jacobian(end, z)])
    command = np.concatenate([np.append(r.u, 0.0) for r in samples.records])
    for k in np.flatnonzero(samples.follows):
        exact = np.array(slope([*motion.x[k], motion.d[k]], command[k], samples.time_since_start[k]))
        np.testing.assert_allclose(system.A[k], exact, rtol=1e-6, atol=1e-8)
    assert not np.any(system.A[~samples.follows]) and not np.any(system.gap[~samples.follows])


@pytest.mark.parametrize("effects", SHOWN.values(), ids=SHOWN.keys())
def test_a_motion_of_the_model_has_no_gaps_and_no_residuals(effects: tuple[Effect, ...]) -> None:
    """Under a random torque too: x and d together end where the next instant begins."""
    model = replace(JOINT, effects=effects)
    rng, n = np.random.default_rng(3), 120
    u = multisine(rng, n, DT, 2.0, 3.0)
    samples = Samples(model, [Record(DT * np.arange(n + 1), u, np.zeros(n + 1))], Sensor(theta=0.003))
    drives, x = list(model.drives(u.tolist())), np.zeros((n + 1, 2))
    d = 2.0 * rng.standard_normal(n + 1)
    x[0] = math.pi, 1.0
    for k in range(n):
        x[k + 1] = model.move(
            *x[k], tuple(v + float(model.inertia()) * d[k] for v in drives[k]), float(samples.time_since_start[k])
        )
    samples.y[:, 0] = model.read_record(x[:, 0], x[:, 1], samples.time_since_start).theta
    system = LinearisedModel(samples, model, Motion(x, d, np.zeros((n + 1, 3)))).system
    np.testing.assert_allclose(system.gap + system.A[:, :, 2] * d[:, None] * samples.follows[:, None], 0.0, atol=1e-9)
    np.testing.assert_allclose(system.r, 0.0, atol=1e-9)


@pytest.mark.parametrize("effects", SHOWN.values(), ids=SHOWN.keys())
def test_changes_are_differences_of_the_model_itself(effects: tuple[Effect, ...]) -> None:
    model = replace(JOINT, effects=effects)
    samples = Samples(model, records(model), SENSOR)
    motion = near(samples)
    # d is an acceleration that stays: the torque that makes it goes with the inertia, here as there
    linearised = LinearisedModel(samples, model, motion)
    names = list(model.parameters)
    G, R = linearised.changes(names)
    size = np.zeros(len(names))
    for i, name in enumerate(names):
        value = float(model.parameters[name].value)
        h = 1e-4 * abs(value)
        (up, seen_up), (down, seen_down) = (
            stepped(model.with_parameters({name: value + side * h}), samples, motion) for side in (1.0, -1.0)
        )
        read = ahead((seen_up - seen_down) / (2.0 * h), samples, linearised.ahead)
        for slope, expected in ((G[:, :, i], (up - down) / (2.0 * h)), (R[:, :, i], read)):
            np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-6 * max(1.0, np.abs(expected).max()))
            size[i] += float(np.abs(expected).max())
    assert np.all(size > 1e-4), "a parameter moved nothing, and was not tested"


@pytest.mark.parametrize("effects", SHOWN.values(), ids=SHOWN.keys())
def test_readings_change_with_the_motion_as_their_slopes_say(effects: tuple[Effect, ...]) -> None:
    """A motion that lies a + b t beside another shows it, however late its sensors are."""
    model = replace(JOINT, effects=effects)
    samples = Samples(model, records(model), SENSOR)
    motion, a, b = near(samples), 1e-4, 2e-4
    linearised = LinearisedModel(samples, model, motion)
    beside = np.column_stack([a + b * samples.time_since_start, np.full(len(samples), b)])
    before, after = (stepped(model, samples, replace(motion, x=motion.x + side * beside))[1] for side in (-1.0, 1.0))
    shown = ahead(0.5 * (after - before), samples, linearised.ahead)
    expected = np.einsum("mij,mj->mi", linearised.system.H, beside)
    np.testing.assert_allclose(shown, expected, rtol=1e-4, atol=1e-5)


def test_a_late_sensor_is_moved_to_the_instant_that_it_shows() -> None:
    model = replace(JOINT, effects=(effect("sensor_delay", T=3.0 * DT, longest=0.1),))
    samples = Samples(model, records(model), SENSOR)
    linearised = LinearisedModel(samples, model, near(samples))
    assert linearised.ahead == (3, 3)
    H, plain = linearised.system.H, np.eye(2) / np.array([[0.003], [0.05]])
    for first, last in zip(samples.first[:-1], samples.first[1:], strict=True):
        np.testing.assert_allclose(H[first + 3 : last - 3], np.broadcast_to(plain, (last - first - 6, 2, 2)), atol=1e-5)
        assert not np.any(H[last - 3 : last]) and not np.any(linearised.system.r[last - 3 : last])


def test_a_delay_shows_though_the_joint_sticks_where_a_substep_ends() -> None:
    """A servo stands at each of its steps. They arrive as a substep ends, and a little of one moves nothing."""
    effects = (effect("coulomb", tau_c=0.1), effect("delay", T=1.5 * DT - 2e-6, longest=0.06))
    model = Model(GeneralJoint(J=0.01, G=0.3), (PositionServo(k_p=8.0, k_d=0.4), *effects), RK4(substeps=2), DT)
    u = math.pi + np.repeat([0.0, 0.4, -0.2, 0.3, 0.0], 40)
    run = simulate(model, u, math.pi, 0.0)
    samples = Samples(model, [Record(run.t, u, run.theta_read)], Sensor(theta=1e-3))
    motion = Motion(np.column_stack([run.theta, run.theta_dot]), np.zeros(len(samples)), np.zeros((len(samples), 3)))
    G, _ = LinearisedModel(samples, model, motion).changes(("delay.T",))
    assert np.max(np.abs(G)) > 1.0


@pytest.mark.parametrize("c", [0.5, 0.85, 1.3])
def test_a_speed_that_reads_too_little_is_no_late_one(c: float) -> None:
    """Scaled with its noise, it tells as much: the innovations are those of the speed as it is."""
    made, disturbances = records(JOINT, (200, 120)), Disturbances(s=1.0, T=0.5, sigma_o=0.02, T_o=0.5)
    plain = Samples(JOINT, made, SENSOR)
    motion = near(plain)
    gained = replace(JOINT, effects=(effect("velocity_gain", c=c),))
    scaled = [replace(r, theta_dot=c * r.theta_dot) for r in made if r.theta_dot is not None]
    read = LinearisedModel(Samples(gained, scaled, replace(SENSOR, theta_dot=0.05 * c)), gained, motion)
    assert read.ahead == (0, 0)
    here = LinearisedModel(plain, JOINT, motion).system.filter(disturbances)
    np.testing.assert_allclose(read.system.filter(disturbances).innovations, here.innovations, rtol=1e-6, atol=1e-6)


EFFECTS = {
    "viscous": {"b": 1e-5},
    "coulomb": {"tau_c": 1e-6},
    "drift": {"r": 1e-5},
    "ripple": {"a": 1e-5},
    "rotor_inertia": {"J_r": 1e-6},
    "delay": {"T": 1e-6},
    "lag": {"T": 1e-6},
    "torque_gain": {"c": 1.0 + 1e-5},
    "angle_offset": {"offset": 1e-5},
    "sensor_delay": {"T": 1e-6},
    "velocity_bias": {"bias": 1e-5},
}


@pytest.mark.parametrize(("name", "number"), EFFECTS.items(), ids=EFFECTS.keys())
def test_what_an_effect_would_change_is_what_its_parameter_changes(name: str, number: dict[str, float]) -> None:
    """Tried from outside, per unit of size, or freed inside a model that has it at nothing."""
    samples = Samples(JOINT, records(JOINT), SENSOR)
    motion = near(samples)
    ((key, value),) = number.items()
    neutral = effect(name).at_neutral()
    size = value - float(neutral.parameters[key].neutral)
    tried = [neutral.with_parameters({key: value}), neutral.with_parameters({key: value + size})]
    changes = LinearisedModel(samples, JOINT, motion).effect_changes(tried, [size, 2.0 * size])
    freed = LinearisedModel(samples, JOINT.with_effect(neutral), motion).changes([f"{name}.{key}"])
    assert max(np.abs(v).max() for v in freed) > 1e-4
    for change, expected in zip(changes, freed, strict=True):
        assert change.shape == (len(samples), 2, 2)
        scale = max(1.0, float(np.abs(expected).max()))
        np.testing.assert_allclose(change, np.repeat(expected, 2, axis=2), rtol=1e-3, atol=1e-4 * scale)


def test_a_joint_that_sticks_has_slopes_wide_enough_to_leave() -> None:
    """At rest under friction c nothing moves it a little; d up to 3 c leaves with d - c, two thirds of its own."""
    model = replace(JOINT, effects=(effect("coulomb", tau_c=0.3),))
    rest = Record(DT * np.arange(41), np.zeros(40), np.full(41, math.pi), np.zeros(41))
    samples, c = Samples(model, [rest], SENSOR), 0.3 / 0.3
    at, still = np.tile([math.pi, 0.0], (41, 1)), np.zeros(41)
    slopes = [
        LinearisedModel(samples, model, Motion(at, still, np.tile([0.0, 0.0, wide], (41, 1)))).system.A[:-1, 1, 2]
        for wide in (0.5 * c, 3.0 * c)
    ]
    np.testing.assert_allclose(slopes[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(slopes[1], 2.0 / 3.0 * DT, rtol=0.01)


def test_a_filter_lets_a_joint_that_seemed_to_stick_go() -> None:
    """From a motion at rest, in a model whose friction holds, readings that move are followed."""
    model = replace(JOINT, effects=(effect("coulomb", tau_c=0.3),))
    t = DT * np.arange(101)
    moves = math.pi + 0.5 * (1.0 - np.cos(2.0 * t))
    samples = Samples(model, [Record(t, np.zeros(100), moves, np.sin(2.0 * t))], SENSOR)
    loose = Disturbances(10.0, T=0.3)
    motion = Motion(np.tile([math.pi, 0.0], (101, 1)), np.zeros(101), np.tile([1e-3, 0.05, 10.0], (101, 1)))
    states = motion.x + LinearisedModel(samples, model, motion).system.filter(loose).smooth()[:, :2]
    assert np.max(np.abs(states[:, 0] - moves)) < 0.02


def test_pieces_of_a_rollout_are_the_rollout() -> None:
    """Time counts from its start and drives remember what came before, also where a log was cut."""
    model = replace(JOINT, effects=(*SMOOTH.effects, effect("delay", T=0.0337, longest=0.06), effect("lag", T=0.061)))
    (whole,) = records(model, (150,))
    pieces = [whole.part(0, 60), whole.part(60, 61), whole.part(61, 150)]
    one, cut = Samples(model, [whole], SENSOR), Samples(model, pieces, SENSOR)
    rows = np.concatenate([np.arange(0, 61), np.arange(60, 62), np.arange(61, 151)])
    np.testing.assert_allclose(cut.time_since_start, one.time_since_start[rows], atol=1e-12)
    np.testing.assert_allclose(cut.time_since_start, cut.t, atol=1e-12)
    motion = near(one)
    uncut = LinearisedModel(one, model, motion)
    again = LinearisedModel(cut, model, Motion(motion.x[rows], motion.d[rows], motion.spread[rows]))
    names = list(model.parameters)
    inside = cut.follows
    for a, b in ((uncut.system.A, again.system.A), (uncut.system.gap, again.system.gap), (uncut.ends, again.ends)):
        np.testing.assert_allclose(b[inside], a[rows][inside], atol=1e-7)
    np.testing.assert_allclose(
        again.changes(names)[0][inside], uncut.changes(names)[0][rows][inside], rtol=1e-6, atol=1e-7
    )


def test_the_start_of_a_fit_follows_the_readings_without_a_model() -> None:
    """Smoothed readings move as the joint did, and their level is the rms of its acceleration."""
    rng, n = np.random.default_rng(4), 300
    run = simulate(JOINT, multisine(rng, n, DT, 2.0, 2.0), math.pi, 0.0)
    samples = Samples(JOINT, SENSOR.measure(run, rng), SENSOR)
    motion = smoothed_motion(samples, 2.0)
    assert np.sqrt(np.mean((motion.x[:, 0] - run.theta) ** 2)) < 0.003
    assert np.sqrt(np.mean((motion.x[:, 1] - run.theta_dot) ** 2)) < 0.05
    assert not np.any(motion.d) and np.all(motion.spread[:, 2] == 2.0)
    acceleration = np.diff(run.theta_dot) / DT
    assert level(samples) == pytest.approx(float(np.sqrt(np.mean(acceleration**2))), rel=0.2)
