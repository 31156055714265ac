"""What the strategies' methods promise, each by itself: a bound that is kept, a truth or an optimum that is found."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.special import expit

from policies.control.dynamic_programming import solve
from policies.environments import task
from policies.evaluation import evaluate, rollout
from study.paper.protocol import paper_model
from study.strategies.bayes_sim import BayesSim, DensityNetwork, statistics
from study.strategies.candidates import CrossEntropy
from study.strategies.identified import designed_torques
from study.strategies.learned_search import META_TRAINING_GRID, AdaptSim, AutoTuned, Levels
from study.strategies.plant import SENSORS, BudgetedPlant
from study.strategies.readings import sensed, smoothed, smoothing_covariance, summary_statistics
from study.strategies.simopt import SimOpt, reps_weights, weighted_normal
from study.strategies.strategy import Play, Situation, TrainedAgent, Tried
from study.trials.ground_truth import PRIOR, hidden_machine
from sysid import Record, fit, simulate

ELSEWHERE = dataclasses.replace(paper_model(m=1.5, l=1.2), integrator=PRIOR.integrator)
"""A plant inside the family, and none of the experiment's."""


def swing(state, t):
    return 2.0 * np.sign(state.theta_dot)


def new_situation(budget=5, sensing="encoder", seed=1):
    return Situation(PRIOR, SENSORS[sensing], budget, seed, np.random.default_rng(seed))


def perfect(rollouts, rng):
    """Rollouts of the plant elsewhere whose readings have no error."""
    u = rng.uniform(-2.0, 2.0, (rollouts, 200))
    run = simulate(ELSEWHERE, u, rng.uniform(-3.0, 3.0, rollouts), rng.uniform(-1.0, 1.0, rollouts))
    return [Record(run.t, *rows) for rows in zip(run.u, run.theta, run.theta_dot, strict=True)]


@pytest.mark.parametrize("kl", [0.1, 0.5, 1.0, 2.0])
def test_a_step_of_relative_entropy_search_keeps_its_bound_and_uses_it(kl):
    rng = np.random.default_rng(0)
    samples = rng.standard_normal((2000, 2))
    weights = reps_weights(-(np.abs(samples[:, 0] - 1.0) ** 1.5), kl)
    assert np.sum(weights) == pytest.approx(1.0)
    assert np.sum(weights * np.log(weights * len(weights))) == pytest.approx(kl, rel=0.02)
    mean, C = weighted_normal(samples, weights)
    # of all distributions with its moments the normal is the nearest to the first one, N(0, 1)
    moved = 0.5 * (np.trace(C) + mean @ mean - 2.0 - np.linalg.slogdet(C)[1])
    assert 0.0 < moved < kl + 0.1
    assert mean[0] > 0.2 and abs(mean[1]) < 0.15


def test_returns_that_are_all_the_same_move_nothing():
    assert reps_weights(np.full(7, -3.0), 1.0) == pytest.approx(np.full(7, 1.0 / 7.0))


def test_simopt_moves_to_the_parameters_of_the_plant():
    """Under one policy, from the distribution about the prior: three rounds, as a dialogue makes them."""
    rng, situation, strategy = np.random.default_rng(3), new_situation(), SimOpt()
    seen = rollout(swing, ELSEWHERE, rng.uniform(-3, 3, 4), rng.uniform(-1, 1, 4))
    rows = [a.T for a in (seen.u[:-1], seen.theta, seen.theta_dot)]
    tried = Tried([Record(0.05 * np.arange(200), *row) for row in zip(*rows, strict=True)], np.zeros(4))
    mean, C = situation.believed, 0.25 * np.eye(2)
    before = np.linalg.norm(mean - [1.5, 1.2])
    for _ in range(9):
        drawn = np.clip(situation.rng.multivariate_normal(mean, C, 200), 0.3, 3.0)
        off = strategy.discrepancy(situation, TrainedAgent("", swing), tried, drawn)
        mean, C = weighted_normal(drawn, reps_weights(-off, strategy.kl))
    assert np.linalg.norm(mean - [1.5, 1.2]) < 0.25 * before
    assert situation.simulated == 9 * 200 * 4 * 200


def test_dropo_finds_the_truth_in_data_without_noise():
    pytest.importorskip("cma")
    from study.strategies.dropo import Dropo

    mean, sd = Dropo().distribution(new_situation(), perfect(4, np.random.default_rng(5)))
    assert mean == pytest.approx([1.5, 1.2], rel=0.04)
    assert sd[1] < 0.02  # the mass shows in what a torque does alone, which is little


def test_dropo_widens_where_the_parameters_really_differ_from_rollout_to_rollout():
    pytest.importorskip("cma")
    from study.strategies.dropo import Dropo

    rng, situation, n = np.random.default_rng(6), new_situation(), 12
    lengths = rng.normal(1.2, 0.15, n)
    model = situation.model(np.stack([np.full(n, 1.5), lengths], -1))
    run = simulate(model, rng.uniform(-2, 2, (n, 200)), rng.uniform(-3, 3, n), rng.uniform(-1, 1, n))
    records = [Record(run.t, *row) for row in zip(run.u, run.theta, run.theta_dot, strict=True)]
    mean, sd = Dropo().distribution(situation, records)
    assert mean[1] == pytest.approx(1.2, abs=0.1)
    assert 0.5 * np.std(lengths) < sd[1] < 2.0 * np.std(lengths)


@pytest.mark.long
def test_bayesian_optimization_finds_the_optimum_of_a_known_function():
    pytest.importorskip("botorch")
    from study.strategies.candidates import improving, most_promising, scattered

    top = np.array([0.7, 0.3, 0.4])

    def worth(x):
        return -350.0 - 900.0 * np.sum((x - top) ** 2, axis=-1)

    x = scattered(4, 3, seed=2)
    y = worth(x)
    assert np.array_equal(*(improving(x, y, seed=2) for _ in range(2)))
    for _ in range(12):
        proposed = improving(x, y, seed=2)
        x, y = np.vstack([x, proposed]), np.append(y, worth(proposed))
    best = most_promising(x, y, seed=2)
    assert worth(best) > -355.0
    assert np.max(y) > -360.0


def test_the_elite_of_the_cross_entropy_method_moves_to_the_better_half_and_narrows():
    rng, strategy = np.random.default_rng(0), CrossEntropy(candidates=40, elite=10)
    mean, sd = np.full(3, 0.4), np.full(3, 0.25)
    top = np.array([0.7, 0.6, 0.5])
    for _ in range(8):
        x = strategy.generation(mean, sd, rng)
        returns = -np.sum((x - top) ** 2, axis=1)
        mean, sd = strategy.refitted(x, returns)
        assert -np.sum((mean - top) ** 2) > np.median(returns)
    assert mean == pytest.approx(top, abs=0.05) and np.all(sd < 0.1)


@pytest.mark.long
def test_a_mixture_density_network_learns_a_posterior_that_is_known():
    """y ~ U(0, 1), x = y + 0.1 z: amid the range the posterior is N(x, 0.1^2)."""
    rng = np.random.default_rng(4)
    y = rng.random((4000, 2))
    network = DensityNetwork(components=3, width=32, epochs=600)
    network.fit(y + 0.1 * rng.standard_normal(y.shape), y, rng)
    for x in (np.array([0.4, 0.6]), np.array([0.55, 0.5])):
        drawn = network.sample(x, 4000, rng)
        assert np.mean(drawn, axis=0) == pytest.approx(x, abs=0.03)
        assert np.std(drawn, axis=0) == pytest.approx([0.1, 0.1], rel=0.25)
        assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.3


@pytest.mark.long
def test_the_posterior_of_bayes_sim_narrows_with_rollouts_about_the_truth():
    widths = {1: [], 25: []}
    for n, seed in ((1, 1), (1, 2), (1, 3), (25, 1)):  # a network may end with a stray component, by rounding alone
        situation = new_situation(n, seed=seed)
        records = BudgetedPlant(ELSEWHERE, "encoder", n, seed=8).play(Play(n))
        drawn = BayesSim(epochs=500).posterior(situation, records)
        assert np.all((drawn >= 0.3) & (drawn <= 3.0))
        off = np.abs(np.mean(drawn, axis=0) - [1.5, 1.2]) / np.std(drawn, axis=0)
        assert np.all(off < 3.0), (n, off)
        widths[n].append(np.std(drawn, axis=0))
    one, many = (np.median(widths[n], axis=0) for n in (1, 25))
    assert many[0] < 0.7 * one[0]  # the mass; one rollout tells the length already
    assert one[1] < 0.05


def test_designed_torques_leave_narrower_intervals_than_random_ones():
    model, sensor = ELSEWHERE, SENSORS["encoder"]
    plant, rng = BudgetedPlant(model, "encoder", 40, seed=4), np.random.default_rng(1)
    rough = fit(PRIOR, plant.play(Play(1)), sensor, ("m", "l"))
    situation = Situation(PRIOR, sensor, 4, 4, rng)
    torques = designed_torques(rough, situation, 3, 10.0)
    assert torques.shape == (3, 200) and np.max(np.abs(torques)) <= PRIOR.u_max
    designed = fit(PRIOR, plant.play(Play(3, torques, at_rest=True)), sensor, ("m", "l"))
    plain = fit(PRIOR, plant.play(Play(3, at_rest=True)), sensor, ("m", "l"))
    assert all(designed.sd[name] < plain.sd[name] for name in ("m", "l"))


def test_smoothed_states_are_as_far_off_as_their_covariance_says():
    sensor, rng = SENSORS["encoder"], np.random.default_rng(2)
    u = rng.uniform(-2.0, 2.0, (40, 200))
    run = simulate(hidden_machine(substeps=2), u, rng.uniform(-3, 3, 40), rng.uniform(-1, 1, 40))
    read = [smoothed(record, sensor) for record in sensor.measure(run, rng)]
    C = smoothing_covariance(sensor, 0.05)
    for channel, truth in ((0, run.theta), (1, run.theta_dot)):
        off = (np.array([states[channel] for states in read]) - truth)[:, 10:-10]
        off -= 2.0 * math.pi * np.round(np.median(off, axis=1, keepdims=True) / (2.0 * math.pi))
        assert np.std(off) == pytest.approx(math.sqrt(C[channel, channel]), rel=0.3)


def test_a_summary_tells_the_gain_of_a_torque():
    """theta_dot' - theta_dot = g u: the product with the torque is g E[u^2]."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-2.0, 2.0, (3, 5000))
    gain = np.array([0.1, 0.2, 0.4])[:, None]
    speed = np.concatenate([np.zeros((3, 1)), np.cumsum(gain * u, axis=1)], axis=1)
    assert summary_statistics(u, speed)[:, 2] == pytest.approx(gain[:, 0] * 4.0 / 3.0, rel=0.05)


def test_the_steps_that_adaptation_is_taught_lead_to_the_target_from_everywhere():
    """Where a policy loses the square of its distance from the target."""
    grid = Levels(np.array([[0.3, 3.0], [1.0, 5.0]]), 5)
    distance = np.sum((grid.unit[:, None] - grid.unit) ** 2, axis=-1)
    worth = grid.worth_of_steps(-1.0 - distance, discount=0.9)
    for target in (0, 12, 24):
        unit = grid.unit.copy()
        for _ in range(4):
            place = np.rint(unit * 4.0).astype(int) @ (5, 1)
            unit = grid.stepped(unit, grid.steps[np.argmax(worth[place, target], axis=-1)])
        assert unit == pytest.approx(np.broadcast_to(grid.unit[target], unit.shape))


@pytest.mark.long
def test_adaptation_leads_to_policies_that_do_well_on_machines_it_has_not_seen():
    situation, strategy = new_situation(), AdaptSim(levels=5, episodes=4)
    adaptation = strategy.taught(situation, whole=True)
    rng, lost = np.random.default_rng(2), []
    for truth in ((1.5, 1.2), (2.0, 1.5), (2.5, 2.2), (1.2, 2.0)):
        target = paper_model(*truth)
        starts = task.draw_start_states([rng] * 20)

        def returned(values, target=target, starts=starts):
            return evaluate(solve(paper_model(*values), META_TRAINING_GRID), target, *starts).mean

        values = situation.believed
        before = returned(values)
        for _ in range(4):
            run = rollout(solve(paper_model(*values), META_TRAINING_GRID), target, *starts[:, :5])
            readings = sensed(run.theta.T, run.theta_dot.T, situation.sensor, True, rng)
            values = adaptation.moved(statistics(situation, run.u[:-1].T, *readings), values)
        best = returned(truth)
        lost.append([(best - own_return) / abs(best) for own_return in (before, returned(values))])
    before, after = np.median(lost, axis=0)
    assert before > 0.3
    assert after < 0.1


def test_the_search_of_auto_tuned_transfer_knows_too_high_from_too_low():
    """Under one policy: the network's odds rise with the candidate, and the search ends near the plant's parameters."""
    situation, strategy = new_situation(), AutoTuned(simulations=600)
    network = strategy.taught(situation, *strategy.episodes(situation, swing, whole=True))
    records = BudgetedPlant(ELSEWHERE, "encoder", 8, seed=3).run(swing, 8, at_rest=False).records
    seen = np.array([statistics(situation, r.u, r.theta, r.theta_dot) for r in records])
    odds = [np.mean(expit(network.answers(seen, np.full(2, x))), axis=0) for x in (0.05, 0.35, 0.95)]
    assert np.all(np.diff(odds, axis=0) > 0.0)
    assert np.all(odds[0] < 0.2) and np.all(odds[2] > 0.8)
    parameters = strategy.searched(network, seen, situation.believed, situation.bounds)
    assert parameters[1] == pytest.approx(1.2, abs=0.1)
    assert abs(parameters[0] - 1.5) < 0.5
