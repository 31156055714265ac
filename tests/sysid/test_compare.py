"""compare says where a model fails, and says nothing of a model that does not."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from sysid import (
    Coulomb,
    Delay,
    Drag,
    Drift,
    Effect,
    Lag,
    LinearAxis,
    Model,
    PointMassPendulum,
    Record,
    Ripple,
    RodPendulum,
    Saturation,
    Sensor,
    SensorDelay,
    Stamp,
    Tilt,
    TorqueBias,
    TorqueGain,
    VelocityBias,
    VelocityGain,
    Viscous,
    fit,
    simulate,
)
from sysid.diagnosis.compare import Comparison, compare
from sysid.planning.excitation import multisine, steps
from tests.sysid import planted
from tests.sysid.planted import SENSOR, pushed, under_control

ROD = Model(RodPendulum(m=1.0, l=0.9), dt=0.02)
logs = partial(planted.logs, n=4, seconds=6.0)
multisines = partial(logs, draw=partial(multisine, u_max=1.5, f_max=2.5))


def comparison(*effects: Effect, seed: int = 0, logs: Callable[..., list[Record]] = logs) -> Comparison:
    """ROD against logs of ROD with effects."""
    return compare(ROD, logs(replace(ROD, effects=effects), seed), SENSOR)


@pytest.fixture(scope="module")
def perfect() -> list[Comparison]:
    """The true model against 40 logs."""
    return [compare(ROD, logs(ROD, seed, n=2, seconds=4.0), SENSOR) for seed in range(40)]


def test_a_perfect_model_is_called_so(perfect: list[Comparison]) -> None:
    """In at least 95 of 100 logs."""
    assert sum(c.adequate for c in perfect) >= 38
    assert not any(c.causes for c in perfect)
    assert all("nothing is missing" in c.sentence for c in perfect if c.adequate)
    for c in perfect:
        assert c.torque is not None
        assert c.adequate == (not (c.torque.present or c.off or c.surprises))


def test_innovations_of_a_perfect_model_are_white(perfect: list[Comparison]) -> None:
    """p below 0.1 in 4 of 40 +- 3 sd, below 0.5 in 20 of 40 +- 3 sd; 99 % of the autocorrelations in their band."""
    for channel in ("theta", "theta_dot"):
        p = np.array([c.whiteness[channel].p_value for c in perfect])
        assert np.sum(p < 0.1) <= 10, channel
        assert 10 <= np.sum(p < 0.5) <= 30, channel
    outside = [np.mean(np.abs(w.correlation) > w.band) for c in perfect for w in c.whiteness.values()]
    assert np.mean(outside) < 0.02


def test_ratios_of_a_perfect_model_are_one_at_every_horizon(perfect: list[Comparison]) -> None:
    for name in perfect[0].errors:
        ratio = np.array([c.errors[name].ratio for c in perfect])
        assert abs(np.mean(ratio) - 1.0) < 4.0 * np.std(ratio) / math.sqrt(len(ratio)), name
        assert np.std(ratio) < 0.05, name


def test_the_map_of_a_perfect_model_is_flat(perfect: list[Comparison]) -> None:
    assert np.mean([np.any(c.torque.map.significant) for c in perfect if c.torque is not None]) < 0.1
    beyond = [np.abs(b.mean) > 2.5758 * b.sd for c in perfect if c.torque for b in c.torque.binned.values()]
    assert np.mean(np.concatenate(beyond)) < 0.02


@pytest.mark.long
@pytest.mark.parametrize("driven", [logs, multisines], ids=["steps", "multisine"])
@pytest.mark.parametrize("lag", [1, 2, 4])
def test_a_delay_is_named_with_its_size(lag: int, driven: Callable[..., list[Record]]) -> None:
    T = lag * ROD.dt
    c = comparison(Delay(T=T, longest=0.1), logs=driven)
    assert c.causes[0].effect == "delay" or "delay" in c.causes[0].indistinguishable
    (size,) = c.causes[0].numbers.values()
    assert abs(size["value"]) == pytest.approx(T if c.causes[0].effect == "delay" else lag, rel=0.05)
    assert c.torque is not None and c.torque.depends_on == ("history",)
    assert not c.adequate


def towards(goal: np.ndarray, k: int, theta: float, theta_dot: float) -> float:
    return float(np.clip(-4.0 * (theta - goal[k]) - theta_dot, -4.0, 4.0))


def held_at(model: Model, seed: int) -> list[Record]:
    """Rollouts in which a PD controller turns the joint from one angle to the next: the torque follows the readings."""
    rng, N, records = np.random.default_rng(seed), round(6.0 / model.dt), []
    for i in range(3):
        goal = math.pi + np.repeat(rng.uniform(-1.0, 1.0, N // 50 + 1), 50)
        start = math.pi + rng.uniform(-0.5, 0.5)
        errors = rng.standard_normal((N + 1, 2)) * (SENSOR.theta, SENSOR.theta_dot)
        u, x = under_control(model, partial(towards, goal), start, errors)
        records.append(Record(model.dt * np.arange(N + 1), u, *(x + errors).T, name=f"rollout {i}"))
    return records


@pytest.mark.parametrize("seed", range(3))
def test_under_feedback_a_delay_is_a_delay(seed: int) -> None:
    """The torque is computed from the motion: the coming torque tells of the motion as well as the past one does."""
    c = compare(ROD, held_at(ROD.with_effect(Delay(T=0.06, longest=0.1)), seed), SENSOR)
    assert [cause.effect for cause in c.causes] == ["delay"]
    assert c.causes[0].numbers["delay.T"]["value"] == pytest.approx(0.06, abs=0.002)
    assert "a delay of the torque of about 60 ms" in c.sentence
    assert compare(ROD, held_at(ROD, seed), SENSOR).adequate


def test_a_stamp_of_the_next_row_is_told_from_a_delay() -> None:
    c = comparison(Stamp(s=-1.0))
    assert c.causes[0].effect == "stamp"
    assert c.causes[0].numbers["stamp.s"]["value"] == pytest.approx(-1.0, abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "depends_on", "words"),
    [
        (Viscous(b=0.05), "theta_dot", "viscous friction of about 0.05 N m s/rad"),
        (Coulomb(tau_c=0.08), "theta_dot", "dry friction of about 0.08 N m"),
        (Drag(c=0.03), "theta_dot", "air drag of about 0.03 N m s^2/rad^2"),
        (Tilt(alpha=0.05), "theta", "a base that leans"),
        (Ripple(a=0.15, b=0.1, order=5.0), "theta", "a ripple over the angle"),
        (Saturation(limit=1.0), "torque", "a limit of the torque of about"),
        (Lag(T=0.04), "history", "a lag of the torque of about 4"),
        (SensorDelay(T=0.04), "history", "a delay of the"),
        (Drift(r=0.1), None, "a torque that drifts of about 0.1 N m/s"),
        (TorqueBias(tau_0=0.1), None, "a constant torque of about"),
        (TorqueGain(c=0.85), "torque", "a factor on the torque of about 0.85"),
        (VelocityBias(bias=0.1), None, "an offset of the speed readings of about"),
        (VelocityGain(c=1.05), None, "a factor on the speed readings of about"),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_the_effect_that_is_missing_is_named_and_where_its_torque_acts(
    effect: Effect, depends_on: str | None, words: str
) -> None:
    c = comparison(effect)
    assert c.causes[0].share > 0.8
    assert words in c.sentence
    assert c.off and c.torque is not None
    if depends_on is not None:
        assert c.torque.depends_on == (depends_on,)


@pytest.mark.parametrize("effect", [Viscous(b=0.05), Coulomb(tau_c=0.08), Tilt(alpha=-0.04), Ripple(0.1, 0.05, 5.0)])
def test_the_promised_size_is_the_planted_one(effect: Effect) -> None:
    cause = comparison(effect).causes[0]
    for name, p in effect.parameters.items():
        if p.neutral is None:
            continue
        number = cause.numbers.get(f"{effect.name}.{name}") or next(iter(cause.numbers.values()))
        assert abs(number["value"]) == pytest.approx(abs(float(p.value)), rel=0.1)
        assert 0.0 < number["sd"] < 0.1 * abs(number["value"])


def test_two_effects_at_once() -> None:
    c = comparison(Delay(T=0.04), Viscous(b=0.1))
    assert {cause.effect for cause in c.causes} == {"delay", "viscous"}
    assert sum(cause.share for cause in c.causes) > 0.9


def test_numbers_of_the_plant_that_are_off() -> None:
    heavy = Model(RodPendulum(m=1.05, l=0.945), dt=ROD.dt)
    c = compare(ROD, logs(heavy), SENSOR)
    assert [cause.effect for cause in c.causes] == ["plant"]
    inertia, gravity = (v["value"] for v in c.causes[0].numbers.values())
    assert inertia == pytest.approx(1.05**3 - 1.0, abs=0.02)
    assert gravity == pytest.approx(1.05**2 - 1.0, abs=0.02)
    assert "inertia is about +16% off and gravity torque is about +10% off" in c.sentence


def test_what_an_estimates_numbers_would_absorb_is_no_cause() -> None:
    """Of a fit, m and l were free: that they are off beside a missing friction is no second cause."""
    records = logs(ROD.with_effect(Coulomb(tau_c=0.15)))
    estimate = fit(ROD, records, SENSOR, ["m", "l"])
    c = compare(estimate, logs(ROD.with_effect(Coulomb(tau_c=0.15)), seed=1))
    assert [cause.effect for cause in c.causes] == ["coulomb"]
    assert c.causes[0].numbers["coulomb.tau_c"]["value"] == pytest.approx(0.15, rel=0.1)


def test_where_the_fitted_numbers_are_others_in_these_records_that_is_said() -> None:
    """A mass that was changed after the fit, beside a friction that the model lacks."""
    rubbed = replace(ROD, plant=RodPendulum(m=1.15, l=0.9)).with_effect(Coulomb(tau_c=0.1))
    c = compare(ROD, logs(rubbed), SENSOR, ["m", "l"])
    assert [cause.effect for cause in c.causes] == ["plant", "coulomb"]
    assert c.causes[1].numbers["coulomb.tau_c"]["value"] == pytest.approx(0.1, rel=0.05)
    assert "the model's own numbers are others here" in c.sentence and "something else" not in c.sentence
    assert sum(cause.share for cause in c.causes) > 0.95


@pytest.mark.parametrize("seed", range(3))
def test_the_curves_are_the_missing_torque(seed: int) -> None:
    b = 0.05
    torque = comparison(Viscous(b=b), seed=seed).torque
    assert torque is not None
    over = torque.over("theta_dot")
    middle, seen = 0.5 * (over.edges[1:] + over.edges[:-1]), over.count > 20
    assert np.max(np.abs(over.mean + b * middle)[seen] / over.sd[seen]) < 4.0
    assert np.ptp(over.mean[seen]) > 20.0 * np.median(over.sd[seen])
    found, middle = torque.map, 0.5 * (torque.map.theta_dot[1:] + torque.map.theta_dot[:-1])
    error = (found.torque + b * middle)[found.significant]
    assert np.sum(found.significant) > 10
    assert np.sqrt(np.mean(error**2)) < 0.3 * b * np.max(np.abs(middle))


def test_a_gust_is_found_in_its_rollout() -> None:
    push = np.zeros(300)
    push[25:50], push[150:175] = 0.4, 0.6
    c = compare(ROD, pushed(logs(ROD), 2, ROD, push, seed=1), SENSOR)
    assert c.causes == () and c.torque is not None
    assert c.torque.depends_on == ("time",)
    assert "depends on nothing that was read, strongest in pushed at 3." in c.sentence
    assert {t.name for t in c.torque.contacts} == {"pushed"}
    assert c.worst[0].record == "pushed"


def test_what_a_hand_touched_is_set_apart() -> None:
    """A hand that pushes once; beyond it the friction that is missing is still seen."""
    push = np.zeros(300)
    push[155:165] = 15.0
    rubbing = ROD.with_effect(Viscous(b=0.03))
    c = compare(ROD, pushed(logs(rubbing), 2, rubbing, push, seed=1), SENSOR)
    assert c.worst[0].record == "pushed" and c.torque is not None
    (touch,) = c.torque.contacts
    assert touch.name == "pushed" and 2.8 < touch.t_begin < 3.2
    assert [cause.effect for cause in c.causes] == ["viscous"]
    assert c.causes[0].numbers["viscous.b"]["value"] == pytest.approx(0.03, rel=0.2)


def test_the_size_of_the_missing_torque_is_said() -> None:
    """RMS of a planted ripple along the motion, what it is of the drive's, and what a diagnosis counts of it."""
    records, ripple = logs(ROD.with_effect(Ripple(a=0.15, b=0.1, order=5.0))), Ripple(a=0.15, b=0.1, order=5.0)
    c = compare(ROD, records, SENSOR)
    theta = np.concatenate([r.theta for r in records if r.theta is not None])
    planted = math.sqrt(np.mean((ripple.a * np.sin(5.0 * theta) + ripple.b * np.cos(5.0 * theta)) ** 2))
    drive = math.sqrt(np.mean(np.concatenate([r.u for r in records]) ** 2))
    assert c.torque is not None and c.torque.rms == pytest.approx(planted, rel=0.15)
    assert c.torque.share == pytest.approx(c.torque.rms / drive, rel=1e-6)
    assert 0.0 < c.torque.averaged < c.torque.rms
    slow = f"{c.torque.averaged:.2g} N m averaged over 0.4 s"
    assert f"{c.torque.rms:.2g} N m rms ({c.torque.share:.0%} of the drive's; {slow})" in c.sentence


def test_an_axis_is_told_in_metres_and_newtons() -> None:
    axis, sensor, rng = Model(LinearAxis(m=1.0), dt=0.02), Sensor(0.001, 0.01), np.random.default_rng(0)
    u = np.array([steps(rng, 300, 0.02, 1.5, 0.3) for _ in range(3)])
    initial_guess = axis.with_effect(Coulomb(tau_c=0.2))
    c = compare(axis, sensor.measure(simulate(initial_guess, u, np.zeros(3), np.zeros(3)), rng), sensor)
    assert [cause.effect for cause in c.causes] == ["coulomb"]
    said = f"{c} {json.dumps(c.to_dict())} {c.one_second} {c.torque}"
    assert "dry friction of about 0.2 N" in said and "A force of 0." in said and "m/s" in said
    assert "rad" not in said and "N m" not in said


def test_the_worst_windows_hold_readings_and_model() -> None:
    records = logs(ROD.with_effect(Tilt(alpha=0.05)))
    worst = compare(ROD, records, SENSOR).worst
    assert len(worst) == 3
    for found in worst:
        record, read = next(r for r in records if r.name == found.record), slice(0, -1)  # a nan ends the window
        at = np.searchsorted(record.t, found.t[read] - 1e-9)
        np.testing.assert_allclose(found.readings["theta"][read], record.theta[at], rtol=1e-12)
        np.testing.assert_array_equal(found.command[read], record.u[np.minimum(at, len(record) - 1)])
        e = (found.readings["theta_dot"] - found.model["theta_dot"])[read] / SENSOR.theta_dot
        e = np.concatenate([e, (found.readings["theta"] - found.model["theta"])[read] / SENSOR.theta])
        assert math.sqrt(np.sum(e**2) / (len(e) - 2)) == pytest.approx(found.ratio, rel=1e-6)


def test_a_rerun_gives_the_same_numbers() -> None:
    first, second = (comparison(Viscous(b=0.05)).to_dict() for _ in range(2))
    assert json.dumps(first, allow_nan=False) == json.dumps(second, allow_nan=False)


def test_it_prints_every_horizon() -> None:
    c = comparison(Viscous(b=0.05))
    for words in (*c.errors, "theta_dot [rad/s]", "worst windows", c.sentence):
        assert words in str(c)


@pytest.mark.parametrize("sensor", [Sensor(0.003), Sensor(None, 0.05)])
def test_one_channel_is_enough(sensor: Sensor) -> None:
    c = compare(ROD, logs(ROD.with_effect(Viscous(b=0.05)), sensor=sensor), sensor)
    assert c.causes[0].effect == "viscous"
    assert len(c.whiteness) == len(c.one_second.ratios) == 1


def test_a_free_swing_and_one_short_rollout() -> None:
    """No torque to depend on; fewer readings than one window."""
    swing = SENSOR.measure(simulate(ROD.with_effect(Viscous(b=0.1)), np.zeros(200), 2.0, 0.0), np.random.default_rng(0))
    c = compare(ROD, swing, SENSOR)
    assert c.causes[0].effect == "viscous"
    assert c.torque is not None and math.isinf(c.torque.share)
    short = compare(ROD, logs(ROD, n=1, seconds=0.4), SENSOR)
    assert short.one_second.n_windows == 1
    json.dumps(short.to_dict(), allow_nan=False)


def test_a_model_that_runs_away_is_said() -> None:
    c = compare(ROD.with_effect(Drag(c=500.0, bounds={"c": (0.0, 1e4)})), logs(ROD), SENSOR)
    assert "runs away" in c.sentence
    json.dumps(c.to_dict(), allow_nan=False)
    assert "inf" in str(c)
    assert c.torque is None and not c.adequate


def test_other_plants_and_rates() -> None:
    point = Model(PointMassPendulum(m=0.7, l=0.5), dt=0.05)
    assert compare(point, logs(point), SENSOR).adequate
    assert compare(point, logs(point.with_effect(Coulomb(tau_c=0.05))), SENSOR).causes[0].effect == "coulomb"
