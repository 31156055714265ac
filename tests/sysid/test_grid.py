"""Grid search: the paper's identifier, to the digit."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from sysid import (
    Delay,
    GridSearch,
    InvalidInput,
    Model,
    Record,
    RodPendulum,
    Sensor,
    Viscous,
    paper_model,
    paper_rollouts,
    simulate,
)
from sysid.planning.excitation import multisine

PUBLISHED = Path(__file__).parents[2].parent / "shared" / "data" / "paper"
RUNS = {  # file: hidden truth (m, l) and the sd of the speed readings
    "summary": (2.0, 1.5, 1.0),
    "exp_gap_1.5_1.2": (1.5, 1.2, 1.0),
    "exp_gap_2.5_2.0": (2.5, 2.0, 1.0),
    "exp_noise_0.5": (2.0, 1.5, 0.5),
    "exp_noise_2.0": (2.0, 1.5, 2.0),
}
# (n, seed): (m, l), from the paper's published per-run results (theta_hat_mass, theta_hat_length)
FACTS = {
    (5, 0): (3.0, 1.29),
    (5, 1): (3.0, 1.38),
    (5, 2): (1.38, 1.515),
    (5, 3): (3.0, 1.245),
    (5, 4): (3.0, 1.38),
    (10, 0): (3.0, 1.425),
    (10, 1): (3.0, 1.38),
    (10, 2): (1.11, 1.515),
    (10, 3): (3.0, 1.425),
    (10, 4): (1.74, 1.47),
}


def found(n, seed, m=2.0, l=1.5, sigma=1.0):  # noqa: E741
    records = paper_rollouts(paper_model(m, l), n, np.random.default_rng(seed), sigma)
    values = GridSearch().fit(paper_model(), records).values
    return values["m"], values["l"]


@pytest.mark.parametrize(("run", "published"), FACTS.items())
def test_ten_published_estimates(run, published):
    assert found(*run) == pytest.approx(published, abs=1e-9)


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the authors' per-run results are not beside this checkout")
@pytest.mark.parametrize("name", RUNS)
def test_every_published_estimate(name):
    with open(PUBLISHED / f"{name}.csv", newline="", encoding="utf-8") as file:
        rows = {
            (int(r["n"]), int(r["seed"])): (float(r["theta_hat_mass"]), float(r["theta_hat_length"]))
            for r in csv.DictReader(file)
            if int(r["n"]) > 0
        }
    assert len(rows) >= 10
    for run, published in rows.items():
        assert found(*run, *RUNS[name]) == pytest.approx(published, abs=1e-9), run


def noise_free(model, n=400):
    u = multisine(np.random.default_rng(0), n, model.dt, 2.0, 3.0)
    run = simulate(model, u, 2.0, 0.0)
    return Record(run.t, u, run.theta, run.theta_dot)


def test_without_noise_the_true_cell_wins():
    estimate = GridSearch().fit(paper_model(), [noise_free(paper_model(2.01, 1.515))])
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
    assert GridSearch().fit(paper_model(), still).values == {"m": 0.3, "l": 0.3}


def test_blocks_of_samples_do_not_change_the_answer(monkeypatch):
    records = paper_rollouts(paper_model(2.0, 1.5), 3, np.random.default_rng(4))
    whole = GridSearch().fit(paper_model(), records)
    monkeypatch.setattr("sysid.estimation.identifiers.grid._BLOCK", 60_000)
    assert GridSearch().fit(paper_model(), records).values == whole.values


@pytest.mark.parametrize(
    ("search", "message"),
    [
        (GridSearch(parameters=("m", "mass")), "unknown parameter 'mass': this model has m, l, g"),
        (GridSearch(parameters=()), "no parameters to fit: choose among m, l, g"),
        (GridSearch(parameters="ml"), r"parameters = 'ml': expected a list of names"),
        (GridSearch(parameters=("m", "m")), "a parameter is named twice in m, m"),
        (GridSearch(points=1), "points = 1: expected at least 2"),
        (GridSearch(points=1001), r"1001\^2 cells are too many for a grid: use LeastSquares"),
    ],
)
def test_bad_settings_are_refused(search, message):
    with pytest.raises(InvalidInput, match=message):
        search.fit(paper_model(), [noise_free(paper_model())])


def test_missing_channels_and_records_are_named():
    t, u = 0.05 * np.arange(4), np.zeros(3)
    with pytest.raises(InvalidInput, match="log has no theta: a grid search needs angles and speeds"):
        GridSearch().fit(paper_model(), [Record(t, u, theta_dot=np.zeros(4), name="log")])
    with pytest.raises(InvalidInput, match="no records were given"):
        GridSearch().fit(paper_model(), [])


def test_a_sensor_that_is_far_too_good_is_doubted():
    records = paper_rollouts(paper_model(2.0, 1.5), 2, np.random.default_rng(3))
    estimate = GridSearch(sensor=Sensor(theta_dot=0.1)).fit(paper_model(), records)
    assert "times the sensor's sd: the model lacks something" in estimate.status
    assert estimate.noise["theta_dot"] == pytest.approx(1.0, rel=0.2) and math.isnan(estimate.cost)
