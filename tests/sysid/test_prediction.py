"""Predictions: a better model is told from a worse one by how many windows it predicts better, not by a single one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sysid import RK4, Effect, FilteredSpeed, GeneralJoint, Model, Record, Sensor, SensorDelay, effect, simulate, split
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.held_out import lead_of
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import (
    GROWTH,
    HORIZON,
    SHORTEST_PREDICTION,
    PredictionErrors,
    _without,
    foreseeable,
    left_out_errors,
    telling_horizon,
    windows_of,
)
from sysid.estimation.prediction_error import Fit
from sysid.estimation.solver import Settings, fit_parameters
from sysid.planning.excitation import multisine
from tests.sysid.planted import DT, JOINT, NAMES, SENSOR


def errors(*squares: float) -> PredictionErrors:
    """Windows of ten readings with these multiples of what the noise makes of them."""
    return PredictionErrors(10.0 * np.array(squares), np.full(len(squares), 10.0))


@cache
def record(seconds: float) -> Record:
    rng = np.random.default_rng(0)
    run = simulate(JOINT, multisine(rng, round(seconds / DT), DT, 1.5, 2.0), math.pi + 0.5, 0.0)
    return SENSOR.measure(run, rng)[0]


def fitted(seconds: float) -> Fit:
    samples = Samples(JOINT, [record(seconds)], SENSOR)
    return fit_parameters(samples, JOINT, NAMES, disturbances=Disturbances(0.0), settings=Settings(sizes=False))


# how far ahead -------------------------------------------------------------------------------------------------


def test_upright_an_error_grows_as_foreseen_and_hanging_it_does_not() -> None:
    """By e^5 over what can be foreseen, half of it being an error of the speed: cosh(5) of an error of the angle."""
    plain = Model(GeneralJoint(J=0.01, G=2.0), (), RK4(substeps=2), 0.005)
    at_rest = np.zeros(40)
    upright = Record(0.005 * np.arange(41), at_rest, 1e-3 * np.sin(np.arange(41)), None)
    ahead = foreseeable(plain, [upright])
    assert ahead == pytest.approx(GROWTH / math.sqrt(200.0), rel=0.02)
    run = simulate(plain, np.zeros((1, round(ahead / 0.005))), np.array([1e-6]), np.zeros(1))
    assert run.theta[0, -1] == pytest.approx(1e-6 * math.cosh(GROWTH), rel=0.1)
    hanging = replace(upright, theta=upright.theta + math.pi)
    assert foreseeable(plain, [hanging]) == math.inf
    assert foreseeable(plain, [hanging, hanging, upright]) == math.inf, "most of the time it hangs"
    assert foreseeable(plain, [replace(upright, theta=None, theta_dot=np.zeros(41))]) == math.inf


def swing(frequency: float, seconds: float, torque: float = 0.0, rate: float = 0.15, **changed: None) -> Record:
    """A swing of so many hertz that decays at a rate [1/s]."""
    t = np.arange(round(seconds / 0.02) + 1) * 0.02
    theta = math.pi + 0.3 * np.exp(-rate * t) * np.cos(2.0 * math.pi * frequency * t)
    return replace(Record(t, np.full(len(t) - 1, torque), theta, np.gradient(theta, 0.02)), **changed)


@pytest.mark.parametrize("changed", [{}, {"theta_dot": None}, {"theta": None}])
def test_a_free_swing_is_predicted_until_its_amplitude_has_halved(changed: dict[str, None]) -> None:
    assert telling_horizon([swing(0.5, 30.0, **changed)]) == pytest.approx(10.0, rel=0.05), "at least five periods"
    assert telling_horizon([swing(0.5, 30.0, rate=0.05, **changed)]) == pytest.approx(math.log(2.0) / 0.05, rel=0.05)
    assert telling_horizon([swing(0.5, 90.0, rate=0.01, **changed)]) == pytest.approx(40.0, rel=0.05), "at most twenty"
    assert telling_horizon([swing(8.0, 30.0, rate=1.0, **changed)]) == HORIZON, "five are less than a second"
    assert telling_horizon([swing(0.5, 8.0, **changed)]) == HORIZON, "which it does not show"
    assert telling_horizon([swing(0.5, 30.0, **changed), swing(0.5, 30.0, 0.1, **changed)]) == HORIZON, (
        "which is driven"
    )


# comparing -----------------------------------------------------------------------------------------------------


def test_what_predicts_every_window_better_gains_and_the_other_loses() -> None:
    better, worse = errors(*np.linspace(1.0, 2.0, 20)), errors(*np.linspace(3.0, 7.0, 20))
    gain, sd = better.gain(worse)
    loss, other_sd = worse.gain(better)
    assert gain > 2.0 * sd > 0.0 and loss < -2.0 * other_sd < 0.0
    assert better.gain(better) == (0.0, 0.0)


def test_of_two_never_both_gain() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        a, b = (errors(*np.exp(rng.normal(0.0, 3.0, 8))) for _ in range(2))
        assert a.gain(b)[0] + b.gain(a)[0] <= 1e-12


def test_equal_sums_gain_what_the_other_loses() -> None:
    a, b = errors(1.0, 2.0, 3.0, 8.0), errors(8.0, 3.0, 2.0, 1.0)
    assert a.gain(b)[0] == pytest.approx(-b.gain(a)[0], abs=1e-12)
    a, b = errors(1.0, 1.0, 1.0, 9.0), errors(3.0, 3.0, 3.0, 3.0)
    assert a.gain(b)[0] == pytest.approx(-b.gain(a)[0]) and a.gain(b)[0] > 0.0


@pytest.mark.parametrize("size", [1e4, 1e8])
def test_a_window_that_runs_away_does_not_outweigh_the_others(size: float) -> None:
    """What is worse in 29 windows of 30 is not better for the one in which the other runs away."""
    worse, wild = errors(*[8.0] * 30), errors(*[1.0] * 29, size)
    gain, sd = worse.gain(wild)
    assert worse.ratio < wild.ratio, "by the sum of squares it would be"
    assert gain < sd


def test_what_runs_away_is_not_called_better() -> None:
    """Even where it is better in all other windows: its numbers are those of no machine."""
    tame, wild = errors(*[8.0] * 30), errors(*[1.0] * 29, 1e8)
    assert wild.gain(tame)[0] < 0.0


def test_one_window_that_is_predicted_worse_does_not_outweigh_the_others() -> None:
    """Though the sum of squares is larger for it."""
    before, after = errors(*[8.0] * 30), errors(*[1.0] * 29, 500.0)
    assert after.ratio > before.ratio
    gain, sd = after.gain(before)
    assert gain > 2.0 * sd


def test_a_difference_below_the_noise_is_hardly_a_gain() -> None:
    """A window that is predicted to a hundredth of its noise is no hundred times better."""
    gain, _ = errors(*[0.01] * 5).gain(errors(*[1.0] * 5))
    assert 0.0 < gain < math.log(2.0)


def test_a_single_window_proves_nothing() -> None:
    gain, sd = errors(1.0).gain(errors(9.0))
    assert gain > 0.0 and math.isinf(sd)


# leaving out ---------------------------------------------------------------------------------------------------


def test_a_perfect_model_predicts_what_was_left_out_to_the_noise() -> None:
    assert left_out_errors(fitted(12.0), 1.0, 8).ratio == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("seconds", "windows"), [(12.0, 12), (8.0, 8), (4.0, 8), (1.2, 4)])
def test_windows_of_a_short_log_are_shorter(seconds: float, windows: int) -> None:
    """So that there are as many as blocks, down to the shortest that says anything."""
    left_out = left_out_errors(fitted(seconds), 1.0, 8)
    assert len(left_out.squares) == len(left_out.free) == windows
    assert all(w.count * DT >= SHORTEST_PREDICTION - 1e-9 for w in windows_of(fitted(seconds), seconds / windows))


def test_what_is_left_out_did_not_choose_its_numbers() -> None:
    """One Gauss-Newton step gives the numbers that a fit of the other record alone would have given."""
    settings, none = Settings(sizes=False), Disturbances(0.0)
    both = [record(4.0), replace(record(6.0), name="other")]
    whole = fit_parameters(Samples(JOINT, both, SENSOR), JOINT, NAMES, disturbances=none, settings=settings)
    rest = fit_parameters(Samples(JOINT, both[:1], SENSOR), JOINT, NAMES, disturbances=none, settings=settings)
    other = [w for w in windows_of(whole, 1.0) if w.record == 1]
    without = _without(whole, other).parameters
    sd = np.sqrt(np.diag(rest.covariance))
    values = np.array([float(without[n].value) for n in NAMES])
    assert np.max(np.abs(whole.values - rest.values) / sd) > 0.3, "the records agree too well to tell"
    assert np.max(np.abs(values - rest.values) / sd) < 0.1


def test_an_inertia_that_hardly_shows_is_never_left_out_wholly() -> None:
    """Without some of the blocks none at all would be likeliest, and the model would run away there."""
    light = Model(GeneralJoint(J=4e-3, G=0.0), (effect("viscous", b=1.0),), RK4(substeps=4), DT)
    rng, names = np.random.default_rng(3), ("J", "viscous.b")
    run = simulate(light, np.repeat(rng.choice([-1.0, 1.0], 40), 10), 0.0, 0.0)
    sensor = Sensor(theta_dot=2.0)
    samples = Samples(light, [replace(sensor.measure(run, rng)[0], theta=None)], sensor)
    fit = fit_parameters(samples, light, names, disturbances=Disturbances(0.0), settings=Settings(sizes=False))
    inertias = [float(_without(fit, [w], 0.5).parameters["J"].value) for w in windows_of(fit, 1.0)]
    assert min(inertias) == pytest.approx(0.5 * fit.inertia), "no block speaks against it: the law says nothing"
    wholly, half = (left_out_errors(fit, 1.0, 8, least_share=share).ratio for share in (0.0, 0.5))
    assert half < 1.2 and wholly > 1e3


@pytest.mark.parametrize("sensing", [SensorDelay(), FilteredSpeed()], ids=lambda e: e.name)
def test_models_with_and_without_memory_are_judged_by_the_same_windows(sensing: Effect) -> None:
    """Of a rollout that was cut a memory needs the first instants: there are fewer windows, for both of them."""
    training, _ = split([record(8.0)])
    assert any(r.time_since_start[0] > 0.0 for r in training)
    plain = fit_parameters(Samples(JOINT, training, SENSOR), JOINT, NAMES)
    model = JOINT.with_effect(sensing)
    other = fit_parameters(Samples(model, training, SENSOR), model, (*NAMES, f"{sensing.name}.T"))
    lead = max(lead_of(plain.model), lead_of(other.model))
    a, b = (left_out_errors(fit, SHORTEST_PREDICTION, 8, lead) for fit in (plain, other))
    assert len(a.squares) == len(b.squares) != len(left_out_errors(plain, SHORTEST_PREDICTION, 8).squares)
    gain, sd = b.gain(a)
    assert abs(gain) < 4.5 * sd
