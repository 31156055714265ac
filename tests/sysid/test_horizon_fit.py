"""Where a model lacks something, its numbers are those that predict best over a horizon."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from sysid import RK4, Coulomb, Delay, GeneralJoint, Lag, Model, Record, Viscous, diagnose, simulate, split
from sysid.estimation.first_fit import first_fit
from sysid.estimation.held_out import held_out_error, refit
from sysid.estimation.horizon_fit import HorizonFit, _Predictions, horizon_fit
from sysid.estimation.linearisation import Samples
from sysid.estimation.output_error import Response
from sysid.estimation.prediction_error import Fit
from sysid.physics.ops import Array
from sysid.planning.excitation import steps
from tests.sysid.planted import DT, SENSOR, with_memory

PLAIN = Model(GeneralJoint(J=0.3, G=2.0), (Viscous(b=0.3),), RK4(substeps=2), DT)
NAMES = ("J", "G", "viscous.b")
HIDDEN = {
    "delay": PLAIN.with_effect(Delay(T=0.06)),
    "lag": PLAIN.with_effect(Lag(T=0.1)),
    "coulomb": PLAIN.with_effect(Coulomb(0.3)),
}


@cache
def record(hidden: str, seed: int = 0, torque: float = 0.0, seconds: float = 24.0) -> Record:
    """Steps of the torque, beside a random torque of that size [N m] over 0.3 s."""
    rng, N = np.random.default_rng(seed), round(seconds / DT)
    u = steps(rng, N, DT, 2.0, 0.5)
    d = with_memory(torque * rng.standard_normal((1, N)), 0.3)
    run = simulate(HIDDEN.get(hidden, PLAIN), u + d, math.pi + 0.2, 0.0)
    return replace(SENSOR.measure(run, rng)[0], u=np.ravel(u))


@cache
def likeliest(hidden: str, seed: int = 0, torque: float = 0.0) -> Fit:
    training, _ = split([record(hidden, seed, torque)])
    return first_fit(Samples(PLAIN, training, SENSOR), PLAIN, NAMES)


@cache
def predicting(hidden: str) -> HorizonFit:
    fit = horizon_fit(likeliest(hidden), 1.0)
    assert fit is not None
    return fit


def _errors(fit: HorizonFit, values: Array) -> Array:
    return refit(Response(fit.model.with_numbers(fit.names, values.tolist()), fit.samples, fit.windows)).lin.e


@pytest.mark.parametrize("hidden", HIDDEN)
def test_no_other_numbers_predict_better(hidden: str) -> None:
    fit = predicting(hidden)
    least = float(np.sum(_errors(fit, fit.values) ** 2))
    assert least == pytest.approx(float(np.sum(fit.errors**2)), rel=1e-3)
    assert least < float(np.sum(_errors(fit, likeliest(hidden).values) ** 2))
    for i, value in enumerate(fit.values):
        for factor in (0.97, 1.03):
            moved = fit.values.copy()
            moved[i] = factor * value
            assert float(np.sum(_errors(fit, moved) ** 2)) > least * (1.0 - 1e-3)


@pytest.mark.parametrize("hidden", HIDDEN)
def test_slopes_lead_downhill(hidden: str) -> None:
    """J'e is half the slope of the sum of squares, with the states refitted, at numbers that are not the best."""
    fit = predicting(hidden)
    predictions = _Predictions(likeliest(hidden), fit.windows)
    values = np.array([1.2, 0.8, 1.1]) * fit.values
    slope = predictions.slopes(values).T @ predictions.errors(values)
    for i, value in enumerate(values):
        above, below = values.copy(), values.copy()
        above[i], below[i] = 1.001 * value, 0.999 * value
        sums = [float(np.sum(_errors(fit, numbers) ** 2)) for numbers in (above, below)]
        assert slope[i] == pytest.approx((sums[0] - sums[1]) / (0.004 * value), rel=0.1)


@pytest.mark.parametrize("hidden", ["delay", "lag"])
def test_a_late_drive_that_is_missing_bends_the_numbers_less(hidden: str) -> None:
    for seed in range(3):
        likely, truth = likeliest(hidden, seed), PLAIN.numbers(NAMES)
        predicting = horizon_fit(likely, 1.0)
        assert predicting is not None
        far, farther = (np.abs(f.values / truth - 1.0) for f in (predicting, likely))
        assert np.all(far[:2] < 0.8 * farther[:2])


def test_likelihood_decides_where_the_model_explains_the_log() -> None:
    fit = likeliest("nothing")
    assert fit.undisturbed and horizon_fit(fit, 1.0) is None


def test_numbers_that_predict_best_stay() -> None:
    fit = predicting("lag")
    again = horizon_fit(fit, 1.0)
    assert again is not None
    assert np.all(np.abs(again.values - fit.values) < 0.1 * np.sqrt(np.diag(fit.covariance)))


def test_intervals_hold_the_truth_beside_a_random_torque() -> None:
    """95 % intervals of three numbers in twelve logs."""
    fits = [horizon_fit(likeliest("nothing", seed, 0.1), 1.0) for seed in range(12)]
    far = [np.abs(f.values - PLAIN.numbers(NAMES)) / np.sqrt(np.diag(f.covariance)) for f in fits if f is not None]
    assert len(far) == 12
    assert np.mean(np.array(far) < 1.96) >= 0.85


def test_a_model_that_runs_away_has_no_horizon_fit() -> None:
    light = Model(GeneralJoint(J=1e-9, G=2.0, bounds={"J": (1e-12, 1.0)}), PLAIN.effects, RK4(2), DT)
    assert horizon_fit(replace(likeliest("lag"), model=light), 1.0) is None


def test_a_diagnosis_tells_the_numbers_that_predict_best() -> None:
    """The lag that is missing may not be named: the model as it came tells them, too."""
    log = [record("lag")]
    diagnosis = diagnose(PLAIN, log, SENSOR, effects=["spring"], parameters=NAMES)
    training, held_out = split(log)
    likely = first_fit(Samples(PLAIN, training, SENSOR), PLAIN, NAMES)
    assert diagnosis.error.ratio < 0.97 * held_out_error(likely.model, held_out, SENSOR).ratio
    assert diagnosis.error.ratio == held_out_error(diagnosis.model, held_out, SENSOR).ratio
