"""The solver: it is output error where no random torque acts, and its answers are as good and as sure as they say."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import sysid
from study.paper.protocol import averaged_sensor, paper_model, paper_rollouts
from sysid import (
    Coulomb,
    Delay,
    Effect,
    GeneralJoint,
    Lag,
    Model,
    Record,
    RodPendulum,
    Sensor,
    effect,
    fisher_information,
    simulate,
)
from sysid.estimation import solver
from sysid.estimation.disturbances import Disturbances
from sysid.estimation.horizon_fit import horizon_fit
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit, inverse
from sysid.estimation.prior import Prior
from sysid.estimation.solver import Settings, bounded_step, fit_parameters, relaxation
from sysid.planning.excitation import multisine
from tests.sysid.planted import DT, JOINT, NAMES, SENSOR, accelerated

TRUTH = np.array([0.3, 2.0, 0.07])
AFAR = JOINT.with_parameters({"J": 0.4, "G": 1.5, "viscous.b": 0.02})
NONE = Disturbances(0.0)
HELD = Settings(sizes=False)
QUIET = Settings(shared_error=False)


def logs(count: int, seed: int = 0, s: float = 0.0, model: Model = JOINT) -> tuple[list[list[Record]], np.ndarray]:
    """Logs of two rollouts of 6 s under a random acceleration of sd s [rad/s^2], T = 0.3 s; and where they began."""
    run, made = accelerated(model, 2 * count, 300, s, 0.3, seed)
    starts = np.stack([run.theta[:, 0], run.theta_dot[:, 0]], axis=1).reshape(count, 2, 2)
    return [made[2 * i : 2 * i + 2] for i in range(count)], starts


def sd_of(fit: Fit) -> np.ndarray:
    """sd (P,) of the fitted numbers."""
    return np.sqrt(np.diag(fit.covariance))


def test_output_error_reaches_the_bound() -> None:
    """No unbiased answer is better: its errors are as large as the Cramer-Rao bound says, and its sd are the bound."""
    given, starts = logs(16)
    information = fisher_information(JOINT, NAMES, given[0], SENSOR, starts[0])
    fits = [
        fit_parameters(Samples(AFAR, records, SENSOR), AFAR, NAMES, disturbances=NONE, settings=HELD)
        for records in given
    ]
    assert all(f.converged for f in fits)
    np.testing.assert_allclose(sd_of(fits[0]), np.sqrt(np.diag(np.linalg.inv(information))), rtol=0.02)
    errors = [(f.values - TRUTH, np.linalg.inv(f.covariance)) for f in fits]
    squares, n = sum(float(e @ N @ e) for e, N in errors), 3 * len(given)  # chi-square of n degrees
    assert abs(squares - n) < 4.0 * math.sqrt(2.0 * n)


def test_a_log_without_a_random_torque_is_fitted_as_by_output_error() -> None:
    """The sizes of the disturbances are free, are found to be small, and cost next to nothing."""
    for records in logs(2, seed=1)[0]:
        samples = Samples(AFAR, records, SENSOR)
        fit = fit_parameters(samples, AFAR, NAMES)
        whole = fit_parameters(samples, AFAR, NAMES, disturbances=NONE, settings=HELD)
        other = sysid.LeastSquares(NAMES, SENSOR).fit(AFAR, records)
        sd = np.array(list(other.sd.values()))
        assert fit.converged
        assert fit.disturbances.s < 0.01 and fit.disturbances.sigma_o < 0.5 * 0.003
        assert np.max(np.abs(fit.values - list(other.values.values())) / sd) < 0.4
        assert np.max(np.abs(whole.values - list(other.values.values())) / sd) < 0.02
        np.testing.assert_allclose(sd_of(whole), sd, rtol=0.02)
        np.testing.assert_allclose(sd_of(fit), sd, rtol=0.35)
        assert fit.deviance <= whole.deviance + 0.05
        again = fit_parameters(samples, fit.model, NAMES, near=fit, disturbances=NONE, settings=HELD)
        assert np.max(np.abs(again.values - whole.values) / sd) < 0.05


AGAIN = {
    "viscous": (JOINT, NAMES),
    "coulomb": (replace(JOINT, effects=(effect("coulomb", tau_c=0.15),)), ("J", "G", "coulomb.tau_c")),
    "delay": (replace(JOINT, effects=(effect("delay", T=0.05),)), ("J", "G", "delay.T")),
}


@pytest.mark.parametrize("s", [0.0, 0.6])
@pytest.mark.parametrize(("model", "names"), AGAIN.values(), ids=AGAIN.keys())
def test_a_fit_that_is_fitted_again_does_not_move(model: Model, names: tuple[str, ...], s: float) -> None:
    """Neither from its own motion nor, by more than the disturbances' flat likelihood allows, from the readings."""
    (records,), _ = logs(1, seed=3, s=s, model=model)
    begin = model.with_parameters({"J": 0.4, "G": 1.5})
    samples = Samples(begin, records, SENSOR)
    fit = fit_parameters(samples, begin, names)
    again = fit_parameters(samples, fit.model, names, near=fit)
    anew = fit_parameters(samples, fit.model, names, disturbances=fit.disturbances)
    assert fit.converged and again.converged and anew.converged
    for other, most in ((again, 0.05), (anew, 0.1)):
        assert np.max(np.abs(other.values - fit.values) / sd_of(fit)) < most
        assert abs(other.deviance - fit.deviance) < 0.5


def test_where_it_began_does_not_matter() -> None:
    (records,), _ = logs(1, seed=4, s=0.6)
    samples = Samples(AFAR, records, SENSOR)
    fit = fit_parameters(samples, AFAR, NAMES)
    for numbers in ((0.15, 4.0, 0.3), (0.9, 1.0, 0.01)):
        other = fit_parameters(samples, JOINT.with_parameters(dict(zip(NAMES, numbers, strict=True))), NAMES)
        assert np.max(np.abs(other.values - fit.values) / sd_of(fit)) < 0.1


def test_a_motion_that_is_fitted_is_the_one_that_was_made() -> None:
    """Where no random torque acts the motion of the fit is the rollout itself: closer than its readings by far."""
    rng = np.random.default_rng(5)
    run = simulate(JOINT, multisine(rng, 300, DT, 1.5, 2.0), math.pi, 1.0)
    fit = fit_parameters(Samples(AFAR, SENSOR.measure(run, rng), SENSOR), AFAR, NAMES, disturbances=NONE, settings=HELD)
    assert np.max(np.abs(fit.motion.x[:, 0] - run.theta)) < 0.003
    assert np.max(np.abs(fit.motion.x[:, 1] - run.theta_dot)) < 0.01
    assert np.max(np.abs(fit.linearised.system.gap)) < 1e-4, "steps of the model end where the next one begins"


@pytest.mark.parametrize("s", [0.0, 0.6])
def test_the_likelihood_falls_beside_the_found_disturbances(s: float) -> None:
    for records in logs(1, seed=6, s=s)[0]:
        fit = fit_parameters(Samples(AFAR, records, SENSOR), AFAR, NAMES)
        here = fit.filter.deviance
        for move in ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.3), (0.0, -0.3), (0.4, 0.4), (-0.4, 0.4)):
            beside = fit.linearised.system.filter(fit.disturbances.scaled(np.exp([*move, 0.0])))
            assert beside.deviance > here - 0.1, move
        if s > 0.0:  # a size that is there is found, not only not refuted
            for move in (0.5, -0.5):
                beside = fit.linearised.system.filter(fit.disturbances.scaled(np.exp([move, 0.0, 0.0])))
                assert beside.deviance > here + 4.0


@pytest.mark.parametrize("s", [0.0, 0.2])
def test_sd_are_those_of_the_likelihood(s: float) -> None:
    """A number held k sd away, all others fitted again, raises the deviance by k^2: 4 for two sd."""
    (records,), _ = logs(1, seed=7, s=s)
    samples, close = Samples(AFAR, records, SENSOR), replace(HELD, settled=1e-3, negligible=1e-3)
    fit = fit_parameters(samples, AFAR, NAMES, disturbances=Disturbances(s, 0.3), settings=close)
    sds = np.sqrt(np.diag(fit.likelihood_covariance))
    for name, value, sd in zip(NAMES, fit.values, sds, strict=True):
        rest = [n for n in NAMES if n != name]
        raised = [
            fit_parameters(
                samples, fit.model.with_parameters({name: value + k * sd}), rest, near=fit, settings=close
            ).filter.deviance
            - fit.filter.deviance
            for k in (-2.0, 2.0)
        ]
        assert np.mean(raised) == pytest.approx(4.0, rel=0.15)
        assert min(raised) > 2.5


@pytest.mark.parametrize("s", [0.0, 0.6])
@pytest.mark.parametrize(
    ("name", "bounds", "end"), [("G", (0.5, 1.8), 1.8), ("G", (2.3, 4.0), 2.3), ("J", (0.32, 1.0), 0.32)]
)
def test_bounds_are_kept_and_the_others_fitted_beside_them(
    s: float, name: str, bounds: tuple[float, float], end: float
) -> None:
    (records,), _ = logs(1, seed=8, s=s)
    start = {"J": 0.4, "G": min(max(1.5, bounds[0] + 0.2), bounds[1] - 0.2) if name == "G" else 1.5}
    plant = GeneralJoint(**start, bounds={name: bounds})
    model = replace(AFAR, plant=plant)
    samples = Samples(model, records, SENSOR)
    fit = fit_parameters(samples, model, NAMES, settings=QUIET)
    rest = [n for n in NAMES if n != name]
    beside = fit_parameters(samples, model.with_parameters({name: end}), rest, settings=QUIET)
    assert fit.values[NAMES.index(name)] == end
    values = np.array([fit.values[NAMES.index(n)] for n in rest])
    assert np.max(np.abs(values - beside.values) / sd_of(beside)) < 0.15


def test_what_the_readings_do_not_determine_stays_where_it_was_thought() -> None:
    """Of m, l and g two combinations show in the motion: these are found, the third stays, and its sd says so."""
    (records,), _ = logs(1, seed=10, model=replace(JOINT, effects=()))
    rod = replace(JOINT, plant=RodPendulum(m=1.0, l=1.0, g=9.81), effects=())
    fit = fit_parameters(Samples(rod, records, SENSOR), rod, ("m", "l", "g"), settings=QUIET)
    joint = replace(JOINT, effects=())
    other = fit_parameters(Samples(joint, records, SENSOR), joint, ("J", "G"), settings=QUIET)
    J, G = float(fit.model.inertia()), float(fit.model.plant.gravity_torque(0.5 * math.pi))
    assert fit.converged
    np.testing.assert_allclose((np.array([J, G]) - other.values) / sd_of(other), 0.0, atol=0.2)
    start = np.array([1.0, 1.0, 9.81])
    assert np.all(np.abs(fit.values - start) < start)
    assert np.all(np.isinf(sd_of(fit)))


def test_a_log_that_says_nothing_moves_nothing() -> None:
    """A joint at rest, and sensors that read noise: an inertia may be anything, and does not run away."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        read = (math.pi + 0.003 * rng.standard_normal(301), 0.05 * rng.standard_normal(301))
        rest = Record(DT * np.arange(301), np.zeros(300), *read)
        fit = fit_parameters(Samples(JOINT, [rest], SENSOR), JOINT, ("J", "G"), settings=QUIET)
        assert np.all(np.abs(fit.values - TRUTH[:2]) < 1.5 * TRUTH[:2])
        assert np.max(sd_of(fit) / fit.values) > 0.4, "it is not known, and says so"


@pytest.mark.parametrize("J", [0.03, 0.3, 3.0])
def test_no_inertia_vanishes_where_a_random_torque_explains_all(J: float) -> None:
    """Without a torque from the drive only the ratio of inertia and gravity shows, and no reading tells their size."""
    (records,), _ = logs(1, seed=16, model=replace(JOINT, effects=()))
    start = replace(JOINT, plant=GeneralJoint(J=J, G=2.0), effects=())
    samples = Samples(start, [replace(r, u=np.zeros_like(r.u)) for r in records], SENSOR)
    for begin in (None, Disturbances(30.0, 0.01)):
        fit = fit_parameters(samples, start, ("J", "G"), disturbances=begin, settings=QUIET)
        assert fit.converged and 0.1 * J < fit.values[0] < 10.0 * J


def test_what_is_known_of_a_positive_number_is_its_logarithm() -> None:
    """A tenth of it is as far as ten times it; a number that may be 0 is known by differences."""
    prior = Prior.of(JOINT, NAMES, 1.0, 0.0, None, ())
    J, G, _ = TRUTH
    for factor in (2.0, 10.0):
        more, less = prior.deviance(TRUTH * [factor, 1.0, 1.0]), prior.deviance(TRUTH / [factor, 1.0, 1.0])
        assert more == pytest.approx(less) == pytest.approx(math.log(factor) ** 2)
    assert prior.deviance(np.array([J, 0.0, 0.0])) == pytest.approx(1.0), "friction is not known beforehand"
    assert prior.deviance(np.array([J, 3.0 * G, 5.0])) == pytest.approx(4.0)
    assert prior.deviance(np.array([1e-9, G, 0.0])) > 300.0
    slope, off = prior.rows(TRUTH * 1.5)
    for i, moved in enumerate(np.diag(1e-6 * TRUTH)):
        change = (prior.rows(TRUTH * 1.5 + moved)[1] - prior.rows(TRUTH * 1.5 - moved)[1]) / (2.0 * moved[i])
        np.testing.assert_allclose(change, -slope[:, i], rtol=1e-5, atol=1e-9)
    assert np.all(np.isfinite(off))


def test_slopes_are_taken_no_wider_than_the_machine_is_the_same() -> None:
    """Speeds alone, Euler's steps and a clip: an angle that only adds up may be far off, and the clip is not there."""
    truth = paper_model(m=2.0, l=1.5)
    records = [r.averaged for r in paper_rollouts(truth, 4, np.random.default_rng(1), sigma=0.1)]
    samples = Samples(paper_model(), records, averaged_sensor(0.1))
    fit = fit_parameters(samples, paper_model(), ("m", "l"))
    spread, widest = np.max(fit.motion.spread, axis=0), np.array(Settings().widest)
    assert spread[0] <= widest[0]
    assert spread[1] <= widest[1] * np.std(samples.smoothed[:, 1]) + 1e-12
    assert fit.converged
    assert np.max(np.abs(fit.values - [2.0, 1.5]) / sd_of(fit)) < 4.0 and sd_of(fit)[0] < 0.05
    anywhere = replace(Settings(), widest=(math.inf,) * 3, patience=40, least_share=1.0)
    anyhow = fit_parameters(samples, paper_model(), ("m", "l"), settings=anywhere)
    assert not anyhow.converged and sd_of(anyhow)[0] > 3.0 * sd_of(fit)[0], "wider slopes are another machine's"
    # what loses its way ends at the best place that it had
    assert anyhow.deviance < fit.deviance + 30.0


def test_a_model_that_runs_away_within_a_sample_has_a_fit_that_has_not_ended() -> None:
    (records,), _ = logs(1, seed=11, s=0.6)
    away = JOINT.with_effect(sysid.effect("sensor_delay", T=0.05)).with_effect(sysid.effect("drag", c=1e200))
    fit = fit_parameters(Samples(away, records, SENSOR), away, ("J", "sensor_delay.T"))
    assert not fit.converged and not math.isfinite(fit.deviance)


def test_a_fit_without_free_numbers_finds_motion_and_disturbances() -> None:
    (records,), _ = logs(1, seed=11, s=0.6)
    fit = fit_parameters(Samples(JOINT, records, SENSOR), JOINT, ())
    assert fit.converged and fit.covariance.shape == (0, 0) and fit.values.shape == (0,)
    assert fit.disturbances.s == pytest.approx(0.6, rel=0.5)


def test_records_of_different_lengths_count_as_one_log() -> None:
    """Their informations add: what two logs say together is what the sum of both says."""
    given, _ = logs(2, seed=12)
    cut = [given[0][0], given[0][1].head(170)], [given[1][0].head(31), given[1][1]]
    apart = [
        fit_parameters(Samples(JOINT, records, SENSOR), JOINT, NAMES, disturbances=NONE, settings=HELD)
        for records in cut
    ]
    both = fit_parameters(Samples(JOINT, [*cut[0], *cut[1]], SENSOR), JOINT, NAMES, disturbances=NONE, settings=HELD)
    information = [np.linalg.inv(f.covariance) for f in apart]
    np.testing.assert_allclose(both.covariance, np.linalg.inv(sum(information)), rtol=0.05)
    mean = np.linalg.solve(sum(information), sum(N @ f.values for N, f in zip(information, apart, strict=True)))
    assert np.max(np.abs(both.values - mean) / sd_of(both)) < 0.1


def test_a_step_is_least_squares_within_its_bounds() -> None:
    rng = np.random.default_rng(13)
    for _ in range(50):
        Z, e = rng.standard_normal((40, 3)) * [1.0, 1e3, 1e-4], rng.standard_normal(40)
        free = np.linalg.lstsq(Z, e, rcond=None)[0]
        wide = bounded_step(Z, e, -2.0 * np.abs(free), 2.0 * np.abs(free))
        np.testing.assert_allclose(wide, free, rtol=1e-9)
        low, high = -np.abs(free) * [2.0, 0.5, 2.0], np.abs(free) * [2.0, 0.5, 2.0]
        narrow = bounded_step(Z, e, low, high)
        size = np.linalg.norm(Z, axis=0)
        best = lsq_linear(Z / size, e, (low * size, high * size), method="bvls").x / size
        assert np.all((low <= narrow) & (narrow <= high))
        if np.all(np.abs(best[[0, 2]]) < high[[0, 2]] * (1.0 - 1e-9)):  # one bound alone is met
            np.testing.assert_allclose(narrow, best, rtol=1e-6)


def test_a_step_leaves_what_nothing_shows() -> None:
    rng = np.random.default_rng(14)
    Z, e = rng.standard_normal((30, 3)), rng.standard_normal(30)
    Z[:, 1] = 0.0
    step = bounded_step(Z, e, np.full(3, -9.0), np.full(3, 9.0))
    assert step[1] == 0.0
    np.testing.assert_allclose(step[[0, 2]], np.linalg.lstsq(Z[:, [0, 2]], e, rcond=None)[0], rtol=1e-9)
    twin = np.column_stack([Z[:, 0], Z[:, 0]])  # two that do the same share what they do, and do not run apart
    np.testing.assert_allclose(*bounded_step(twin, e, np.full(2, -9.0), np.full(2, 9.0)), rtol=1e-9)
    assert bounded_step(np.zeros((5, 0)), np.ones(5), np.zeros(0), np.zeros(0)).shape == (0,)


def test_a_covariance_is_the_inverse_of_the_information_in_any_units() -> None:
    rng = np.random.default_rng(15)
    Z, units = rng.standard_normal((30, 3)), np.array([1e-6, 1.0, 1e6])
    N = Z.T @ Z
    np.testing.assert_allclose(
        inverse(N * np.outer(units, units)) * np.outer(units, units), np.linalg.inv(N), rtol=1e-9
    )


@pytest.mark.parametrize("taken", [1.0, 0.8])
@pytest.mark.parametrize("overshoot", [1.0, 1.5, 3.0])
def test_steps_that_go_to_and_fro_are_relaxed_to_the_optimum(overshoot: float, taken: float) -> None:
    """Steps that are too long by a constant factor, of which a share was taken, point back beyond the optimum."""
    far = np.array([3.0, -1.0, 0.5])
    before = (1.0 + overshoot) * far
    rest = far - taken * before
    now = (1.0 + overshoot) * rest
    np.testing.assert_allclose(rest - relaxation(taken, before, now) * now, 0.0, atol=1e-12)
    assert relaxation(taken, far, 0.4 * far) == relaxation(taken, far, -0.4 * far) == 1.0, "whole ones get there"


def sticking_joint(seed: int, start: Model, *late: Effect) -> Samples:
    """The samples of a joint with dry friction of 0.5 N m, whose gears add a torque from one sample to the next."""
    rng = np.random.default_rng(seed)
    truth = Model(GeneralJoint(J=0.04, G=2.4), (Coulomb(tau_c=0.5), *late), dt=0.02)
    u = np.stack([multisine(np.random.default_rng(10 * seed + k), 300, 0.02, 1.4, 1.0) for k in range(3)])
    gear = 0.15 * rng.standard_normal(u.shape)
    run = simulate(truth, u + gear, np.full(3, math.pi), np.zeros(3))
    records = [replace(r, u=command) for r, command in zip(Sensor(theta=0.001).measure(run, rng), u, strict=True)]
    return Samples(start, records, Sensor(theta=0.001))


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_a_joint_that_sticks_now_and_then_is_fitted_to_the_end(seed: int) -> None:
    """Whole steps go to and fro between motions that stick at other instants, or stay at a less likely one."""
    start = Model(GeneralJoint(J=0.1, G=1.0), (Coulomb(tau_c=0.1),), dt=0.02)
    samples = sticking_joint(seed, start)
    whole, fit = (
        fit_parameters(samples, start, ("J", "G", "coulomb.tau_c"), settings=replace(Settings(), patience=patience))
        for patience in (40, 12)
    )
    assert fit.converged
    assert fit.deviance < whole.deviance - 10.0
    np.testing.assert_allclose(fit.values, [0.04, 2.4, 0.5], rtol=0.1)


@pytest.mark.parametrize("seed", [1, 3, 7, 13])
def test_a_fit_that_goes_to_and_fro_ends_at_the_likeliest_place(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may do so between a long step and a short one, of which a larger share is taken."""
    places, wanders = list[float](), solver._Progress.wanders

    def noted(self: Any, taken: float, deviance: float) -> bool:
        places.append(deviance)
        return wanders(self, taken, deviance)

    monkeypatch.setattr(solver._Progress, "wanders", noted)
    start = Model(GeneralJoint(J=0.1, G=1.0), (Coulomb(tau_c=0.1), Lag(T=0.05)), dt=0.02)
    samples = sticking_joint(seed, start, Delay(T=0.03))
    fit = fit_parameters(samples, start, ("J", "G", "coulomb.tau_c", "lag.T"))
    assert fit.converged
    late = places[Settings().patience :]
    assert len(places) < Settings().iterations and fit.filter.deviance == min(late) < late[-1] + 1e-9


@pytest.mark.parametrize("seed", [2, 7, 12])
def test_numbers_that_predict_best_are_found_where_a_joint_sticks_now_and_then(seed: int) -> None:
    """Slopes promise more than steps keep there, and no step is small enough to end the search."""
    start = Model(GeneralJoint(J=0.1, G=1.0), (Coulomb(tau_c=0.1),), dt=0.02)
    fit = horizon_fit(fit_parameters(sticking_joint(seed, start), start, ("J", "G", "coulomb.tau_c")), 1.0)
    assert fit is not None and fit.converged
    np.testing.assert_allclose(fit.values, [0.04, 2.4, 0.5], rtol=0.1)


def test_a_number_that_changes_nothing_leaves_the_others_as_sure_as_they_are() -> None:
    Z = np.random.default_rng(4).standard_normal((40, 3))
    alone = inverse(Z.T @ Z)
    Z = np.insert(Z, 1, 0.0, axis=1)
    covariance, others = inverse(Z.T @ Z), np.ix_([0, 2, 3], [0, 2, 3])
    np.testing.assert_allclose(covariance[others], alone, rtol=1e-12)
    assert covariance[1, 1] == math.inf and not np.any(covariance[1, [0, 2, 3]])
    assert np.all(inverse(np.ones((2, 2))) == math.inf), "two that change the same"
    assert inverse(np.zeros((0, 0))).shape == (0, 0)
