"""Each agent's own memory keeps its latest transitions and hands them out evenly, as a part of TorchRL's buffer."""

import torch
from tensordict import TensorDict

from policies.training.replay import replay_buffer


def transition(k, agents):
    """The k-th of every agent; its numbers say which it is."""
    mark = torch.tensor([[float(k + 100 * a)] for a in range(agents)])
    after = {"observation": torch.cat((mark + 1, -mark), 1), "reward": mark, "done": mark % 2 == 0}
    after["terminated"] = after["done"].clone()
    return TensorDict({"observation": torch.cat((mark, -mark), 1), "action": mark, "next": after}, [agents])


def filled(uniform, agents=2, capacity=4, steps=6):
    replay = replay_buffer(capacity, uniform.shape[1], transition(0, agents), lambda: uniform)
    for k in range(steps):
        replay.extend(transition(k, agents).unsqueeze(0))
    return replay


EACH = torch.arange(4, dtype=torch.float64).expand(2, 4) / 4.0


def test_the_oldest_gives_way_and_agents_stay_apart():
    everything = filled(EACH).sample()
    reward = everything["next", "reward"]
    assert everything.shape == (2, 4) and reward.shape == (2, 4, 1)
    for a in range(2):
        assert sorted(reward[a, :, 0].tolist()) == [k + 100.0 * a for k in (2, 3, 4, 5)]
    torch.testing.assert_close(everything["next", "observation"][..., :1], reward + 1.0)
    torch.testing.assert_close(everything["observation"][..., 1:], -reward)
    torch.testing.assert_close(everything["action"], reward)
    for flag in ("done", "terminated"):
        assert torch.equal(everything["next", flag], reward % 2 == 0)


def test_only_what_is_there_is_drawn_and_evenly():
    uniform = torch.rand(2, 5000, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    uniform[:, 0] = 1.0 - 2.0**-53
    rewards = filled(uniform, capacity=100, steps=5).sample()["next", "reward"][0, :, 0]
    assert torch.bincount(rewards.long()).shape == (5,)
    assert (torch.bincount(rewards.long()) / 5000.0 - 0.2).abs().max() < 0.03


def test_its_state_is_all_of_it_and_no_more_than_what_is_filled():
    replay, other = filled(EACH), filled(EACH, steps=0)
    other.load_state_dict(replay.state_dict())
    assert int(other.storage.count) == int(replay.storage.count) == 6 and len(other) == 4
    assert torch.equal(other.storage.rows, replay.storage.rows)
    assert filled(EACH, capacity=9).state_dict()["_storage"]["rows"].shape[0] == 6
