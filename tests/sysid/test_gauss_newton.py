"""Gauss-Newton on windows: the optimum within the bounds, what it is worth, and how far a model can be followed."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binom, chi2

from sysid import (
    AngleOffset,
    Backlash,
    Coulomb,
    DeadZone,
    Delay,
    Drag,
    Drift,
    Effect,
    Lag,
    LeastSquares,
    Model,
    Periodic,
    Record,
    Ripple,
    RodPendulum,
    Saturation,
    Sensor,
    SensorDelay,
    Spring,
    Stamp,
    Stribeck,
    TorqueBias,
    TorqueGain,
    VelocityGain,
    Viscous,
    simulate,
)
from sysid.excitation import steps
from sysid.identify.gauss_newton import NEGLIGIBLE, Fit, Solution, fit_longest, fit_windows, reduce
from sysid.response import Response
from sysid.windows import cut

DT = 0.02
SENSOR = Sensor(0.003, 0.05)
TRUTH = np.array([1.0, 0.9])
PLANT = ("m", "l")


def rod(*effects: Effect, m: float = 1.0, l: float = 0.9) -> Model:  # noqa: E741
    return Model(RodPendulum(m=m, l=l), effects, dt=DT)


def logs(model: Model, seed: int = 0, n: int = 3, seconds: float = 4.0, sensor: Sensor = SENSOR) -> list[Record]:
    rng = np.random.default_rng(seed)
    u = np.array([steps(rng, round(seconds / DT), DT, 1.5, 0.3) for _ in range(n)])
    return simulate(model, u, math.pi + rng.uniform(-0.8, 0.8, n), np.zeros(n)).measure(sensor, rng)


def whole(model: Model, records: list[Record], p: np.ndarray, sensor: Sensor = SENSOR) -> Fit:
    names = tuple(n for n in model.parameters if n != "g")
    return fit_windows(model, names, records, sensor, math.inf, p)


@pytest.fixture(scope="module")
def clean() -> list[Record]:
    return logs(rod())


@pytest.fixture(scope="module")
def right(clean: list[Record]) -> Fit:
    return fit_longest(rod(m=1.2, l=0.7), PLANT, clean, SENSOR)


# the optimum -------------------------------------------------------------------------------------------------

HIDDEN = {
    "nothing": (),
    "friction": (Coulomb(tau_c=0.05), Viscous(b=0.03)),
    "Stribeck": (Stribeck(tau_c=0.03, excess=0.05, v_s=0.3),),
    "late drive": (Delay(T=0.033), Drag(c=0.01)),
    "slow drive": (Lag(T=0.04), TorqueBias(tau_0=0.05)),
    "dead zone": (DeadZone(d=0.1), Drift(r=0.02)),
    "stamp": (Stamp(s=-0.4), Spring(k=0.2)),
    "sensors": (SensorDelay(T=0.03), VelocityGain(c=1.05), AngleOffset(offset=0.03)),
    "play": (Backlash(width=0.03),),
    "waves": (Ripple(a=0.05, b=0.02, order=4.0), Periodic(a=0.05, b=0.02, f=1.3)),
    "clip": (Saturation(limit=1.0),),
}


@pytest.mark.parametrize("effects", HIDDEN.values(), ids=HIDDEN.keys())
def test_the_truth_is_found_within_its_stated_error(effects: tuple[Effect, ...]) -> None:
    truth = rod(*effects)
    begin = [e if isinstance(e, Saturation) else e.at_neutral() for e in effects]
    fit = fit_longest(rod(*begin, m=1.1, l=0.8), tuple(n for n in truth.parameters if n != "g"), logs(truth), SENSOR)
    error = fit.solution.p - [truth.parameters[n].value for n in fit.names]
    assert fit.solution.converged
    assert math.isinf(fit.horizon)
    assert error @ np.linalg.solve(fit.covariance, error) < chi2.ppf(0.999, len(error))
    assert abs(math.sqrt(fit.variance) - 1.0) < 3.3 / math.sqrt(2.0 * fit.degrees)


@pytest.mark.parametrize("begin", [(3.0, 2.0), (0.3, 0.4), (3.0, 0.4), (0.5, 2.0)])
def test_one_optimum_from_everywhere(begin: tuple[float, float], right: Fit, clean: list[Record]) -> None:
    fit = fit_longest(rod(m=begin[0], l=begin[1]), PLANT, clean, SENSOR)
    assert np.all(np.abs(fit.solution.p - right.solution.p) < 0.1 * np.sqrt(np.diag(right.covariance)))


def test_nothing_beside_it_is_better(right: Fit) -> None:
    lin, response = right.solution.lin, right.response
    g = right.reduced.gradient
    assert 0.5 * g @ np.linalg.solve(right.reduced.information, g) < NEGLIGIBLE
    rng = np.random.default_rng(0)
    for _ in range(20):
        p = right.solution.p + np.sqrt(np.diag(right.covariance)) * rng.standard_normal(2)
        starts = right.solution.starts + rng.normal(0.0, [1e-3, 1e-2], right.solution.starts.shape)
        assert 0.5 * np.sum(response.residual(p, starts) ** 2) > lin.cost


def test_multiple_shooting_agrees(right: Fit, clean: list[Record]) -> None:
    """Output error over whole rollouts is one problem, however it is solved."""
    other = LeastSquares(PLANT, SENSOR).fit(rod(), clean)
    sd = np.sqrt(np.diag(right.covariance))
    assert np.all(np.abs(np.array(list(other.values.values())) - right.solution.p) < 0.05 * sd)
    np.testing.assert_allclose(list(other.sd.values()), sd, rtol=0.05)


@pytest.mark.parametrize("sensor", [Sensor(0.003), Sensor(None, 0.05), Sensor(None, 0.05, 0.01)])
def test_one_channel_is_enough(sensor: Sensor) -> None:
    fit = fit_longest(rod(m=1.1, l=0.8), PLANT, logs(rod(), sensor=sensor), sensor)
    error = fit.solution.p - TRUTH
    assert math.isinf(fit.horizon)
    assert error @ np.linalg.solve(fit.covariance, error) < chi2.ppf(0.999, 2)
    assert set(fit.residual_sd()) == {c for c in ("theta", "theta_dot") if getattr(sensor, c) is not None}


def test_rollouts_of_all_lengths_are_fitted_together() -> None:
    records = [r.head(n) for r, n in zip(logs(rod(), n=4), (200, 7, 1, 90), strict=True)]
    fit = fit_longest(rod(m=1.1, l=0.8), PLANT, records, SENSOR)
    error = fit.solution.p - TRUTH
    assert error @ np.linalg.solve(fit.covariance, error) < chi2.ppf(0.999, 2)
    assert fit.degrees == 2 * (201 + 8 + 2 + 91) - 2 - 2 * 4


def test_of_several_starts_the_nearest_is_taken(clean: list[Record]) -> None:
    fit = fit_windows(rod(), PLANT, clean, SENSOR, 1.0, [np.array([3.0, 3.0]), TRUTH, np.array([0.4, 2.0])])
    near = fit_windows(rod(), PLANT, clean, SENSOR, 1.0, TRUTH)
    np.testing.assert_array_equal(fit.solution.p, near.solution.p)


def test_the_same_numbers_again(right: Fit, clean: list[Record]) -> None:
    again = fit_longest(rod(m=1.2, l=0.7), PLANT, clean, SENSOR)
    np.testing.assert_array_equal(again.solution.p, right.solution.p)
    np.testing.assert_array_equal(again.covariance, right.covariance)


# bounds ------------------------------------------------------------------------------------------------------


def test_a_bound_holds_and_the_others_are_best_given_it() -> None:
    """A machine that gains speed would need b < 0: what remains is the fit without friction."""
    records = logs(rod(Viscous(b=-0.02, bounds={"b": (-1.0, 1.0)})))
    held = fit_windows(rod(Viscous()), (*PLANT, "viscous.b"), records, SENSOR, 1.0)
    without = fit_windows(rod(), PLANT, records, SENSOR, 1.0)
    free = fit_windows(rod(Viscous(bounds={"b": (-1.0, 1.0)})), (*PLANT, "viscous.b"), records, SENSOR, 1.0)
    assert held.solution.p[2] == 0.0
    assert "viscous.b" in held.estimate().at_bound
    sd = np.sqrt(np.diag(without.covariance))
    assert np.all(np.abs(held.solution.p[:2] - without.solution.p) < 0.05 * sd)
    assert held.solution.lin.cost == pytest.approx(without.solution.lin.cost, abs=NEGLIGIBLE)
    assert free.solution.lin.cost < held.solution.lin.cost - 10.0
    assert abs(free.solution.p[2] + 0.02) < 4.0 * math.sqrt(free.covariance[2, 2])


def test_own_bounds_hold(clean: list[Record]) -> None:
    tight = Model(RodPendulum(m=1.3, l=0.8, bounds={"m": (1.2, 2.0)}), dt=DT)
    fit = fit_windows(tight, PLANT, clean, SENSOR, 0.5)
    assert fit.solution.p[0] == 1.2
    only_l = fit_windows(rod(m=1.2), ("l",), clean, SENSOR, 0.5)
    assert fit.solution.p[1] == pytest.approx(only_l.solution.p[0], abs=0.05 * math.sqrt(only_l.covariance[0, 0]))


# what the numbers are worth ----------------------------------------------------------------------------------


def test_elimination_is_the_schur_complement(right: Fit) -> None:
    """F = M_pp - M_px M_xx^-1 M_xp over all starts at once, and the step it gives is that of the whole system."""
    lin = right.solution.lin
    K, R, P = lin.S_p.shape
    S = np.zeros((K, R, 2 * K + P))
    for k in range(K):
        S[k, :, 2 * k : 2 * k + 2] = lin.S_x[k]
    S[..., 2 * K :] = lin.S_p
    M, b = S.reshape(-1, 2 * K + P).T @ S.reshape(-1, 2 * K + P), S.reshape(-1, 2 * K + P).T @ lin.e.ravel()
    xx, px, pp = M[: 2 * K, : 2 * K], M[2 * K :, : 2 * K], M[2 * K :, 2 * K :]
    F = pp - px @ np.linalg.solve(xx, px.T)
    np.testing.assert_allclose(right.reduced.information, F, rtol=1e-6)
    np.testing.assert_allclose(
        np.linalg.solve(right.reduced.information, right.reduced.gradient), np.linalg.solve(M, b)[2 * K :], atol=1e-9
    )
    np.testing.assert_allclose(right.covariance, right.variance * np.linalg.inv(F), rtol=1e-6)


def test_long_windows_know_more() -> None:
    """F grows, in every direction of the parameters, from windows of any length to whole rollouts."""
    model = rod(Coulomb(tau_c=0.05))
    records = logs(model)
    names = (*PLANT, "coulomb.tau_c")
    found = []
    for horizon in (0.25, 0.5, 1.0, 2.0, math.inf):
        response = Response(model, names, records, SENSOR, cut(records, horizon))
        found.append(reduce(response.linearise(np.array([1.0, 0.9, 0.05]), response.starts)).information)
    size = np.sqrt(np.diag(found[-1]))
    for shorter, longer in pairwise(found):
        assert np.linalg.eigvalsh((longer - shorter) / np.outer(size, size))[0] > -1e-3
    sd = [np.sqrt(np.diag(np.linalg.inv(F))) for F in found]
    assert np.all(sd[0] > 3.0 * sd[-1])


SEEDS = 60
COVERED = {"as it is": (), "Coulomb friction added": (Coulomb(tau_c=0.04),)}


@pytest.mark.parametrize("effects", COVERED.values(), ids=COVERED.keys())
def test_intervals_cover_and_the_bound_is_reached(effects: tuple[Effect, ...]) -> None:
    """e' F e with F of the truth is chi-square (Cramer-Rao), e' C^-1 e with the fit's own covariance nearly so."""
    truth = rod(*effects)
    names = tuple(n for n in truth.parameters if n != "g")
    exact = np.array([truth.parameters[n].value for n in names])
    begin = exact * np.array([1.05, 0.97, *[1.3] * (len(names) - 2)])
    bound, own, covered = [], [], []
    for seed in range(SEEDS):
        records = logs(truth, 1000 + seed, n=2, seconds=3.0)
        fit = whole(truth, records, begin)
        error = fit.solution.p - exact
        bound.append(error @ fit.reduced.information @ error)
        own.append(error @ np.linalg.solve(fit.covariance, error))
        covered += [low <= v <= high for v, (low, high) in zip(exact, fit.estimate().interval().values(), strict=True)]
    freedom = SEEDS * len(names)
    low, high = np.sqrt(chi2.ppf([0.0005, 0.9995], freedom) / freedom)
    assert low < math.sqrt(np.sum(bound) / freedom) < high
    assert low < math.sqrt(np.sum(own) / freedom) < 1.03 * high  # s^2 is itself an estimate
    few, many = binom.ppf([0.0005, 0.9995], len(covered), 0.95)
    assert few <= sum(covered) <= many


def test_errors_that_hang_together_widen_the_intervals(clean: list[Record], right: Fit) -> None:
    wrong = fit_windows(rod(), PLANT, logs(rod(Coulomb(tau_c=0.1))), SENSOR, 1.0)
    naive = np.sqrt(np.diag(wrong.variance * np.linalg.inv(wrong.reduced.information)))
    assert wrong.inflation > 1.8 > right.inflation
    assert np.all(np.sqrt(np.diag(wrong.covariance)) > 1.2 * naive)
    assert "pseudo-true" in wrong.estimate().status
    assert "explained to the sensor's noise" in right.estimate().status


def test_a_sensor_that_is_told_wrong_changes_the_variance_alone(right: Fit, clean: list[Record]) -> None:
    loud = Sensor(3.0 * SENSOR.theta, 3.0 * SENSOR.theta_dot)  # type: ignore[operator]
    fit = fit_longest(rod(m=1.2, l=0.7), PLANT, clean, loud)
    assert fit.variance == pytest.approx(right.variance / 9.0, rel=1e-3)
    np.testing.assert_allclose(fit.covariance, right.covariance, rtol=1e-3)
    assert fit.residual_sd() == pytest.approx(right.residual_sd(), rel=1e-3)


def test_what_the_motion_does_not_show_is_infinitely_uncertain(clean: list[Record]) -> None:
    """m and the torque's factor appear as c/m alone; l stands in the period."""
    fit = fit_windows(rod(TorqueGain()), (*PLANT, "torque_gain.c"), clean, SENSOR, math.inf)
    estimate = fit.estimate()
    assert np.isinf(estimate.sd["m"])
    assert np.isinf(estimate.sd["torque_gain.c"])
    assert estimate.sd["l"] < 0.01
    assert not estimate.success
    assert estimate.status.endswith("the records do not determine m, torque_gain.c")
    assert estimate.ambiguous == ("the records do not determine these parameters: m, torque_gain.c",)


# how far a model can be followed -----------------------------------------------------------------------------


def test_the_right_model_is_followed_for_whole_rollouts(right: Fit) -> None:
    assert math.isinf(right.horizon)
    assert right.follows
    assert math.isinf(right.estimate().horizon)
    assert right.estimate().status == "converged on whole rollouts; the readings are explained to the sensor's noise"


@pytest.mark.parametrize("hidden", [Viscous(b=0.3), Coulomb(tau_c=0.3), TorqueBias(tau_0=0.5), Delay(T=0.1)])
def test_a_wrong_model_is_followed_for_a_short_while(hidden: Effect) -> None:
    records = logs(rod(hidden))
    wrong = fit_longest(rod(), PLANT, records, SENSOR)
    assert wrong.horizon <= 1.0
    assert wrong.variance > 4.0
    assert f"windows of {wrong.horizon:g} s" in wrong.estimate().status
    names = (*PLANT, *(f"{hidden.name}.{k}" for k in hidden.parameters))
    assert math.isinf(fit_longest(rod(hidden.at_neutral()), names, records, SENSOR).horizon)


def test_a_motion_that_forgets_its_start_is_cut() -> None:
    """Balanced upright without control an error grows by exp(4 t): 14 s cannot be one window."""
    t = DT * np.arange(701)
    balanced = Record(t, np.zeros(700), np.zeros(701), np.zeros(701))
    response = Response(rod(), PLANT, [balanced], SENSOR, cut([balanced]))
    lin = response.linearise(TRUTH, np.zeros((1, 2)))
    fit = Fit(response, Solution(TRUTH, np.zeros((1, 2)), lin, True), math.inf, rod())
    assert fit.growing
    assert not fit.follows


def test_states_of_a_fit_are_those_of_its_windows(clean: list[Record]) -> None:
    fit = fit_windows(rod(), PLANT, clean, SENSOR, 1.0)
    for i, record in enumerate(clean):
        path = np.array([fit.state(i, k) for k in range(len(record) + 1)])
        assert np.sqrt(np.mean((path[:, 0] - record.theta) ** 2)) < 1.2 * SENSOR.theta  # type: ignore[operator]
    assert fit.state(len(clean), 0) is None


def test_a_fit_begins_where_a_near_one_of_the_same_windows_ended() -> None:
    """Also where windows overlap by their leads, and a wrong model drifts by the end of each."""
    records = logs(rod(Coulomb(tau_c=0.3)), n=2)
    near = fit_windows(rod(), PLANT, records, SENSOR, 1.0, lead=0.3)
    for w, start in zip(near.response.windows, near.solution.starts, strict=True):
        assert near.state(w.record, w.begin) == pytest.approx(start)
    more, names = near.model.with_effect(Coulomb(tau_c=1e-6)), (*PLANT, "coulomb.tau_c")
    with_more = fit_windows(more, names, records, SENSOR, 1.0, near=near, lead=0.3)
    assert with_more.solution.lin.cost < near.solution.lin.cost


def test_windows_of_one_interval_can_be_fitted() -> None:
    """As much as nothing is known, but nothing breaks."""
    fit = fit_windows(rod(), PLANT, [logs(rod())[0].head(40)], SENSOR, DT)
    assert np.all(np.isfinite(fit.solution.p))
    assert np.all(np.diag(fit.covariance) > 0.0)
