"""The paper's protocol: its draws in their order, its estimates to the digit, and how its rollouts become records."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from study.paper.protocol import averaged_sensor, paper_model, paper_rollouts, transitions
from sysid import GridSearch, InvalidInput, fisher_information, fit
from sysid.estimation.linearisation import Samples

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


def estimate(n, seed, m=2.0, l=1.5, sigma=1.0):  # noqa: E741
    rollouts = paper_rollouts(paper_model(m, l), n, np.random.default_rng(seed), sigma)
    values = GridSearch().fit(paper_model(), transitions(rollouts)).values
    return values["m"], values["l"]


@pytest.mark.parametrize(("run", "published"), FACTS.items())
def test_ten_published_estimates(run, published):
    assert estimate(*run) == pytest.approx(published, abs=1e-9)


@pytest.mark.long
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
        assert estimate(*run, *RUNS[name]) == pytest.approx(published, abs=1e-9), run


def test_the_papers_rollouts_draw_in_the_published_order():
    """One rollout, drawn by hand in the order of the published runs: start seed, then (u, noise, noise) a step."""
    model = paper_model(2.0, 1.5)
    (rollout,) = paper_rollouts(model, 1, np.random.default_rng(4), sigma=0.5, length=8)
    rng = np.random.default_rng(4)
    start = np.random.default_rng(int(rng.integers(0, 2**31 - 1))).uniform(low=[-math.pi, -1.0], high=[math.pi, 1.0])
    state = model.initial_state(*start.tolist())
    for k in range(8):
        u = float(np.float32(rng.uniform(-2.0, 2.0)))
        assert rollout.u[k] == u
        assert rollout.before[k] == float(np.float32(state.theta_dot)) + rng.normal(0.0, 0.5)
        assert math.cos(rollout.theta[k] - state.theta) > 1.0 - 1e-12
        state = model.advance(state, u)
        assert rollout.after[k] == float(np.float32(state.theta_dot)) + rng.normal(0.0, 0.5)


def test_rollouts_do_not_depend_on_how_many_follow():
    few, many = (paper_rollouts(paper_model(), n, np.random.default_rng(6), length=30) for n in (2, 5))
    for a, b in zip(few, many, strict=False):
        np.testing.assert_array_equal(a.u, b.u)
        np.testing.assert_allclose(a.before, b.before, rtol=1e-12)
    assert paper_rollouts(paper_model(), 0, np.random.default_rng(6)) == []


def test_an_instant_that_was_read_twice_counts_as_its_mean():
    (rollout,) = paper_rollouts(paper_model(), 1, np.random.default_rng(2), length=20)
    samples = Samples(paper_model(), [rollout.averaged], averaged_sensor(1.0))
    np.testing.assert_allclose(samples.y[1:-1, 1], 0.5 * (rollout.before[1:] + rollout.after[:-1]))
    assert (samples.y[0, 1], samples.y[-1, 1]) == (rollout.before[0], rollout.after[-1])
    np.testing.assert_allclose(samples.weight[:, 1], [1.0, *(19 * [2.0**0.5]), 1.0])
    np.testing.assert_allclose(samples.weight[:, 0], [1000.0, *(20 * [0.0])])


def test_the_mean_of_two_readings_says_as_much_as_both():
    model = paper_model(2.0, 1.5)
    rollouts = paper_rollouts(model, 2, np.random.default_rng(0))
    starts = np.array([[r.theta[0], 0.0] for r in rollouts])
    records = [r.averaged for r in rollouts]
    assert [(len(r.theta), len(r.theta_dot)) for r in records] == [(1, 201)] * 2
    twice, once = (fisher_information(model, ("m", "l"), records, averaged_sensor(s), starts) for s in (1.0, 2.0**0.5))
    assert np.trace(twice) == pytest.approx(2.0 * np.trace(once), rel=0.03)


def test_a_fit_finds_the_machine_too():
    """Euler steps, a speed clip, start angles and noisy speeds alone."""
    rollouts = paper_rollouts(paper_model(2.0, 1.5), 10, np.random.default_rng(1), sigma=0.1)
    estimate = fit(paper_model(), [r.averaged for r in rollouts], averaged_sensor(0.1))
    assert estimate.success and estimate.sd["m"] < 0.02
    for name, value in (("m", 2.0), ("l", 1.5)):
        assert abs(estimate.values[name] - value) < 4.0 * estimate.sd[name]


@pytest.mark.parametrize("wrong", [{"n": -1}, {"length": 0}, {"sigma": -1.0}])
def test_a_measurement_that_cannot_be_is_refused(wrong):
    with pytest.raises(InvalidInput, match="expected n >= 0 rollouts of at least one step"):
        paper_rollouts(paper_model(), rng=np.random.default_rng(0), **({"n": 1} | wrong))
