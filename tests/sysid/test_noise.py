"""Sensor noise without a model: what was put in is found, whatever moved the pendulum and whatever was hidden in it."""

import math
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from sysid import (
    RK4,
    Backlash,
    Coulomb,
    DeadZone,
    Delay,
    InvalidInput,
    Lag,
    Model,
    Record,
    Ripple,
    RodPendulum,
    Saturation,
    Sensor,
    Viscous,
    simulate,
)
from sysid.data.digitisation import quantisation_step
from sysid.data.noise import sensor_noise
from sysid.planning.excitation import multisine, steps
from tests.sysid.written import REAL, of_real_machine

USUAL, LOUD = Sensor(theta=0.003, theta_dot=0.05), Sensor(theta=0.02, theta_dot=0.4)
TORQUES = {
    "random": lambda rng, n, dt: rng.uniform(-2.5, 2.5, n),
    "multisine": lambda rng, n, dt: multisine(rng, n, dt, 2.5, 3.0),
    "steps": lambda rng, n, dt: steps(rng, n, dt, 2.5, 0.5),
    "free": lambda rng, n, dt: np.zeros(n),
}
HIDDEN = {
    "nothing": (),
    "coulomb": (Coulomb(tau_c=0.5),),
    "stick_slip": (Coulomb(tau_c=1.5),),
    "backlash": (Backlash(width=0.05),),
    "dead_zone": (DeadZone(d=0.6),),
    "saturation": (Saturation(limit=1.2),),
    "delay": (Delay(T=0.1),),
    "lag": (Lag(T=0.1),),
    "ripple": (Ripple(a=0.3, b=0.3),),
}


@cache
def truth(torque="multisine", hidden=(), dt=0.02, seconds=8.0, n=8, speed=1.0, l=1.0, seed=0):  # noqa: E741
    rng = np.random.default_rng(seed)
    model = Model(RodPendulum(m=1.0, l=l), (Viscous(b=0.02), *hidden), RK4(substeps=max(1, round(dt / 0.005))), dt=dt)
    u = np.stack([l * TORQUES[torque](rng, round(seconds / dt), dt) for _ in range(n)])
    return simulate(model, u, math.pi + rng.uniform(-2.5, 2.5, n), rng.uniform(-speed, speed, n))


def ratios(run, sensor, seeds=4):
    """Found over put in, (seeds, 2)."""
    rows = []
    for seed in range(seeds):
        records = sensor.measure(run, np.random.default_rng(seed))
        errors = [
            np.std([y - t for y, t in zip((getattr(r, c) for r in records), true, strict=True)])
            for c, true in (("theta", run.theta_read), ("theta_dot", run.theta_dot_read))
        ]
        noise = sensor_noise(records)
        rows.append([noise.sensor.theta / errors[0], noise.sensor.theta_dot / errors[1]])
    return np.array(rows)


SLOW = ({"torque": "random"}, {"torque": "steps", "speed": 12.0}, {"torque": "multisine", "l": 0.3}, {"torque": "free"})
FOUND = {
    **{f"{torque}, {sensor}": ({"torque": torque}, sensor, 4, 0.03) for torque in TORQUES for sensor in (USUAL, LOUD)},
    **{
        f"{torque}, {hidden}": ({"torque": torque, "hidden": HIDDEN[hidden]}, USUAL, 4, 0.05)
        for torque in ("random", "steps")
        for hidden in list(HIDDEN)[1:]
    },
    **{f"20 Hz, {torque}": (torque | {"dt": 0.05}, USUAL, 8, 0.05) for torque in SLOW},
}


@pytest.mark.long
@pytest.mark.parametrize(("motion", "sensor", "seeds", "within"), FOUND.values(), ids=FOUND.keys())
def test_noise_is_found_whatever_moved_the_pendulum_and_was_hidden_in_it(motion, sensor, seeds, within):
    assert np.all(np.abs(ratios(truth(**motion), sensor, seeds).mean(axis=0) - 1.0) < within)


@pytest.mark.long
@pytest.mark.parametrize(("hidden", "within"), [("nothing", 0.02), ("coulomb", 0.02), ("backlash", 0.05)])
def test_a_long_log_tells_more(hidden, within):
    noise = sensor_noise(USUAL.measure(truth("random", HIDDEN[hidden], seconds=25.0), np.random.default_rng(5)))
    assert max(noise.error.values()) < 0.015
    assert noise.sensor.theta == pytest.approx(0.003, rel=within)
    assert noise.sensor.theta_dot == pytest.approx(0.05, rel=within)


@pytest.mark.long
def test_the_stated_error_is_the_scatter_over_seeds():
    run = truth("multisine", n=4)
    noises = [sensor_noise(USUAL.measure(run, np.random.default_rng(seed))) for seed in range(30)]
    spread = np.std([noise.sensor.theta for noise in noises], ddof=1) / 0.003
    assert 0.6 < spread / np.mean([noise.error["theta"] for noise in noises]) < 1.45


# ---- sensors that are not ideal ----------------------------------------------------------------------------------


@pytest.mark.parametrize("torque", ["multisine", "free"])
@pytest.mark.parametrize(("q", "sigma"), [(0.003, 0.0), (0.003, 0.001), (2.0 * math.pi / 4096, 0.0005)])
def test_rounding_is_recognised_and_counted(torque, q, sigma):
    run, rng = truth(torque), np.random.default_rng(1)
    theta = q * np.round((run.theta + sigma * rng.standard_normal(run.theta.shape)) / q) + 0.1
    noise = sensor_noise([Record(run.t, u, y) for u, y in zip(run.u, theta, strict=True)])
    assert noise.quantisation_step["theta"] == pytest.approx(q, rel=1e-4)
    assert noise.sensor.theta == pytest.approx(np.std(theta - run.theta - 0.1), rel=0.05)
    assert noise.sensor.theta_dot is None and f"theta is rounded to steps of {q:.4g}" in noise.notes


def test_a_reading_that_is_not_rounded_has_no_quantum():
    rng = np.random.default_rng(0)
    y = rng.standard_normal(1000)
    assert quantisation_step([y]) == 0.0 and quantisation_step([np.ones(9)]) == 0.0
    assert quantisation_step([0.25 * np.round(y / 0.25) + 0.1]) == pytest.approx(0.25)


def correlated(kind, e):
    if kind == "filtered":
        return math.sqrt(0.75) * lfilter([1.0], [1.0, -0.5], e)
    if kind == "averaged":
        return math.sqrt(2.0) * lfilter([0.5, 0.5], [1.0], e)
    return np.gradient(e, axis=-1) * math.sqrt(2.0)


@pytest.mark.parametrize("kind", ["filtered", "averaged", "differentiated"])
def test_correlated_errors_are_told_and_their_size_is_found(kind):
    run, rng = truth("multisine", dt=0.005, n=4), np.random.default_rng(2)
    error = 0.05 * correlated(kind, rng.standard_normal(run.theta.shape))
    noise = sensor_noise([Record(run.t, u, None, y) for u, y in zip(run.u, run.theta_dot + error, strict=True)])
    assert noise.sensor.theta_dot == pytest.approx(np.std(error), rel=0.1)
    assert any("neighbouring errors of theta_dot are correlated" in note for note in noise.notes)


ANGLES = {
    "noisy": lambda theta, rng: theta + 0.003 * rng.standard_normal(theta.shape),
    "quiet": lambda theta, rng: theta + 1e-4 * rng.standard_normal(theta.shape),
    "coarse": lambda theta, rng: 0.003 * np.round(theta / 0.003),
    "fine": lambda theta, rng: 2.0 * math.pi / 4096 * np.round(theta * 4096 / (2.0 * math.pi)),
    "clean": lambda theta, rng: theta,
}
COMPUTED = {
    "backward difference": lambda d: d,
    "central difference": lambda d: 0.5 * (d + np.roll(d, -1, axis=-1)),
    "filtered difference": lambda d: lfilter([0.2], [1.0, -0.8], d, axis=-1),
    "twice filtered difference": lambda d: lfilter([0.3], [1.0, -0.7], lfilter([0.3], [1.0, -0.7], d, axis=-1)),
    "mean of ten differences": lambda d: lfilter(np.full(10, 0.1), [1.0], d, axis=-1),
}


def with_speed(run, theta, theta_dot):
    return [Record(run.t, u, y, v).part(20, len(u) - 1) for u, y, v in zip(run.u, theta, theta_dot, strict=True)]


@pytest.mark.long
@pytest.mark.parametrize("torque", ["multisine", "random", "free"])
@pytest.mark.parametrize("angle", ANGLES)
def test_a_speed_computed_from_the_angle_is_no_second_sensor(angle, torque):
    run = truth(torque, HIDDEN["coulomb"], n=2, dt=0.01)
    theta = ANGLES[angle](run.theta, np.random.default_rng(0))
    d = np.diff(theta, axis=-1, prepend=theta[:, :1]) / 0.01
    kinds = list(COMPUTED)[: 3 if angle == "clean" else None]  # without errors only what is exact can be told
    for kind in kinds:
        noise = sensor_noise(with_speed(run, theta, COMPUTED[kind](d)))
        assert noise.sensor.theta_dot is None and "theta_dot" not in noise.error, kind
        assert [n for n in noise.notes if "theta_dot was computed from the readings of theta" in n], kind


def test_a_computed_speed_shows_in_a_short_and_slow_log_too():
    run = truth("random", HIDDEN["lag"], n=1, dt=0.05)
    for angle in ("noisy", "fine"):
        theta = ANGLES[angle](run.theta, np.random.default_rng(0))
        d = np.diff(theta, axis=-1, prepend=theta[:, :1]) / 0.05
        for kind, speed in list(COMPUTED.items())[:4]:
            assert sensor_noise(with_speed(run, theta, speed(d))).sensor.theta_dot is None, kind
        tachometer = run.theta_dot + 0.01 * np.random.default_rng(1).standard_normal(theta.shape)
        assert sensor_noise(with_speed(run, theta, tachometer)).sensor.theta_dot is not None


@pytest.mark.long
@pytest.mark.parametrize("torque", ["multisine", "random", "free"])
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_a_tachometer_is_never_taken_for_a_difference(angle, torque, dt):
    run, rng = truth(torque, HIDDEN["coulomb"], n=2, dt=dt), np.random.default_rng(1)
    theta = ANGLES[angle](run.theta, rng)
    for sd in (0.05, 0.005) if angle == "clean" else (0.05, 0.0005):  # else the angle's differences are as good
        tachometer = run.theta_dot + sd * rng.standard_normal(theta.shape)
        if angle == "noisy":  # a slow one
            tachometer = lfilter([0.2], [1.0, -0.8], tachometer, axis=-1)
        assert sensor_noise(with_speed(run, theta, tachometer)).sensor.theta_dot is not None, sd


def test_a_clean_channel_gets_a_small_floor_and_a_note():
    run = truth("steps")
    noise = sensor_noise([Record(run.t, u, y) for u, y in zip(run.u, run.theta, strict=True)])
    assert 0.0 < noise.sensor.theta < 2e-4 * np.std(run.theta) and any(
        "theta shows no noise" in note for note in noise.notes
    )


def test_a_servo_at_its_largest_speed_leaves_few_windows_without_a_kink():
    """Those of a width may be too few where those of a wider one are not."""
    rng, targets = np.random.default_rng(112), np.random.default_rng(113)
    every = rng.integers(8, 40)
    command = np.repeat(targets.uniform(-1.3, 1.3, 214 // every + 1), every)[:214]
    theta = np.zeros(214)
    for k in range(213):
        theta[k + 1] = theta[k] + np.clip(command[k + 1] - theta[k], -0.33, 0.33)
    theta += 1e-4 * rng.standard_normal(214)
    noise = sensor_noise([Record(np.arange(214) / 29.9, command[:-1], theta)])
    assert 0.0 < noise.sensor.theta < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_a_fast_oscillation_is_no_correlated_error(seed):
    """Windows of three periods and more leave all of it, whatever their width."""
    rng, k = np.random.default_rng(seed), np.arange(950)
    e = rng.standard_normal(951)
    theta = 100.0 * np.sin(2.0 * math.pi * k / 14.0) + 8.0 * (e[1:] - 0.5 * e[:-1])
    assert sensor_noise([Record(0.015 * k, np.zeros(949), theta)]).sensor.theta < 12.0


def test_scale_and_order_of_the_records_do_not_matter():
    records = USUAL.measure(truth("steps", HIDDEN["coulomb"]), np.random.default_rng(0))
    one = sensor_noise(records).sensor
    back = sensor_noise(records[::-1]).sensor
    larger = sensor_noise([Record(r.t, 5.0 * r.u, None, 100.0 * r.theta_dot) for r in records]).sensor
    assert back.theta == pytest.approx(one.theta, rel=1e-6) and larger.theta_dot == pytest.approx(100.0 * one.theta_dot)


def test_what_cannot_be_told_is_refused():
    t, flat = 0.02 * np.arange(201), np.full(201, 3.1)
    with pytest.raises(InvalidInput, match=re.escape("theta never changes (it stays at 3.1): it measures nothing")):
        sensor_noise([Record(t, np.zeros(200), flat)])
    short = USUAL.measure(truth("steps", seconds=0.4, n=1), np.random.default_rng(0))
    with pytest.raises(InvalidInput, match="21 readings of theta are too few to find its noise: give its sd"):
        sensor_noise(short)
    one = Record(t, np.zeros(200), flat + t)
    with pytest.raises(InvalidInput, match="no channel is in all of the records"):
        sensor_noise([one, Record(t, np.zeros(200), None, t)])


ENCODERS = {"dfki_sp": 2.914e-3, "dfki_dp": 3.815e-4, "bam": 2.0 * math.pi / 4096}


@pytest.mark.long
@pytest.mark.parametrize("path", sorted(REAL.glob("*.csv")) or [None], ids=lambda p: p.stem if p else "none")
def test_real_logs_show_their_encoders(path):
    if path is None:
        pytest.skip("the real logs are not here")
    torque = next(
        t for s, t in (("bam", "duty_meas"), ("sp_d", "torque_meas_Nm"), ("", "torque_cmd_Nm")) if s in path.name
    )
    noise = sensor_noise(of_real_machine(path.stem, torque))
    q = next(step for name, step in ENCODERS.items() if path.name.startswith(name))
    assert noise.quantisation_step["theta"] == pytest.approx(q, rel=2e-3)
    assert q / math.sqrt(12.0) <= 1.001 * noise.sensor.theta < 1.5 * q or path.name.startswith("dfki_dp")
    if path.name.startswith("dfki_dp"):  # its speed is the encoder's step over the sample time
        assert noise.sensor.theta_dot is None and any("was computed from the readings" in n for n in noise.notes)
    else:
        assert 0.005 < noise.sensor.theta_dot < 0.15


def test_a_thinned_record_is_as_noisy_as_its_readings_were():
    """Of every tenth reading alone the noise is known less well; parts and other names change nothing."""
    rng, t = np.random.default_rng(0), 0.001 * np.arange(20_001)
    whole = Record(t, np.zeros(20_000), 3.0 + np.sin(5.0 * t) + 0.01 * rng.standard_normal(20_001))
    thinned = whole.thinned(10)
    noise = sensor_noise([thinned.part(0, 700, "first"), thinned.part(700, 2000, "rest")])
    assert noise.sensor == sensor_noise([whole]).sensor and noise.error == sensor_noise([whole]).error
    alone = sensor_noise([replace(thinned, whole=None)])
    assert alone.error["theta"] > 2.0 * noise.error["theta"]
