"""The single environment is a proper gymnasium.Env, and with the paper's model it is Gymnasium's Pendulum."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import policies
from policies.environments.gymnasium_env import PendulumEnv
from policies.environments.randomization import Band, Fixed, PriorRange, RandomForce
from study.paper.protocol import paper_model
from sysid import Delay, InvalidInput, Model, PointMassPendulum, Viscous


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("randomization", [None, PriorRange()])
def test_gymnasium_accepts_it(randomization):
    env = gymnasium.make(policies.ENV_ID, model=paper_model(), randomization=randomization)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize(("m", "l"), [(1.0, 1.0), (2.0, 1.5), (0.3, 3.0)])
def test_it_steps_like_gymnasiums_pendulum(m, l):  # noqa: E741
    ours = gymnasium.make(policies.ENV_ID, model=paper_model(m=m, l=l))
    theirs = gymnasium.make("Pendulum-v1")
    theirs.unwrapped.m, theirs.unwrapped.l = m, l
    actions = np.random.default_rng(0).uniform(-2.5, 2.5, (200, 1)).astype(np.float32)
    ours_seen, _ = ours.reset(seed=5)
    theirs_seen, _ = theirs.reset(seed=5)
    np.testing.assert_array_equal(ours_seen, theirs_seen)
    for k, action in enumerate(actions):
        seen, reward, terminated, truncated, _ = ours.step(action)
        expected = theirs.step(action.astype(np.float64))  # with float32, Gymnasium rounds the torque to float32
        np.testing.assert_allclose(seen, expected[0], rtol=1e-6, atol=1e-7)
        assert reward == pytest.approx(expected[1], rel=1e-9)
        assert (terminated, truncated) == (False, k == 199) == expected[2:4]


def test_randomization_follows_the_seed_and_shows_in_info():
    env = PendulumEnv(paper_model(), Band({"m": 2.0, "l": 1.5}, w=0.3))
    drawn = [env.reset(seed=seed)[1]["parameters"] for seed in (1, 2, 1)]
    assert drawn[0] == drawn[2] != drawn[1]
    assert env.reset()[1]["parameters"] != drawn[2]


def test_any_model_can_be_trained_on_and_the_start_state_can_be_fixed():
    model = Model(PointMassPendulum(m=0.5, l=0.4), (Viscous(b=0.1), Delay(T=0.03)), dt=0.02, u_max=1.0)
    env = PendulumEnv(model)
    seen, _ = env.reset(seed=0, options={"theta": 0.0, "theta_dot": 1.0})
    np.testing.assert_array_equal(seen, np.array([1.0, 0.0, 1.0], dtype=np.float32))
    state = model.initial_state(0.0, 1.0)
    for k in range(5):
        seen, *_ = env.step(np.array([0.5], dtype=np.float32))
        state = model.advance(state, 0.5, k * 0.02)
    assert seen[2] == np.float32(state.theta_dot)


def test_random_torques_are_refused_as_it_does_not_apply_them():
    with pytest.raises(InvalidInput, match="RandomForce"):
        PendulumEnv(randomization=RandomForce(Fixed(), 0.5, 0.1))


def test_a_model_without_torque_limit_is_refused():
    with pytest.raises(InvalidInput, match="u_max"):
        PendulumEnv(Model(PointMassPendulum()))
