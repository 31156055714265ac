"""The pendulums are a proper TorchRL environment."""

import numpy as np
import torch
from torchrl.envs.utils import check_env_specs

from policies.environments.randomization import Band, PriorRange
from policies.environments.torchrl_env import TorchRLPendulums
from study.paper.protocol import paper_model
from sysid import AngleOffset, Backlash, Delay, Model, RodPendulum, SensorDelay

BANDS = [Band({"m": 2.0, "l": 1.5}, 0.2), Band({"m": 1.0, "l": 1.0}, 0.0), PriorRange()]
SENSING = (Backlash(width=0.1), SensorDelay(T=0.06), AngleOffset(offset=0.05))


def make(**options):
    return TorchRLPendulums(paper_model(), BANDS, (4, 5, 6), **options)


def actions(steps, agents, seed=0):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.uniform(-1.0, 1.0, (steps, agents, 1)).astype(np.float32))


def test_torchrl_accepts_it():
    check_env_specs(make())
    check_env_specs(TorchRLPendulums(Model(RodPendulum(), SENSING, u_max=2.0), BANDS, (4, 5, 6), history=2))


def test_a_time_limit_truncates_and_never_terminates():
    env = make(horizon=7)
    out = env.rollout(20, lambda td: td.set("action", env.action_spec.rand()), break_when_any_done=False)
    ends = torch.arange(1, 21) % 7 == 0
    for name in ("truncated", "done"):
        assert (out["next", name][..., 0] == ends).all()
    assert not out["next", "terminated"].any()


def test_a_partial_reset_leaves_the_other_agents_alone():
    env = TorchRLPendulums(Model(RodPendulum(), (Delay(T=0.07), *SENSING), u_max=2.0), BANDS, (4, 5, 6), history=2)
    td = env.reset()
    for action in actions(3, 3):
        td = env.step(td.set("action", action))["next"]
    before, episodes = [kept.clone() for kept in env.pendulums._kept], list(env.pendulums.episodes)
    env.reset(td.set("_reset", torch.tensor([[False], [True], [False]])))
    changed = torch.stack([kept != was for kept, was in zip(env.pendulums._kept, before, strict=True)])
    assert changed[0].tolist() == [False, True, False] and not changed[:, [0, 2]].any()
    assert env.pendulums.steps.tolist() == [3, 0, 3]
    assert env.pendulums.episodes == [episodes[0], episodes[1] + 1, episodes[2]]


def test_setting_the_seed_repeats_the_rollout():
    env = make()
    rewards = []
    for _ in range(2):
        env.set_seed(11)
        td = env.reset()
        rewards.append(torch.stack([env.step(td.set("action", a))["next", "reward"] for a in actions(5, 3)]))
    assert torch.equal(*rewards)
