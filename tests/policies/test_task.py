"""The task is Gymnasium's Pendulum-v1, and one definition serves NumPy and torch."""

import math

import gymnasium
import numpy as np
import pytest
import torch

from policies.environments import task
from sysid import State

EXTREMES = [(0.0, 0.0, 0.0), (math.pi, -8.0, 2.0), (-math.pi, 8.0, -2.0), (9.7, 1.0, 0.5), (-31.0, 0.0, -1.5)]


@pytest.mark.parametrize(("theta", "theta_dot", "u"), EXTREMES)
def test_reward_and_observation_are_gymnasiums(theta, theta_dot, u):
    pendulum = gymnasium.make("Pendulum-v1").unwrapped
    pendulum.reset(seed=0)
    pendulum.state = np.array([theta, theta_dot])
    seen = pendulum._get_obs()
    _, reward, *_ = pendulum.step(np.array([u]))
    state = State(theta, theta_dot)
    assert task.reward(state, u) == pytest.approx(reward, rel=1e-12)
    np.testing.assert_array_equal(np.array(task.observation(state), dtype=np.float32), seen)


def test_numpy_and_torch_agree_and_gradients_flow():
    theta, theta_dot, u = np.array(EXTREMES).T
    expected = task.cost(State(theta, theta_dot), u)
    tensors = [torch.tensor(v, requires_grad=True) for v in (theta, theta_dot, u)]
    cost = task.cost(State(*tensors[:2]), tensors[2])
    np.testing.assert_allclose(cost.detach().numpy(), expected, rtol=1e-12)
    cost.sum().backward()
    np.testing.assert_allclose(tensors[1].grad.numpy(), 0.2 * theta_dot, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(tensors[2].grad.numpy(), 0.002 * u, rtol=1e-12, atol=1e-15)


def test_whole_turns_cost_nothing():
    theta = np.linspace(-3.0, 3.0, 7)
    at_rest = np.zeros(7)
    for turns in (-2, 1, 5):
        turned = task.cost(State(theta + 2.0 * math.pi * turns, at_rest), 0.0)
        np.testing.assert_allclose(turned, task.cost(State(theta, at_rest), 0.0), atol=1e-12)


def test_start_states_are_uniform_over_the_stated_box():
    rng = np.random.default_rng(0)
    drawn = task.draw_start_states([rng] * 4000).T / np.array(task.START_HIGH)
    assert np.abs(drawn).max() <= 1.0
    np.testing.assert_allclose(drawn.mean(0), 0.0, atol=4.0 / math.sqrt(3 * 4000))
    np.testing.assert_allclose(drawn.var(0), 1.0 / 3.0, atol=0.02)
