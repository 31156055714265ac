"""Least squares recovers what was planted within the error it states, and says when it cannot."""

import json

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import binom, chi2

from study.paper.protocol import paper_model
from sysid import (
    RK4,
    Coulomb,
    GeneralJoint,
    LeastSquares,
    Model,
    Sensor,
    Viscous,
    simulate,
)
from sysid.planning.excitation import multisine, steps
from tests.sysid.planted import ENCODER, PAPER, PAPERS_ENCODER, RICH, SENSOR, assert_found, distance, papers_records

TRUTH = paper_model(2.0, 1.5)


def assert_covered(estimate, truth):
    for name, (low, high) in estimate.interval(0.999).items():
        assert low <= truth.parameters[name].value <= high, name


def rollouts(sensor, n, seed):
    return papers_records(TRUTH, n, seed, sensor, np.random.default_rng([seed, 1]))


def lab(model, sensor, n=4, length=300, seed=0):
    rng = np.random.default_rng(seed)
    u = np.stack(
        [(multisine(rng, length, model.dt, 1.0, 2.5), steps(rng, length, model.dt, 1.0, 0.4))[i % 2] for i in range(n)]
    )
    run = simulate(model, u, np.pi + 0.1 * rng.standard_normal(n), 0.1 * rng.standard_normal(n))
    return sensor.measure(run, rng)


@pytest.mark.parametrize(
    ("sensor", "n"), [(PAPER, 3), (PAPERS_ENCODER, 1), (PAPERS_ENCODER, 4)], ids=["paper 3", "encoder 1", "encoder 4"]
)
def test_errors_are_as_large_as_stated(sensor, n):
    seeds, inside, squares = 24, 0, 0.0
    for seed in range(seeds):
        estimate = LeastSquares(sensor=sensor).fit(paper_model(), rollouts(sensor, n, seed))
        assert estimate.success, estimate.status
        squares += distance(estimate, {"m": 2.0, "l": 1.5})
        inside += sum(low <= x <= high for (low, high), x in zip(estimate.interval().values(), (2.0, 1.5), strict=True))
    low, high = chi2.ppf([0.005, 0.995], 2 * seeds)
    assert low < squares < high
    assert binom.ppf(0.005, 2 * seeds, 0.95) <= inside


@pytest.mark.parametrize("sensor", [PAPER, PAPERS_ENCODER], ids=["paper", "encoder"])
def test_a_cold_start_ends_where_a_start_from_the_truth_ends(sensor):
    agree = 0
    for seed in range(100, 120):
        records = rollouts(sensor, 5, seed)
        cold = LeastSquares(sensor=sensor).fit(paper_model(), records)
        warm = LeastSquares(sensor=sensor, starts=1).fit(TRUTH, records)
        agree += cold.cost <= warm.cost + 0.01
    assert agree >= 19


@pytest.mark.long
def test_whole_steps_that_leave_the_optimum_are_halved():
    """Here Gauss-Newton's own steps grow: speeds alone hardly tell of a start near the upright."""
    estimate = LeastSquares(sensor=PAPER, starts=1).fit(paper_model(), rollouts(PAPER, 50, 5))
    assert "explained" in estimate.status
    assert estimate.values == pytest.approx({"m": 2.0240159, "l": 1.4991440}, abs=1e-6)


def test_the_optimum_is_that_of_whole_rollouts():
    """SciPy's least squares of simulated rollouts, from where ours ended, goes nowhere."""
    records = rollouts(ENCODER, 2, 0)
    estimate = LeastSquares(sensor=ENCODER).fit(paper_model(), records)

    def residuals(z):
        model = paper_model(*z[:2])
        runs = [simulate(model, r.u, *x) for r, x in zip(records, z[2:].reshape(-1, 2), strict=True)]
        pairs = [(run.theta_read, run.theta_dot_read, r) for run, r in zip(runs, records, strict=True)]
        return np.concatenate([np.r_[(q - r.theta) / 0.01, v - r.theta_dot] for q, v, r in pairs])

    begin = np.array([*estimate.values.values(), *(x for r in records for x in (r.theta[0], 0.0))])
    optimum = least_squares(residuals, begin, x_scale="jac", xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(list(estimate.values.values()), optimum.x[:2], rtol=1e-6)
    assert estimate.cost == pytest.approx(2.0 * optimum.cost, rel=1e-9)
    covariance = np.linalg.inv(optimum.jac.T @ optimum.jac)[:2, :2]
    np.testing.assert_allclose(estimate.covariance, covariance, rtol=1e-3)


def test_any_parameters_of_any_model():
    names = [n for n in RICH.parameters if not n.startswith("torque_bias")]
    cold = RICH.with_parameters(
        {"J": 0.1, "G": 1.0, "viscous.b": 0.0, "coulomb.tau_c": 0.0, "delay.T": 0.01, "lag.T": 0.0}
    )
    estimate = LeastSquares(names, SENSOR).fit(cold, lab(RICH, SENSOR))
    assert_found(estimate, RICH)
    assert np.all(np.sqrt(np.diag(estimate.covariance)) < 0.05 * np.array([RICH.parameters[n].value for n in names]))
    assert estimate.noise["theta"] == pytest.approx(0.003, rel=0.1)
    assert estimate.noise["theta_dot"] == pytest.approx(0.05, rel=0.1)
    assert estimate.model.parameters["torque_bias.tau_0"].value == 0.04


def test_speed_alone_finds_its_start_angle():
    sensor = Sensor(theta_dot=0.05)
    truth = Model(GeneralJoint(J=0.05, G=1.2), (Viscous(b=0.03),), RK4(), dt=0.02, u_max=2.0)
    cold = truth.with_parameters({"J": 0.08, "G": 1.0})
    estimate = LeastSquares(("J", "G"), sensor).fit(cold, lab(truth, sensor, n=2))
    assert_covered(estimate, truth)


def test_a_bigger_model_never_ends_with_a_higher_cost_and_a_smaller_one_says_that_it_lacks_something():
    base = Model(GeneralJoint(J=0.05, G=1.2), (Viscous(b=0.05),), RK4(), dt=0.02, u_max=2.0)
    records = lab(base.with_effect(Coulomb(tau_c=0.1)), SENSOR, n=2, length=150)
    small = LeastSquares(("J", "G", "viscous.b"), SENSOR).fit(base, records)
    bigger = small.model.with_effect(Coulomb())
    big = LeastSquares(("J", "G", "viscous.b", "coulomb.tau_c"), SENSOR).fit(bigger, records)
    assert big.cost < small.cost
    assert "lacks something" in small.status
    assert "explained" in big.status


def test_a_joint_that_sticks_is_fitted():
    """Where it rests no small torque moves it: at a point the motion has no slope."""
    truth = Model(GeneralJoint(J=0.05, G=1.2), (Coulomb(tau_c=0.5),), RK4(substeps=2), dt=0.02, u_max=2.0)
    names, cold = ("J", "G", "coulomb.tau_c"), truth.with_parameters({"J": 0.1, "G": 1.0, "coulomb.tau_c": 0.0})
    for seed in range(4):
        estimate = LeastSquares(names, SENSOR, starts=1).fit(cold, lab(truth, SENSOR, n=2, length=200, seed=seed))
        assert "explained" in estimate.status
        assert_covered(estimate, truth)


def test_a_long_record_that_is_sensitive_to_its_start_keeps_honest_intervals():
    """An initial error grows by 10^6 here: its square leaves normal equations without digits."""
    truth = Model(GeneralJoint(J=0.12, G=1.3), (Viscous(b=0.02),), dt=0.02)
    cold, names = Model(GeneralJoint(), (Viscous(),), dt=0.02), ("J", "G", "viscous.b")
    rng = np.random.default_rng(2)
    record = SENSOR.measure(simulate(truth, multisine(rng, 2000, 0.02, 1.5, 2.0), np.pi, 0.0), rng)[0]
    before = None
    for n in (500, 1000, 2000):
        estimate = LeastSquares(names, SENSOR).fit(cold, [record.head(n)])
        assert estimate.success
        assert_covered(estimate, truth)
        assert before is None or all(estimate.sd[k] < before[k] for k in names)
        before = estimate.sd


def test_a_model_that_cannot_follow_whole_rollouts_is_no_success_and_keeps_honest_intervals():
    truth = Model(GeneralJoint(J=0.12, G=1.3), (Viscous(b=0.02), Coulomb(tau_c=0.1)), dt=0.02)
    rng = np.random.default_rng(0)
    records = SENSOR.measure(simulate(truth, multisine(rng, 1000, 0.02, 1.5, 2.0), np.pi, 0.0), rng)
    lacking = Model(GeneralJoint(J=0.1, G=1.0), dt=0.02)
    estimate = LeastSquares(("J", "G"), SENSOR, starts=1).fit(lacking, records)
    assert not estimate.success
    assert "beside a random torque" in estimate.status
    assert 0.05 < estimate.random_torque < 0.5
    assert_covered(estimate, truth)


def test_a_motion_hardly_larger_than_a_noise_that_is_told_too_small_is_followed():
    truth, rng = Model(GeneralJoint(J=0.12, G=1.3), (Viscous(b=0.05),), dt=0.02), np.random.default_rng(0)
    noisy = Sensor(theta=0.03, theta_dot=0.1)
    records = noisy.measure(simulate(truth, 0.03 * multisine(rng, 1000, 0.02, 1.5, 2.0), np.pi, 0.0), rng)
    stated = Sensor(theta=0.02, theta_dot=0.07)
    assert LeastSquares(("J", "G", "viscous.b"), stated, starts=1).fit(truth, records).success


def test_numbers_far_from_one_are_found_from_the_models_own():
    truth = Model(GeneralJoint(J=1e-4, G=0.01), (Viscous(b=1e-5),), dt=0.01)
    rng = np.random.default_rng(0)
    record = SENSOR.measure(simulate(truth, 0.005 * steps(rng, 300, 0.01, 1.0, 0.3), np.pi, 0.0), rng)[0]
    cold = truth.with_parameters({"J": 1.5e-4, "G": 0.008, "viscous.b": 2e-5})
    estimate = LeastSquares(("J", "G", "viscous.b"), SENSOR).fit(cold, [record])
    assert "explained" in estimate.status
    assert_covered(estimate, truth)


def test_a_fit_that_determines_nothing_is_no_success():
    record = rollouts(ENCODER, 1, 0)[0].head(1)
    estimate = LeastSquares(sensor=ENCODER).fit(paper_model(), [record])
    assert not estimate.success
    assert "do not determine" in estimate.status
    assert json.dumps(estimate.to_dict(), allow_nan=False)


def test_what_cannot_be_told_apart_is_said():
    records = rollouts(ENCODER, 1, 0)
    estimate = LeastSquares(("m", "l", "g"), ENCODER).fit(paper_model(), records)
    assert any("m" in s and "g" in s for s in estimate.ambiguous), str(estimate)
