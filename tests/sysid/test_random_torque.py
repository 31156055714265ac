"""A random torque beside a model: its size is found, numbers stay honest under it, and what it depends on is said."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import sysid
from sysid import RK4, Effect, GeneralJoint, LinearAxis, Model, Record, Sensor, diagnose, effect, simulate
from sysid.diagnosis import dependence as dependence_module
from sysid.diagnosis.contacts import find_contacts, slow
from sysid.diagnosis.dependence import dependence
from sysid.diagnosis.residual_torque import missing_torque, needed_disturbances
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.first_fit import with_best_memory
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit, inverse, with_likely_shared_error
from sysid.estimation.solver import Settings, fit_parameters
from sysid.physics.effects import Joint
from sysid.physics.ops import Value
from sysid.planning.excitation import multisine
from tests.sysid.planted import DT, JOINT, NAMES, SENSOR, Unknown, accelerated

DRY = Model(GeneralJoint(J=0.3, G=2.0), (effect("coulomb", tau_c=0.15),), RK4(substeps=2), DT)
DRY_NAMES = ("J", "G", "coulomb.tau_c")
DRY_TRUTH = np.array([0.3, 2.0, 0.15])
QUIET = Settings(shared_error=False)


def logs(*given: Any, **more: Any) -> list[Record]:
    """Rollouts under a random acceleration, as `accelerated` makes them."""
    return accelerated(*given, **more)[1]


@pytest.mark.parametrize(("s", "T"), [(0.5, 0.3), (1.5, 0.1)])
def test_a_random_torque_is_found_beside_friction_and_the_numbers_stay_honest(s: float, T: float) -> None:
    """Of 30 logs 95 % of the 95 % intervals cover: 25 or more of 30, but for one set of logs in 700."""
    start = DRY.with_parameters({"J": 0.4, "G": 1.5, "coulomb.tau_c": 0.05})
    fits = [
        fit_parameters(Samples(start, [r], SENSOR), start, DRY_NAMES, disturbances=Disturbances(6.0, T), settings=QUIET)
        for r in logs(DRY, 30, 300, s, T)
    ]
    sizes = np.array([f.disturbances.s for f in fits])
    assert np.median(np.abs(sizes / s - 1.0)) < 0.2 and np.median(sizes) == pytest.approx(s, rel=0.15)
    z = np.array([(f.values - DRY_TRUTH) / np.sqrt(np.diag(f.covariance)) for f in fits])
    covered = np.sum(np.abs(z) < 1.96, axis=0)
    assert np.all(covered >= 25), covered
    # sd that are too wide cover too: what they promise is a mean square of 1
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.5)
    assert sum(f.converged for f in fits) >= 28


@pytest.mark.long
@pytest.mark.parametrize(("s", "T"), [(0.5, 0.3), (1.5, 0.1), (0.5, 1.0)])
def test_an_estimate_tells_how_large_the_random_torque_is_and_how_long_it_remembers(s: float, T: float) -> None:
    start = DRY.with_parameters({"J": 0.4, "G": 1.5, "coulomb.tau_c": 0.05})
    estimate = sysid.fit(start, logs(DRY, 8, 500, s, T), SENSOR)
    assert estimate.random_torque == pytest.approx(0.3 * s, rel=0.2)
    assert estimate.correlation_time == T
    assert estimate.to_dict()["correlation_time"] == T


def test_intervals_are_as_wide_as_the_likelihood_says_where_nothing_is_missing() -> None:
    for record in logs(JOINT, 3, 300, 0.0, 0.1):
        fit = fit_parameters(Samples(JOINT, [record], SENSOR), JOINT, NAMES, settings=QUIET)
        np.testing.assert_array_equal(fit.wider, 1.0)
        np.testing.assert_array_equal(fit.covariance, inverse(fit.Z.T @ fit.Z))


@pytest.mark.parametrize(("count", "n", "covers", "alone"), [(20, 500, 0.9, 0.85), (30, 200, 0.85, 0.8)])
def test_intervals_cover_under_a_torque_of_a_longer_memory_than_was_thought(
    count: int, n: int, covers: float, alone: float
) -> None:
    """What a model lacks is no Gaussian process of the memory that a fit gives it: intervals are wider for it, also in
    four seconds, of which each stretch tells much of what is known."""
    truth, z, wider = np.array([0.3, 2.0, 0.07]), [], []
    for record in logs(JOINT, count, n, 0.6, 3.0, seed=5):
        white = Disturbances(6.0, 0.01)
        fit = fit_parameters(Samples(JOINT, [record], SENSOR), JOINT, NAMES, disturbances=white, settings=QUIET)
        z.append((fit.values - truth) / np.sqrt(np.diag(fit.covariance)))
        wider.append(fit.wider)
    assert np.min(wider) >= 1.0
    assert np.all(np.mean(wider, axis=0)[1:] > 1.3), "gravity and friction are what a slow torque imitates"
    assert np.mean(np.abs(z) < 1.96) > covers
    assert np.mean(np.abs(np.array(z) * wider) < 1.96) < alone, "without it they would not cover"


def test_an_error_that_speeds_share_is_told_from_a_random_torque() -> None:
    """Of a wheel that coasts from 95 rad/s, whose readings share an error of 0.5 rad/s over a fifth of a second."""
    wheel = Model(GeneralJoint(J=0.1, G=0.0), (effect("coulomb", tau_c=0.04), effect("drag", c=4e-5)), RK4(2), 0.05)
    coast, kept, z = simulate(wheel, np.zeros(1200), 0.0, 95.0), np.exp(-0.05 / 0.2), []
    names, truth = ("coulomb.tau_c", "drag.c"), np.array([0.04, 4e-5])
    for rng in map(np.random.default_rng, range(4)):
        steps = 0.5 * np.sqrt(1.0 - kept**2) * rng.standard_normal(1201)
        error = lfilter([1.0], [1.0, -kept], steps)
        record = Record(t=coast.t, u=coast.u, theta_dot=coast.theta_dot + error + 0.05 * rng.standard_normal(1201))
        samples = Samples(wheel, [record], Sensor(theta_dot=0.05), speeds_share=True)
        beside = fit_parameters(samples, wheel, names)
        fit = fit_parameters(samples, wheel, names, beside, with_likely_shared_error(beside, (0.2,)))
        assert fit.disturbances.sigma_o == pytest.approx(0.5, rel=0.2) and fit.disturbances.s < 0.1
        z.append((fit.values - truth) / np.sqrt(np.diag(fit.covariance)))
    assert np.mean(np.square(z)) < 3.0


@pytest.mark.parametrize("T", [0.01, 0.03, 0.1, 0.3, 1.0])
def test_its_memory_is_found_to_a_factor_of_two(T: float) -> None:
    samples = Samples(JOINT, logs(JOINT, 5, 600, 1.0, T, seed=1), SENSOR)
    here = fit_parameters(samples, JOINT, NAMES, disturbances=Disturbances(1.0, T), settings=QUIET)
    assert 0.5 < with_best_memory(here).disturbances.T / T < 2.0


def magnet(joint: Joint) -> Value:
    """A bump at 3.6 rad, 0.2 rad wide."""
    return 0.15 * np.exp(-0.5 * ((joint.theta - 3.6) / 0.2) ** 2)


def resonance(joint: Joint) -> Value:
    """A bump at 2 rad/s."""
    return 0.1 * np.exp(-0.5 * ((joint.theta_dot - 2.0) / 0.5) ** 2)


def rough_teeth(joint: Joint) -> Value:
    """A friction that varies with the angle and turns with the speed."""
    return 0.08 * np.sin(4.0 * joint.theta) * np.tanh(joint.theta_dot / 0.2)


def gust(joint: Joint) -> Value:
    """At 4 s, for a second."""
    return 0.15 * np.exp(-0.5 * ((joint.t - 4.0) / 0.4) ** 2) + 0.0 * joint.theta


PLANTED: dict[str, tuple[Effect, tuple[str, ...]]] = {
    "angle": (Unknown(curve=magnet), ("theta",)),
    "speed": (Unknown(curve=resonance), ("theta_dot",)),
    "angle and speed": (Unknown(curve=rough_teeth), ("theta", "theta_dot")),
    "time": (Unknown(curve=gust), ("time",)),
    "torque": (effect("dead_zone", d=0.3), ("torque",)),
    "history": (effect("lag", T=0.1), ("history",)),
}


@pytest.mark.parametrize(("planted", "depends_on"), PLANTED.values(), ids=PLANTED.keys())
def test_a_torque_is_said_to_depend_on_what_it_depends_on(planted: Effect, depends_on: tuple[str, ...]) -> None:
    """Also after the model's own numbers have bent to imitate it, and under a random torque beside it."""
    for seed in range(2):
        answer = dependence(*missing(logs(JOINT.with_effect(planted), 3, 500, 0.05, 0.1, seed)))
        assert answer.depends_on == depends_on
        assert (answer.share > 0.5) == (depends_on != ("time",)), "a thing that acts once is predicted by nothing"
        assert answer.where


def missing(records: list[Record], names: tuple[str, ...] = NAMES) -> tuple[Fit, np.ndarray]:
    """A fit of the damped joint and the torque (M,) that it misses."""
    fit = fit_parameters(Samples(JOINT, records, SENSOR), JOINT, names, settings=QUIET)
    return fit, missing_torque(fit, needed_disturbances(fit))


def test_a_random_torque_alone_depends_on_nothing() -> None:
    for T in (0.1, 0.3):
        for seed in range(2):
            answer = dependence(*missing(logs(JOINT, 3, 500, 0.3, T, seed)))
            assert answer.depends_on == ("time",) and answer.share == 0.0


def test_where_nothing_says_where_an_axis_is_nothing_depends_on_its_place() -> None:
    """Of an axis of which the speed alone is known, and which lacks a force over its speed."""
    sensor, rng = Sensor(None, 0.02), np.random.default_rng(0)
    axis = Model(LinearAxis(m=1.0), (), RK4(substeps=2), DT)
    u = np.array([multisine(rng, 500, DT, 1.5, 2.0) for _ in range(2)])
    records = sensor.measure(simulate(axis.with_effect(effect("drag", c=0.5)), u, np.zeros(2), np.zeros(2)), rng)
    samples = Samples(axis, records, sensor)
    fit = fit_parameters(samples, axis, ("m",), settings=QUIET)
    answer = dependence(fit, missing_torque(fit, needed_disturbances(fit)))
    assert answer.depends_on == ("theta_dot",)
    assert not any("theta" in name.split("+") for name in answer.shares)


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-6])
def test_a_stretch_is_told_in_digits_that_show_it(size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    (fit, _), x = missing(logs(JOINT, 1, 500, 0.0, 0.1)), size * np.linspace(0.0, 2.0, 502)
    monkeypatch.setattr(dependence_module, "coordinates", lambda _: {"torque": x})
    said = dependence_module._where(fit, "torque", np.where(x > 1.5 * size, 1.0, 0.0))
    low, high = (float(number) for number in re.findall(r"from (\S+) to (\S+) ", said)[0])
    assert low == pytest.approx(1.5 * size, abs=0.1 * size)
    assert high == pytest.approx(2.0 * size, abs=0.1 * size)


def test_the_missing_torque_is_what_acted() -> None:
    """Beside a model of the true numbers, within its noise; and nothing where nothing was missing."""
    fit, torque = missing(logs(JOINT.with_effect(Unknown(curve=gust)), 3, 500, 0.0, 0.1), ())
    samples = fit.samples
    x = samples.smoothed
    acted = slow(
        gust(Joint(x[:, 0], x[:, 1], samples.time_since_start + 0.5 * DT, 0.0, 0.0, JOINT.plant)), samples.number, DT
    )
    known = np.isfinite(torque)
    np.testing.assert_array_equal(known, np.isfinite(acted))
    assert np.mean(known) > 0.9
    assert np.sqrt(np.mean((torque - acted)[known] ** 2)) < 0.3 * np.sqrt(np.mean(acted[known] ** 2))
    assert np.max(np.abs(torque[known])) == pytest.approx(np.max(acted[known]), rel=0.15)
    _, nothing = missing(logs(JOINT, 3, 500, 0.0, 0.1))
    assert np.nanmax(np.abs(nothing)) < 0.02


@pytest.mark.parametrize("s", [0.0, 0.1])
def test_a_push_is_found(s: float) -> None:
    for seed in range(2):
        (contact,) = find_contacts(*missing(logs(JOINT, 2, 700, s, 0.1, seed, push=(1, 0.3))))
        assert contact.name == "rollout 1"
        assert 3.2 < contact.t_begin < 4.1 and 4.4 < contact.t_end < 5.5
        assert 0.15 < contact.peak < 0.35


def test_what_comes_with_the_largest_commands_is_no_push() -> None:
    fit, torque = missing(logs(JOINT, 2, 700, 0.0, 0.1, push=(1, 0.3)))
    assert find_contacts(fit, torque)
    loud = np.ones(700)
    loud[round(3.5 / DT) : round(5.5 / DT)] = 6.0
    fit.samples.records = [replace(r, u=loud * r.u) for r in fit.samples.records]
    assert find_contacts(fit, torque) == ()


@pytest.mark.parametrize("seconds", [0.0, 0.3])
def test_what_comes_with_steps_of_the_command_is_no_push(seconds: float) -> None:
    """Of a drive that steps once, or ramps for so long, as what is missing begins: nobody waits for it. Behind a step
    2 s before, somebody may have pushed."""
    fit, torque = missing(logs(JOINT, 2, 700, 0.0, 0.1, push=(1, 0.3)))
    first, second = fit.samples.records
    for begin, pushed in ((4.0, False), (2.0, True)):
        step = 0.1 + 0.1 * np.clip((second.t[:-1] - begin + DT) / (seconds + DT), 0.0, 1.0)
        fit.samples.records = [replace(first, u=np.full(700, 0.1)), replace(second, u=step)]
        assert bool(find_contacts(fit, torque)) == pushed


def test_what_peaks_after_steps_of_the_command_is_no_push_though_it_seems_to_begin_long_before_them() -> None:
    """The filter spreads what a quick motor does at its steps; somebody who waits for none of them pushed."""
    fit, torque = missing(logs(JOINT, 2, 700, 0.0, 0.1, push=(1, 0.3)))
    (push,) = find_contacts(fit, torque)
    first, second = fit.samples.records
    peak = float(fit.samples.t[700:][np.nanargmax(np.abs(torque[700:]))])
    assert peak - push.t_begin > 0.3
    for begin, pushed in ((peak - 0.05, False), (peak + 0.1, True)):
        step = np.where(second.t[:-1] < begin, 0.1, 0.2)
        fit.samples.records = [replace(first, u=np.full(700, 0.1)), replace(second, u=step)]
        assert bool(find_contacts(fit, torque)) == pushed


def test_what_keeps_a_standing_joint_from_following_its_drive_is_no_push() -> None:
    """It is friction, of which no state tells how much it takes to break the joint away."""
    fit, torque = missing(logs(JOINT, 2, 700, 0.0, 0.1, push=(1, 0.3)))
    assert find_contacts(fit, torque)
    inside = (fit.samples.number == 1) & (np.abs(fit.samples.t - 4.25) < 1.0)
    for speed, drive, pushed in ((0.0, -0.5, False), (0.0, 0.5, True), (1.0, -0.5, True)):
        fit.motion.x[inside, 1] = speed
        fit.linearised.__dict__["drive_torques"] = np.full((len(fit.samples), 2), drive)
        assert bool(find_contacts(fit, torque)) == pushed


def test_a_push_is_found_in_the_last_of_several_pieces_of_one_record() -> None:
    """They share its name, as pieces between pushes do, and each has times of its own."""
    fit, torque = missing(logs(JOINT, 2, 700, 0.0, 0.1, push=(1, 0.3)))
    (alone,) = find_contacts(fit, torque)
    first, second = fit.samples.records
    fit.samples.records = [replace(first, name="swing"), replace(second, name="swing", t=second.t + 20.0)]
    fit.samples.__dict__["t"] = np.concatenate([r.t for r in fit.samples.records])
    (contact,) = find_contacts(fit, torque)
    assert contact.name == "swing" and contact.t_begin == pytest.approx(alone.t_begin + 20.0)


def test_what_only_shakes_a_free_swing_is_no_push_but_readings_that_jump_once() -> None:
    """To and fro it does no work, as readings that jump; more often, it is something that the model lacks."""
    fit, torque = missing(logs(JOINT, 2, 700, 0.0, 0.1, push=(1, 1.2)))
    fit.samples.records = [replace(r, u=0.0 * r.u) for r in fit.samples.records]
    assert not fit.samples.driven
    (push,) = find_contacts(fit, torque)
    lone = np.where((fit.samples.number == 1) & (np.abs(fit.samples.t - 4.25) < 0.1), torque, 0.0)
    shakes = [np.roll(lone, round(s / DT)) - np.roll(lone, round((s + 0.25) / DT)) for s in (0.0, -1.5, 1.5, 3.0)]
    (jump,) = find_contacts(fit, 1e-3 * torque + shakes[0])
    assert push.t_begin < 4.25 < push.t_end and jump.t_begin < 4.25 < jump.t_end
    assert find_contacts(fit, 1e-3 * torque + sum(shakes)) == ()


def test_nobody_pushes_by_a_hundredth_of_what_acts() -> None:
    fit, torque = missing(logs(JOINT, 2, 700, 0.0, 0.1, push=(1, 0.02)))
    assert 0.008 < np.nanmax(torque) < 0.02, "it is seen"
    assert find_contacts(fit, torque) == ()


def test_an_untouched_log_has_no_push() -> None:
    """Neither one without any random torque nor one with, whatever its memory; nor one that misses a magnet."""
    for seed, (s, T) in enumerate(((0.0, 0.1), (0.3, 0.03), (0.3, 0.1), (0.3, 0.3), (0.3, 1.0))):
        assert find_contacts(*missing(logs(JOINT, 2, 700, s, T, seed))) == (), (s, T)
    assert find_contacts(*missing(logs(JOINT.with_effect(Unknown(curve=magnet)), 2, 700, 0.05, 0.1))) == ()


@pytest.mark.long
@pytest.mark.parametrize(("seconds", "seed"), [(5.0, 0), (5.0, 2), (10.0, 0)])
def test_a_magnet_is_no_ripple_tilt_or_spring(seconds: float, seed: int) -> None:
    """Each explains a part of any torque over the angle, together even most, with a number at its bound."""
    narrow = Unknown(curve=lambda joint: 2.0 * magnet(joint))
    records = logs(JOINT.with_effect(narrow), 4, round(seconds / DT), 0.05, 0.1, seed)
    diagnosis = diagnose(JOINT, records, SENSOR, hold_out=1, effects=("ripple", "tilt", "spring"))
    assert diagnosis.verdict == "unknown" and not diagnosis.steps
    assert diagnosis.unconfirmed, "they were added first"
    assert diagnosis.remaining is not None and diagnosis.remaining.depends_on == ("theta",)
