"""The single environment is a proper gymnasium.Env, and with the paper's model it is Gymnasium's Pendulum."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import policies
from policies.environments.gymnasium_env import PendulumEnv, pendulum_v1
from policies.environments.machine import machine_of
from policies.environments.randomization import Band, Fixed, RandomForce, Ranges
from study.paper.protocol import paper_model
from sysid import Delay, InvalidInput, Model, PointMassPendulum, Viscous, load, save


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("randomization", [None, Ranges.of(paper_model(), ("m", "l"))])
def test_gymnasium_accepts_it(randomization):
    env = gymnasium.make(policies.ENV_ID, model=paper_model(), randomization=randomization)
    check_env(env.unwrapped)


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


@pytest.fixture
def file(tmp_path):
    """A model with a delay, of another interval, without a torque limit."""
    save(Model(PointMassPendulum(m=0.5, l=0.4), (Viscous(b=0.1), Delay(T=0.03)), dt=0.02), tmp_path / "model.json")
    return tmp_path / "model.json"


def test_the_file_of_a_model_is_enough_and_an_episode_takes_ten_seconds(file):
    env = gymnasium.make(policies.ENV_ID, model=file, u_max=1.5, history=2, render_mode="rgb_array")
    machine = machine_of(load(file).model, 1.5)
    assert env.unwrapped.model.u_max == 1.5 and env.unwrapped.model.dt == machine.dt == 0.04
    assert env.spec.max_episode_steps == 250
    seen, _ = env.reset(seed=0)
    assert seen.shape == (5,)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(250)]
    assert ends == [(False, False)] * 249 + [(False, True)]
    assert env.render().shape == (200, 200, 3)


def test_what_is_drawn_is_the_rod():
    env = PendulumEnv(render_mode="rgb_array")
    for theta, (row, column) in ((0.0, (40, 100)), (np.pi, (160, 100)), (np.pi / 2.0, (100, 40))):
        env.reset(options={"theta": theta, "theta_dot": 0.0})
        assert env.render()[row, column].tolist() == [178, 34, 34]
        assert (env.render() == 255).all(-1).mean() > 0.9
    assert PendulumEnv().render() is None


def test_gymnasium_finds_it_without_an_import_of_ours(file):
    make = f"gymnasium.make('policies:gapfinder/Pendulum-v0', model={str(file)!r}, u_max=1.0)"
    code = f"import gymnasium; print({make}.spec.id)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == policies.ENV_ID


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({}, "no torque limit"),
        ({"u_max": 1.0, "history": 300}, "history = 300: expected 0 to 250"),
        ({"u_max": 1.0, "dt": 20.0}, "dt = 20.0"),
    ],
)
def test_a_file_that_makes_no_machine_is_refused(file, options, complaint):
    with pytest.raises(InvalidInput, match=complaint):
        gymnasium.make(policies.ENV_ID, model=file, **options)
    with pytest.raises(InvalidInput, match="with the file of a model only"):
        gymnasium.make(policies.ENV_ID, model=pendulum_v1(), u_max=1.0)


def test_stable_baselines3_trains_on_it(file):
    sb3 = pytest.importorskip("stable_baselines3", reason="the extra [bench] is not installed")
    env = gymnasium.make(policies.ENV_ID, model=file, u_max=1.5, history=2)
    agent = sb3.SAC("MlpPolicy", env, learning_starts=20, batch_size=16, policy_kwargs={"net_arch": [8, 8]}, seed=0)
    agent.learn(300)
    action, _ = agent.predict(env.reset(seed=0)[0], deterministic=True)
    assert agent.num_timesteps == 300 and env.action_space.contains(action)
