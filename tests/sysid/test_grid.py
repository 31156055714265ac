"""Grid search: the best cell, whatever the parameters, the blocks and the length of the records."""

import math

import numpy as np
import pytest

from sysid import (
    Delay,
    GridSearch,
    Model,
    Record,
    RodPendulum,
    SemiImplicitEuler,
    Sensor,
    Viscous,
    simulate,
)
from sysid.planning.excitation import multisine


def rod(m=1.0, l=1.0):  # noqa: E741
    return Model(RodPendulum(m, l, bounds={"m": (0.3, 3.0), "l": (0.3, 3.0)}), integrator=SemiImplicitEuler())


def noisy(model, n):
    u = np.random.default_rng(4).uniform(-2.0, 2.0, (n, 200))
    speeds = Sensor(theta=1e-6, theta_dot=1.0)
    return speeds.measure(simulate(model, u, np.arange(n), np.zeros(n)), np.random.default_rng(5))


def noise_free(model, n=400):
    u = multisine(np.random.default_rng(0), n, model.dt, 2.0, 3.0)
    run = simulate(model, u, 2.0, 0.0)
    return Record(run.t, u, run.theta, run.theta_dot)


def test_without_noise_the_true_cell_wins():
    estimate = GridSearch().fit(rod(), [noise_free(rod(2.01, 1.515))])
    assert estimate.values == pytest.approx({"m": 2.01, "l": 1.515})
    assert estimate.noise["theta_dot"] < 1e-9 and estimate.success


def test_any_parameter_of_any_model_input_effects_included():
    model = Model(RodPendulum(m=1.0, l=1.0), (Viscous(bounds={"b": (0.0, 10.0)}), Delay(T=0.05, longest=0.1)), dt=0.05)
    truth = {"viscous.b": 0.5, "delay.T": 0.025}
    record = noise_free(model.with_parameters(truth))
    search = GridSearch(parameters=("viscous.b", "delay.T"), points=41)
    assert search.fit(model, record).values == pytest.approx(truth)


def test_ties_go_to_the_first_cell_the_first_parameter_slowest():
    still = Record(0.05 * np.arange(11), np.zeros(10), np.full(11, 0.0), np.zeros(11))
    assert GridSearch().fit(rod(), still).values == {"m": 0.3, "l": 0.3}


def test_blocks_of_samples_do_not_change_the_answer(monkeypatch):
    records = noisy(rod(2.0, 1.5), n=3)
    whole = GridSearch().fit(rod(), records)
    monkeypatch.setattr("sysid.estimation.identifiers.grid._BLOCK", 60_000)
    assert GridSearch().fit(rod(), records).values == whole.values


def test_a_record_says_as_much_as_its_steps_one_by_one():
    records = noisy(rod(2.0, 1.5), n=2)
    steps = [r.part(k, k + 1) for r in records for k in range(len(r))]
    whole, cut = (GridSearch().fit(rod(), log) for log in (records, steps))
    assert cut.values == whole.values and cut.n_readings == whole.n_readings
    np.testing.assert_allclose(cut.covariance, whole.covariance, rtol=1e-9)


def test_a_sensor_that_is_far_too_good_is_doubted():
    estimate = GridSearch(sensor=Sensor(theta_dot=0.1)).fit(rod(), noisy(rod(2.0, 1.5), n=2))
    assert "times the sensor's sd: the model lacks something" in estimate.status
    assert estimate.noise["theta_dot"] == pytest.approx(1.0, rel=0.2) and math.isnan(estimate.cost)
