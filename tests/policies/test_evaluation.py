"""Evaluation plays the paper's episodes: its start states, its costs, one policy at a time."""

import math

import gymnasium
import numpy as np
import pytest

from policies.environments import task
from policies.evaluation import Evaluation, evaluate, fresh_start_states, rollout, start_states
from study.paper.protocol import paper_model
from sysid import AngleOffset, Delay, InvalidInput, Model, RodPendulum, VelocityGain


def zero(state, t):
    return 0.0


@pytest.mark.parametrize("seed", [0, 7])
def test_start_states_are_gymnasiums_resets(seed):
    pendulum = gymnasium.make("Pendulum-v1").unwrapped
    theta, theta_dot = start_states(seed, episodes=5)
    for e in range(5):
        pendulum.reset(seed=seed + 50_000 + e)
        assert (theta[e], theta_dot[e]) == tuple(pendulum.state)


def test_fresh_start_states_are_shared_with_no_other_seed_and_have_the_same_bounds():
    papers = {state for seed in range(10) for state in zip(*start_states(seed), strict=True)}
    fresh = [state for seed in range(10) for state in zip(*fresh_start_states(seed), strict=True)]
    assert len(papers) == 29
    assert len({*papers, *fresh}) == 29 + 200
    theta, theta_dot = np.array(fresh).T
    assert 0.9 * math.pi < np.max(np.abs(theta)) <= math.pi
    assert 0.9 < np.max(np.abs(theta_dot)) <= 1.0
    assert np.array_equal(fresh_start_states(3)[0], fresh_start_states(3)[0])


def test_returns_are_gymnasiums_at_other_parameters():
    pendulum = gymnasium.make("Pendulum-v1").unwrapped
    pendulum.m, pendulum.l = 2.0, 1.5
    theta, theta_dot = start_states(3, episodes=4)
    commands = 2.0 * np.sin(np.arange(task.HORIZON) * 0.3)

    def policy(state, t):
        return np.full(state.theta.shape, commands[round(t / 0.05)])

    expected = []
    for e in range(4):
        pendulum.reset(seed=50_003 + e)
        expected.append(sum(pendulum.step(np.array([u]))[1] for u in commands))
    answer = evaluate(policy, paper_model(m=2.0, l=1.5), theta, theta_dot)
    np.testing.assert_allclose(answer.returns, expected, rtol=1e-9)


def test_episodes_do_not_touch_each_other():
    def policy(state, t):
        return -3.0 * state.theta_dot

    theta, theta_dot = start_states(0)
    together = evaluate(policy, paper_model(), theta, theta_dot).returns
    alone = [evaluate(policy, paper_model(), theta[e : e + 1], theta_dot[e : e + 1]).returns[0] for e in range(20)]
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_torque_is_clipped_at_the_limit():
    start = start_states(1)
    ten = evaluate(lambda state, t: 10.0, paper_model(), *start)
    two = evaluate(lambda state, t: 2.0, paper_model(), *start)
    np.testing.assert_array_equal(ten.returns, two.returns)


def test_a_policy_sees_what_the_sensors_show_and_pays_for_the_state():
    seen = []

    def policy(state, t):
        seen.append(state)
        return 0.0

    model = Model(RodPendulum(), dt=0.05, u_max=2.0)
    shown = model.with_effect(AngleOffset(0.1)).with_effect(VelocityGain(2.0))
    start = start_states(2, 3)
    returns = [evaluate(policy, m, *start, horizon=4).returns for m in (model, shown)]
    np.testing.assert_array_equal(*returns)
    for plain, other in zip(seen[:4], seen[4:], strict=True):
        np.testing.assert_allclose(other.theta, plain.theta + 0.1)
        np.testing.assert_allclose(other.theta_dot, 2.0 * plain.theta_dot)


def test_a_policy_with_a_history_is_told_what_was_really_commanded():
    class Remembering:
        history = 2

        def __init__(self):
            self.past_commands = []

        def __call__(self, state, t, past):
            self.past_commands.append(past)
            return np.array([1.0, 10.0 * len(self.past_commands)])

    policy = Remembering()
    evaluate(policy, paper_model(), np.zeros(2), np.zeros(2), horizon=3)
    expected = [[[0, 0], [0, 0]], [[1, 0], [2, 0]], [[1, 1], [2, 2]]]
    np.testing.assert_array_equal(policy.past_commands, expected)


def test_a_rollout_is_the_motion_whose_rewards_the_return_sums():
    class Remembering:
        history = 1

        def __call__(self, state, t, past):
            return -3.0 * state.theta_dot + past[:, 0]

    model = paper_model(m=2.0, l=1.5).with_effect(Delay(T=0.07)).with_effect(AngleOffset(0.1))
    start = start_states(4, 3)
    motion = rollout(Remembering(), model, *start)
    assert len(motion.u) == 200
    np.testing.assert_array_equal([motion.theta[0], motion.theta_dot[0]], start)
    np.testing.assert_allclose(motion.returns, evaluate(Remembering(), model, *start).returns, rtol=1e-12)
    with pytest.raises(InvalidInput, match="NaN"):
        rollout(zero, model, np.array([np.nan]), np.zeros(1))


def test_the_return_is_the_same_integral_whatever_the_interval_between_commands():
    start = start_states(1)
    returns = [
        evaluate(lambda state, t: 1.0 if t < 5.0 else -0.5, Model(RodPendulum(2.0, 1.5), dt=dt, u_max=2.0), *start).mean
        for dt in (0.05, 0.02, 0.01)
    ]
    assert returns[:2] == pytest.approx([returns[2]] * 2, rel=0.02)


def test_the_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(1000):
        low, high = Evaluation(rng.normal(3.0, 2.0, 6)).interval(0.9)
        hits += low < 3.0 < high
    assert hits == pytest.approx(900, abs=30)


def test_statistics():
    answer = Evaluation(np.array([1.0, 2.0, 4.0]))
    assert answer.mean == pytest.approx(7.0 / 3.0)
    assert answer.std == pytest.approx(np.sqrt(14.0 / 9.0))
    assert answer.sem == pytest.approx(answer.std / math.sqrt(2.0))
    assert math.isnan(Evaluation(np.array([1.0])).sem)
    assert "3 episodes" in str(answer)


@pytest.mark.parametrize(
    ("theta", "theta_dot", "policy", "message"),
    [
        ([0.0, 1.0], [0.0], zero, "two vectors of one length"),
        ([], [], zero, "two vectors of one length"),
        ([np.nan], [0.0], zero, "NaN"),
        ([0.0, 1.0], [0.0, 0.0], lambda s, t: np.zeros((2, 1)), r"shape \(2, 1\)"),
        ([0.0], [0.0], lambda s, t: np.array([np.nan]), "not finite"),
    ],
)
def test_bad_input_is_named(theta, theta_dot, policy, message):
    with pytest.raises(InvalidInput, match=message):
        evaluate(policy, paper_model(), np.array(theta), np.array(theta_dot))
