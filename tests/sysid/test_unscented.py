"""Unscented Kalman filter: truth within the stated error, from poor starts, for any parameters; angles; positivity."""

import math
from dataclasses import replace

import numpy as np
import pytest

from study.paper.protocol import paper_model
from sysid import (
    Coulomb,
    Delay,
    InvalidInput,
    Lag,
    Model,
    PointMassPendulum,
    Record,
    RodPendulum,
    Sensor,
    UnscentedKalman,
    Viscous,
    simulate,
)
from sysid.estimation.identifiers.unscented import Coordinates, residual, square_root
from sysid.planning.excitation import multisine
from tests.sysid.planted import ENCODER, PAPER, PAPERS_ENCODER, distance, papers_records

TRUTH = {"m": 2.0, "l": 1.5}


def rollouts(n, seed, sensor):
    return papers_records(paper_model(**TRUTH), n, seed, sensor, np.random.default_rng(1000 + seed))


def measured(model, sensor, n, seed, amplitude=2.0, length=150):
    """n rollouts of a model under multisines from random starts."""
    rng = np.random.default_rng(seed)
    u = np.stack([multisine(rng, length, model.dt, amplitude, 2.0) for _ in range(n)])
    return sensor.measure(simulate(model, u, rng.uniform(-3.0, 3.0, n), rng.uniform(-1.0, 1.0, n)), rng)


@pytest.mark.long
@pytest.mark.parametrize(("sensor", "largest"), [(PAPER, 0.12), (PAPERS_ENCODER, 0.006)], ids=["paper", "encoder"])
def test_the_papers_truth_is_recovered_within_the_stated_error(sensor, largest):
    """Cold start at (1, 1); the mean of e' P^-1 e over 6 seeds has expectation 2 and sd 0.82."""
    distances, errors = [], []
    for seed in range(6):
        estimate = UnscentedKalman(sensor=sensor).fit(paper_model(), rollouts(4, seed, sensor))
        assert estimate.success, estimate.status
        distances.append(distance(estimate, TRUTH))
        errors.append(math.dist(estimate.values.values(), TRUTH.values()))
    assert 0.3 < np.mean(distances) < 2.0 + 3.3 * 0.82
    assert math.sqrt(np.mean(np.square(errors))) < largest


@pytest.mark.parametrize("truth", [(0.4, 0.4), (2.9, 2.9), (0.4, 2.8), (2.9, 0.5)])
def test_it_finds_the_corners_of_the_bounds(truth):
    truth = dict(zip(("m", "l"), truth, strict=True))
    estimate = UnscentedKalman().fit(paper_model(), measured(paper_model(**truth), ENCODER, 3, 0))
    assert estimate.success and distance(estimate, truth) < 13.8  # chi2(2), 0.999


@pytest.mark.long
def test_any_parameters_input_effects_included():
    model = Model(RodPendulum(), (Viscous(), Coulomb(), Delay(), Lag(T=0.05)), dt=0.05)
    truth = {"m": 2.0, "l": 1.5, "viscous.b": 0.2, "coulomb.tau_c": 0.1, "delay.T": 0.083, "lag.T": 0.1}
    records = measured(model.with_parameters(truth), ENCODER, 5, 1, amplitude=5.0)
    estimate = UnscentedKalman(parameters=tuple(truth)).fit(model, records)
    assert estimate.success and distance(estimate, truth) < 22.5  # chi2(6), 0.999
    assert estimate.noise == pytest.approx({"theta": 0.01, "theta_dot": 1.0}, rel=0.05)


def test_a_plant_with_wide_bounds_and_angles_alone():
    truth = {"m": 0.4, "l": 0.5}
    records = measured(Model(PointMassPendulum(**truth), dt=0.05), Sensor(theta=0.01), 4, 2)
    estimate = UnscentedKalman(sensor=Sensor(theta=0.01)).fit(Model(PointMassPendulum(), dt=0.05), records)
    assert estimate.success and distance(estimate, truth) < 13.8
    assert set(estimate.noise) == {"theta"} and estimate.n_readings == 4 * 151


def test_whole_turns_between_reading_and_state_do_not_matter():
    records = rollouts(2, 3, ENCODER)
    turned = [replace(r, theta=r.theta + 2.0 * math.pi * turns) for r, turns in zip(records, (3, -5), strict=True)]
    plain, wrapped = (UnscentedKalman().fit(paper_model(), r).values for r in (records, turned))
    assert wrapped == pytest.approx(plain, rel=1e-8)


def test_angle_residuals_take_the_shorter_way_and_speeds_do_not():
    a, b = np.array([3.1, 3.1]), np.array([-3.1, -3.1])
    np.testing.assert_allclose(residual(np.array([0, 1]), a, b), [6.2 - 2.0 * math.pi, 6.2])


def test_a_swing_through_the_cut_is_followed():
    """A rod that turns over and over crosses pi many times."""
    model = paper_model(**TRUTH)
    spinning = simulate(model, np.full(150, 2.0), 0.0, 6.0)
    assert np.ptp(spinning.theta) > 6.0 * math.pi
    estimate = UnscentedKalman().fit(paper_model(), ENCODER.measure(spinning, np.random.default_rng(0)))
    assert estimate.success and distance(estimate, TRUTH) < 13.8


@pytest.mark.long
def test_information_adds_up_and_counts_no_reading_twice(monkeypatch):
    """Ten copies of a record say that it is ten times as sure: the sd falls by sqrt(10), however often it sweeps."""
    (record,) = rollouts(1, 2, ENCODER)
    one, ten = (UnscentedKalman().fit(paper_model(), [record] * n) for n in (1, 10))
    for name in TRUTH:
        assert one.sd[name] / ten.sd[name] == pytest.approx(math.sqrt(10.0), rel=0.15)
    monkeypatch.setattr("sysid.estimation.identifiers.unscented.GENTLE", (10.0, 10.0, 3.0, 3.0))
    longer = UnscentedKalman().fit(paper_model(), [record])
    assert longer.sd == pytest.approx(one.sd, rel=0.05)


def test_an_exact_sensor_keeps_the_covariance_positive():
    sensor = Sensor(theta=1e-6, theta_dot=1e-5)
    estimate = UnscentedKalman(sensor=sensor).fit(paper_model(), measured(paper_model(**TRUTH), sensor, 2, 5))
    np.testing.assert_array_equal(estimate.covariance, estimate.covariance.T)
    assert np.all(np.linalg.eigvalsh(estimate.covariance) > 0.0)
    assert estimate.values == pytest.approx(TRUTH, rel=1e-5)


@pytest.mark.long
def test_a_model_that_lacks_friction_is_doubted():
    lossy = replace(paper_model(**TRUTH), effects=(Viscous(b=0.3),))
    estimate = UnscentedKalman().fit(paper_model(), measured(lossy, ENCODER, 2, 6))
    assert "the model lacks something" in estimate.status or not estimate.success


def test_same_records_same_numbers():
    records = rollouts(1, 0, PAPER)
    one, other = (UnscentedKalman(sensor=PAPER).fit(paper_model(), records) for _ in range(2))
    np.testing.assert_array_equal(one.covariance, other.covariance)
    assert one.values == other.values


@pytest.mark.parametrize(
    "parameters",
    [
        {"m": 2.9, "l": 0.31, "g": 9.0},
        {"viscous.b": 0.2, "coulomb.tau_c": 3.0, "lag.T": 0.01, "delay.T": 0.199},
    ],
)
def test_coordinates_come_back_and_have_the_stated_slope(parameters):
    model = Model(RodPendulum(), (Viscous(), Coulomb(), Lag(), Delay())).with_parameters(parameters)
    free = [model.parameters[n] for n in parameters]
    free += [replace(free[0], bounds=b) for b in ((-math.inf, math.inf), (-1.0, math.inf), (-math.inf, 5.0))]
    g, p = Coordinates(free), np.array([q.value for q in free])
    s = g.inverse(p)
    np.testing.assert_allclose(g(s), p, rtol=1e-12)
    np.testing.assert_allclose(g.slope(s), (g(s + 1e-6) - g(s - 1e-6)) / 2e-6, rtol=1e-6)
    bounds = np.array([q.bounds for q in free]).T
    far = g(np.linspace(-50.0, 50.0, 11)[:, None] * np.ones(len(free)))
    assert np.all((bounds[0] <= far) & (far <= bounds[1]))


def test_a_number_at_its_bound_starts_inside():
    at = [replace(RodPendulum().parameters["m"], value=v) for v in (0.3, 3.0)]
    assert np.all(np.isfinite(Coordinates(at).inverse(np.array([0.3, 3.0]))))


@pytest.mark.parametrize("shift", [1.0, 0.0, -1e-9], ids=["positive", "singular", "slightly negative"])
def test_the_square_root_is_one_of_a_positive_matrix(shift):
    direction = np.array([3.0, -1.0, 2.0])
    P = np.outer(direction, direction) + shift * np.eye(3)
    U = square_root(P)
    np.testing.assert_allclose(U.T @ U, P, atol=1e-7)
    assert np.all(np.linalg.eigvalsh(U.T @ U) >= -1e-15)


RECORD = measured(paper_model(**TRUTH), ENCODER, 1, 0, length=5)[0]
LACKING = Record(RECORD.t, RECORD.u, theta=RECORD.theta, name="log")


@pytest.mark.parametrize(("records", "message"), [([], "no records were given"), ([LACKING], "log has no theta_dot")])
def test_bad_records_are_refused(records, message):
    with pytest.raises(InvalidInput, match=message):
        UnscentedKalman().fit(paper_model(), records)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("m", "mass"), "unknown parameter 'mass': this model has m, l, g"),
        ((), "no parameters to fit: choose among m, l, g"),
    ],
)
def test_names_of_no_parameters_are_refused(names, message):
    with pytest.raises(InvalidInput, match=message):
        UnscentedKalman(names).fit(paper_model(), [RECORD])
