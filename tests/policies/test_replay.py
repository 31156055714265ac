"""Each agent's memory keeps its latest transitions and hands them out evenly."""

import torch

from policies.training.replay import Replay


def filled(agents=2, capacity=4, steps=6):
    replay = Replay(agents, capacity, observation_size=2, action_size=1)
    for k in range(steps):
        mark = torch.tensor([float(k + 100 * a) for a in range(agents)])
        replay.add(
            torch.stack((mark, -mark), 1), mark.unsqueeze(1), mark, torch.stack((mark + 1, -mark), 1), mark % 2 == 0
        )
    return replay


def test_the_oldest_gives_way_and_agents_stay_apart():
    replay = filled()
    everything = replay.sample(torch.arange(4, dtype=torch.float64).expand(2, 4) / 4.0)
    for a in range(2):
        kept = [k + 100.0 * a for k in (2, 3, 4, 5)]
        assert sorted(everything.reward[a].tolist()) == kept
    torch.testing.assert_close(everything.next_observation[..., 0], everything.reward + 1.0)
    torch.testing.assert_close(everything.observation[..., 1], -everything.reward)
    torch.testing.assert_close(everything.action[..., 0], everything.reward)
    assert (everything.terminated == (everything.reward % 2 == 0)).all()


def test_only_what_is_there_is_drawn_and_evenly():
    replay = filled(capacity=100, steps=5)
    uniform = torch.rand(2, 5000, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    uniform[:, 0] = 1.0 - 2.0**-53
    rewards = replay.sample(uniform).reward[0]
    assert torch.bincount(rewards.long()).shape == (5,)
    assert (torch.bincount(rewards.long()) / 5000.0 - 0.2).abs().max() < 0.03


def test_a_snapshot_holds_all_of_it():
    replay, other = filled(), Replay(2, 4, 2, 1)
    other.restore(replay.snapshot())
    assert int(other.added) == int(replay.added) == 6 and torch.equal(other.rows, replay.rows)
