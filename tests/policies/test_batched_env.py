"""The batched environment is a proper TorchRL environment, and each of its pendulums is the single one."""

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from policies.batched_env import BatchedPendulum
from policies.pendulum_env import PendulumEnv
from policies.randomization import Band, PriorRange
from sysid import Delay, InvalidInput, Model, RodPendulum, Viscous, paper_model

BANDS = [Band({"m": 2.0, "l": 1.5}, 0.2), Band({"m": 1.0, "l": 1.0}, 0.0), PriorRange()]


def make(randomizations=BANDS, seeds=(4, 5, 6), **options):
    return BatchedPendulum(paper_model(), randomizations, seeds, **options)


def test_torchrl_accepts_it():
    check_env_specs(make())


def actions(steps, agents, seed=0):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.uniform(-1.0, 1.0, (steps, agents, 1)).astype(np.float32))


@pytest.mark.parametrize("effects", [(), (Viscous(b=0.05), Delay(T=0.07))])
def test_every_agent_is_the_single_pendulum_with_its_own_parameters(effects):
    model = Model(RodPendulum(), effects, dt=0.05, u_max=2.0)
    env = BatchedPendulum(model, BANDS, (4, 5, 6))
    env.restart()
    singles = []
    for a in range(3):
        drawn = {name: float(values[a]) for name, values in env.parameters_now.items()}
        single = PendulumEnv(model.with_parameters(drawn))
        single.reset(options={"theta": float(env.state.theta[a]), "theta_dot": float(env.state.theta_dot[a])})
        singles.append(single)
    for action in actions(50, 3):
        observation, reward, _ = env.advance(action)
        for a, single in enumerate(singles):
            expected, cost, *_ = single.step(2.0 * action[a].numpy())
            np.testing.assert_allclose(observation[a].numpy(), expected, atol=2e-5)
            assert float(reward[a]) == pytest.approx(cost, rel=1e-4, abs=1e-6)


def test_a_time_limit_truncates_and_never_terminates():
    env = make(horizon=7)
    out = env.rollout(20, lambda td: td.set("action", env.action_spec.rand()), break_when_any_done=False)
    ends = torch.arange(1, 21) % 7 == 0
    for name in ("truncated", "done"):
        assert (out["next", name][..., 0] == ends).all()
    assert not out["next", "terminated"].any()


def test_a_new_episode_draws_new_parameters_and_a_new_start():
    env = make([PriorRange()] * 2, (1, 2))
    first = env.restart(), env.snapshot()["parameters"]
    second = env.restart(), env.snapshot()["parameters"]
    assert (first[0] != second[0]).all()
    for name in ("m", "l"):
        assert (first[1][name] != second[1][name]).all()


def test_a_partial_reset_leaves_the_other_agents_alone():
    env = make()
    td = env.reset()
    for action in actions(3, 3):
        td = env.step(td.set("action", action))["next"]
    before, episodes = env.state.theta.clone(), list(env.episodes)
    env.reset(td.set("_reset", torch.tensor([[False], [True], [False]])))
    changed = env.state.theta != before
    assert changed.tolist() == [False, True, False]
    assert env.steps.tolist() == [3, 0, 3]
    assert env.episodes == [episodes[0], episodes[1] + 1, episodes[2]]


def test_draws_depend_on_the_own_seed_only():
    together = make([PriorRange()] * 3, (4, 5, 6))
    alone = make([PriorRange()], (5,))
    for _ in range(3):
        assert torch.equal(together.restart()[1], alone.restart()[0])
        assert together.parameters_now["m"][1] == alone.parameters_now["m"][0]


def test_agents_that_share_a_seed_share_the_start_states_whatever_the_width():
    env = make([Band({"m": 2.0, "l": 1.5}, w) for w in (0.0, 0.5)], (3, 3))
    for _ in range(3):
        observation = env.restart()
        assert torch.equal(observation[0], observation[1])


def test_a_snapshot_goes_on_where_it_was_taken():
    one = make(horizon=5)
    one.restart()
    moves = actions(12, 3)
    for action in moves[:4]:
        one.advance(action)
    other = make(horizon=5)
    other.restore(one.snapshot())
    for action in moves[4:]:
        for ours, theirs in zip(one.advance(action), other.advance(action), strict=True):
            assert torch.equal(ours, theirs)
    assert torch.equal(one.restart(), other.restart())


def test_setting_the_seed_repeats_the_rollout():
    env = make()
    rewards = []
    for _ in range(2):
        env.set_seed(11)
        td = env.reset()
        rewards.append(torch.stack([env.step(td.set("action", a))["next", "reward"] for a in actions(5, 3)]))
    assert torch.equal(*rewards)


def test_bad_input_is_named():
    with pytest.raises(InvalidInput, match="3 randomizations and 1 seeds"):
        make(seeds=(1,))
    with pytest.raises(InvalidInput, match="expected the same"):
        make([Band({"m": 1.0}), Band({"l": 1.0})], (1, 2))
    with pytest.raises(InvalidInput, match="u_max"):
        BatchedPendulum(Model(RodPendulum()), [PriorRange()], [0])
