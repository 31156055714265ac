"""The torque beyond a model: it is found where there is one, and is zero within its band where there is none."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sysid import RK4, GeneralJoint, InvalidInput, Model, Record, RodPendulum, Sensor, effect, simulate
from sysid.diagnosis.residual_torque import ResidualTorque, missing_torque, residual_torque
from sysid.estimation.linearisation import Samples
from sysid.estimation.solver import fit_parameters
from sysid.physics.effects import Effect, Joint
from sysid.physics.ops import Value
from sysid.planning.excitation import multisine
from tests.sysid.planted import DT, SENSOR, Unknown, with_memory
from tests.sysid.written import of_real_machine

ANGLE = Sensor(theta=0.003)
MODEL = Model(RodPendulum(m=1.0, l=1.0, g=9.81), integrator=RK4(substeps=4), dt=DT)


def pulse(joint: Joint) -> Value:
    """A gust at 4 s."""
    return 0.4 * np.exp(-0.5 * ((joint.t - 4.0) / 0.25) ** 2) + 0.0 * joint.theta


def magnet(joint: Joint) -> Value:
    """A bump at 3.5 rad, 0.3 rad wide."""
    away = np.mod(joint.theta - 3.5 + math.pi, 2.0 * math.pi) - math.pi
    return 0.3 * np.exp(-0.5 * (away / 0.3) ** 2)


Made = tuple[list[Record], np.ndarray]
"""Records, and the true extra torque (R, N), meant over each interval."""


def made(
    curve: Callable[[Joint], Value] | None = None,
    sensor: Sensor = SENSOR,
    effects: tuple[Effect, ...] = (),
    rollouts: int = 6,
    n: int = 400,
    largest: float = 2.5,
) -> Made:
    rng = np.random.default_rng(1)
    hidden = () if curve is None else (Unknown(curve=curve),)
    truth = replace(MODEL, effects=(*effects, *hidden), integrator=RK4(substeps=16))
    u = np.array([multisine(rng, n, DT, largest, 2.0) for _ in range(rollouts)])
    run = simulate(truth, u, math.pi + rng.uniform(-1.0, 1.0, rollouts), np.zeros(rollouts))
    if curve is None:
        return sensor.measure(run, rng), np.zeros((rollouts, n))
    ends = curve(Joint(run.theta, run.theta_dot, run.t, 0.0, 0.0, truth.plant))
    middle = [0.5 * (v[..., 1:] + v[..., :-1]) for v in (run.theta, run.theta_dot, run.t)]
    inner = curve(Joint(*middle, 0.0, 0.0, truth.plant))
    return sensor.measure(run, rng), (ends[:, :-1] + 4.0 * inner + ends[:, 1:]) / 6.0


def torques(answer: ResidualTorque) -> tuple[np.ndarray, np.ndarray]:
    """d and sd (R, N)."""
    return np.stack([r.d for r in answer.records]), np.stack([r.sd for r in answer.records])


@pytest.mark.parametrize("sensor", [SENSOR, ANGLE], ids=["angle and speed", "angle only"])
@pytest.mark.parametrize(("curve", "name"), [(pulse, "time"), (magnet, "theta")], ids=["pulse", "magnet"])
def test_a_torque_that_the_model_lacks_is_recovered_within_its_band(
    curve: Callable[[Joint], Value], name: str, sensor: Sensor
) -> None:
    records, truth = made(curve, sensor)
    answer = residual_torque(MODEL, records, sensor)
    d, sd = torques(answer)
    acting = truth > 0.02
    assert answer.present and answer.converged
    assert np.sqrt(np.mean((d - truth)[acting] ** 2)) < 0.15 * truth.max()
    assert np.mean(np.abs(d - truth)[acting] < 2.0 * sd[acting]) > 0.88
    assert answer.rms == pytest.approx(np.sqrt(np.mean(truth**2)), rel=0.1)
    assert name == "time" or answer.dependence.shares[name] > 0.8
    low, high = answer.over(name).peak
    assert low < (4.0 if name == "time" else 3.5) < high
    assert answer.depends_on == (name,)


def test_the_band_holds_the_truth_as_often_as_it_says() -> None:
    """Torques drawn from what is taken for granted: 95 % of samples within two sd, size and memory found again."""
    s, T, inside, found = 0.2, 0.3, [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        D = with_memory(s * rng.standard_normal((401, 4)).T[:, :-1], T)
        u = np.array([multisine(rng, 400, DT, 2.5, 2.0) for _ in range(4)])
        run = simulate(replace(MODEL, integrator=RK4(substeps=8)), u + D, math.pi, np.zeros(4))
        records = [replace(r, u=own) for r, own in zip(SENSOR.measure(run, rng), u, strict=True)]
        answer = residual_torque(MODEL, records, SENSOR)
        own, sd = torques(answer)
        inside.append(np.mean(np.abs(own - D) < 2.0 * sd))
        found.append((answer.s, answer.T))
    assert 0.90 < np.mean(inside) < 0.99
    assert np.mean([own for own, _ in found]) == pytest.approx(s, rel=0.2)
    assert [memory for _, memory in found] == [T] * 3


@pytest.mark.parametrize(
    "effects",
    [(), (effect("coulomb", tau_c=0.15),), (effect("sensor_delay", T=0.03),), (effect("lag", T=0.05),)],
    ids=["nothing", "a joint that sticks", "a sensor that remembers", "a drive that lags"],
)
def test_a_right_model_needs_no_torque(effects: tuple[Effect, ...]) -> None:
    records, _ = made(effects=effects, rollouts=4, largest=0.5 if effects else 2.5)
    answer = residual_torque(replace(MODEL, effects=effects), records, SENSOR)
    d, sd = torques(answer)
    assert not answer.present and answer.depends_on == () and answer.contacts == ()
    assert np.mean(np.abs(d) < 2.0 * sd) > 0.95
    assert 0.0 < answer.band < 0.01
    assert "No torque beyond the model is visible" in str(answer)


def test_a_torque_is_seen_beside_a_friction_that_sticks() -> None:
    friction = (effect("coulomb", tau_c=0.15),)
    records, truth = made(pulse, effects=friction, rollouts=4)
    answer = residual_torque(replace(MODEL, effects=friction), records, SENSOR)
    d, sd = torques(answer)
    assert answer.depends_on == ("time",)
    assert np.sqrt(np.mean((d - truth) ** 2)) < 0.02 and np.mean(np.abs(d - truth) < 2.0 * sd) > 0.9


def test_a_friction_too_large_is_given_back_along_the_motion() -> None:
    records, _ = made(effects=(effect("coulomb", tau_c=0.1),), rollouts=4, largest=0.6)
    answer = residual_torque(replace(MODEL, effects=(effect("coulomb", tau_c=0.3),)), records, SENSOR)
    for r in answer.records:
        moving = np.abs(r.theta_dot[:-1]) > 0.5
        assert np.mean(r.d[moving] * np.sign(r.theta_dot[:-1][moving])) == pytest.approx(0.2, abs=0.04)


@pytest.mark.long
def test_cost_is_linear_in_samples() -> None:
    records, _ = made(magnet, rollouts=8)

    def seconds(times: int) -> float:
        begin = time.process_time()
        residual_torque(MODEL, records * times, SENSOR)
        return time.process_time() - begin

    seconds(1)  # what is built once
    short, long = min(seconds(1) for _ in range(3)), min(seconds(4) for _ in range(2))
    assert long < 4.0 * 1.5 * short


def test_records_of_any_length_and_of_a_moment() -> None:
    records, _ = made(pulse, rollouts=3)
    cut = [records[0], records[1].head(150), records[2].head(1)]
    answer = residual_torque(MODEL, cut, SENSOR)
    assert [len(r.d) for r in answer.records] == [400, 150, 1]
    assert [len(r.theta) for r in answer.records] == [401, 151, 2]
    for record in cut:
        assert np.all(np.isfinite(torques(residual_torque(MODEL, [record], SENSOR))))


def test_a_joint_at_rest_says_what_could_hide() -> None:
    still = Record(DT * np.arange(101), np.zeros(100), np.full(101, math.pi), np.zeros(101))
    answer = residual_torque(MODEL, [still], SENSOR)
    assert not answer.present and 0.0 < answer.band < 0.1


def test_the_answer_speaks_and_is_plain_data() -> None:
    records, _ = made(magnet, rollouts=3)
    answer = residual_torque(MODEL, records, SENSOR)
    assert "N m rms" in str(answer) and "acts beyond the model; it depends on theta, strongest" in str(answer)
    data = json.loads(json.dumps(answer.to_dict(), allow_nan=False))
    assert set(data["over"]) == {"theta", "theta_dot", "torque", "time"}
    assert data["present"] and len(data["records"]) == 3 and len(data["records"][0]["d"]) == 400


def test_bad_input_is_one_sentence() -> None:
    records, _ = made(sensor=ANGLE, rollouts=1, n=20)
    answer = residual_torque(MODEL, records, ANGLE)
    with pytest.raises(InvalidInput, match="expected one of theta, theta_dot, torque, time"):
        answer.over("phase")
    with pytest.raises(InvalidInput, match="no theta_dot readings"):
        residual_torque(MODEL, records, SENSOR)
    with pytest.raises(InvalidInput, match="no records"):
        residual_torque(MODEL, [], SENSOR)


@pytest.mark.parametrize(
    ("name", "quiet", "pushes"),
    [("dfki_sp_sac", 6.0, (14.4, 18.1, 22.1)), ("dfki_sp_energy_shaping", 6.0, (7.2, 12.2, 16.1))],
)
def test_hands_on_a_real_pendulum(name: str, quiet: float, pushes: tuple[float, ...]) -> None:
    """Pushes by hand at about these times, none before `quiet` [s] (the logs' own description)."""
    records = of_real_machine(name).records
    friction = (effect("viscous", b=0.01), effect("coulomb", tau_c=0.15))
    model = Model(GeneralJoint(J=0.18, G=3.6), effects=friction, integrator=RK4(substeps=1), dt=records[0].dt)
    found = residual_torque(model, records, Sensor(theta=0.01, theta_dot=0.3)).contacts
    assert min(t.t_begin for t in found) > quiet
    for push in pushes:
        assert any(t.t_begin - 0.3 < push < t.t_end + 0.3 for t in found), push


def test_rollouts_too_short_to_average_over_show_a_torque_all_the_same() -> None:
    records, _ = made(magnet, n=400, rollouts=2)
    short = [replace(r.head(15), name=f"{r.name}, {k}") for k, r in enumerate(records)]
    samples = Samples(MODEL, short, SENSOR)
    found = fit_parameters(samples, MODEL, ("m",))
    assert 15 * DT < 0.4
    assert np.all(np.isfinite(missing_torque(found, found.disturbances)))
