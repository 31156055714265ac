"""The population's SAC is plain SAC, for every agent by itself."""

import copy

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.objectives import SoftUpdate

from policies.training.networks import layers_of
from policies.training.optimization import FusedAdam
from policies.training.sac import FastSACLoss, SACSettings, StackedSACLoss
from sysid import InvalidInput

SMALL = SACSettings(hidden=(16, 16), batch=8)


def data(agents, batch, seed=0, observation_size=3, action_size=1):
    """A batch with its two noises, agent a's numbers from seed + a alone."""
    drawn = []
    for a in range(agents):
        rng = np.random.default_rng(seed + a)
        seen, acted = (batch, observation_size), (batch, action_size)
        observation, action = rng.standard_normal(seen), rng.uniform(-1.0, 1.0, acted)
        reward, following = rng.standard_normal((batch, 1)) - 3.0, rng.standard_normal(seen)
        terminated, noises = rng.random((batch, 1)) < 0.3, [rng.standard_normal(acted) for _ in range(2)]
        drawn.append((observation, action, reward, following, terminated, *noises))
    stacked = [np.stack(column) for column in zip(*drawn, strict=True)]
    numbers = [torch.from_numpy(c if c.dtype == bool else c.astype(np.float32)) for c in stacked]
    return transitions(*numbers)


def transitions(observation, action, reward, following, terminated, noise, next_noise):
    after = {"observation": following, "reward": reward, "done": terminated, "terminated": terminated}
    after["noise"] = next_noise
    before = {"observation": observation, "action": action, "noise": noise, "next": after}
    return TensorDict(before, observation.shape[:2])


class Learner:
    """A loss with its optimisers and targets, as a population has them."""

    def __init__(self, seeds, settings, observation_size=3, action_size=1, loss=FastSACLoss):
        self.loss = loss(seeds, settings, observation_size, action_size)
        self.critic_optimizer = FusedAdam(self.loss.critic_leaves, settings.learning_rate)
        self.actor_optimizer = FusedAdam([*self.loss.actor_leaves, self.loss.log_alpha], settings.learning_rate)
        self.target_update = SoftUpdate(self.loss, tau=settings.polyak)

    def update(self, batch):
        self.critic_gradients = self.loss.critic_gradients(batch)
        self.critic_optimizer.descend(self.critic_gradients)
        self.actor_optimizer.descend(self.loss.actor_gradients(batch))
        self.target_update.step()


def set_temperatures(sac, values):
    with torch.no_grad():
        sac.loss.log_alpha.copy_(torch.tensor(values).log().reshape(-1, 1))


class PlainSAC:
    """One agent's SAC in the words of the papers, with ordinary layers: what the population must agree with."""

    def __init__(self, sac, a):
        def network(leaves, index):
            modules = []
            for w, b in layers_of(leaf.detach() for leaf in leaves):
                linear = nn.Linear(*w[index].shape)
                linear.weight.data, linear.bias.data = w[index].T.clone(), b[index][0].clone()
                modules += [linear, nn.ReLU()]
            return nn.Sequential(*modules[:-1])

        self.settings = sac.loss.settings
        self.actor = network(sac.loss.actor_leaves, a)
        self.critics = nn.ModuleList([network(sac.loss.critic_leaves, (i, a)) for i in range(2)])
        self.targets = copy.deepcopy(self.critics)
        self.log_alpha = sac.loss.log_alpha[a].detach().clone().requires_grad_()
        self.critic_optimizer = torch.optim.Adam(self.critics.parameters(), lr=self.settings.learning_rate)
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), lr=self.settings.learning_rate)
        self.alpha_optimizer = torch.optim.Adam([self.log_alpha], lr=self.settings.learning_rate)

    def pi(self, observation, noise):
        loc, log_std = self.actor(observation).chunk(2, -1)
        normal = torch.distributions.Normal(loc, log_std.clamp(-20.0, 2.0).exp())
        x = loc + normal.scale * noise
        action = torch.tanh(x)
        return action, (normal.log_prob(x) - torch.log(1.0 - action**2 + 1e-12)).sum(-1)

    @staticmethod
    def q(critics, observation, action):
        return torch.stack([critic(torch.cat((observation, action), -1)).squeeze(-1) for critic in critics])

    def update(self, batch):
        s, after, alpha = self.settings, batch["next"], self.log_alpha.detach().exp()
        with torch.no_grad():
            action, log_prob = self.pi(after["observation"], after["noise"])
            value = self.q(self.targets, after["observation"], action).min(0).values - alpha * log_prob
            y = after["reward"][:, 0] + s.gamma * (~after["terminated"][:, 0]).float() * value
        q = self.q(self.critics, batch["observation"], batch["action"])
        self.step(self.critic_optimizer, 0.5 * sum(nn.functional.mse_loss(qi, y) for qi in q))
        self.critic_gradients = [[p.grad.clone() for p in critic.parameters()] for critic in self.critics]
        action, log_prob = self.pi(batch["observation"], batch["noise"])
        q = self.q(self.critics, batch["observation"], action).min(0).values
        self.step(self.actor_optimizer, (alpha * log_prob - q).mean())
        self.step(self.alpha_optimizer, -(self.log_alpha * (log_prob + s.target_entropy).detach()).mean())
        with torch.no_grad():
            for slow, fast in zip(self.targets.parameters(), self.critics.parameters(), strict=True):
                slow.mul_(1.0 - s.polyak).add_(s.polyak * fast)

    @staticmethod
    def step(optimizer, loss):
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()


@pytest.mark.parametrize("batch_size", [8, 3])
@pytest.mark.parametrize("loss", [FastSACLoss, StackedSACLoss])
def test_updates_are_those_of_plain_sac(loss, batch_size):
    """Also where the batch is as large as the number of agents, which would hide a wrong broadcast of alpha."""
    sac = Learner((3, 4, 5), SACSettings(hidden=(16, 16), batch=batch_size, gamma=0.9, polyak=0.3), loss=loss)
    set_temperatures(sac, [1.0, 0.3, 0.05])
    plain = [PlainSAC(sac, a) for a in range(3)]
    close = {"rtol": 1e-4, "atol": 2e-5}
    for k in range(5):
        batch = data(3, batch_size, seed=10 * k)
        sac.update(batch)
        for a, one in enumerate(plain):
            one.update(batch[a])
            pairs = list(zip(layers_of(leaf[a] for leaf in sac.loss.actor_leaves), one.actor[::2], strict=True))
            for i in range(2):
                for leaves, networks in ((sac.loss.critic_leaves, one.critics), (sac.loss.target_leaves, one.targets)):
                    pairs += zip(layers_of(leaf[i, a] for leaf in leaves), networks[i][::2], strict=True)
                ours = [leaf for layer in layers_of(g[i, a] for g in sac.critic_gradients) for leaf in layer]
                for leaf, theirs in zip(ours, one.critic_gradients[i], strict=True):
                    torch.testing.assert_close(leaf.T.squeeze(-1), theirs.reshape(leaf.T.squeeze(-1).shape), **close)
            for (w, b), linear in pairs:
                torch.testing.assert_close(w, linear.weight.T, **close)
                torch.testing.assert_close(b[0], linear.bias, **close)
            torch.testing.assert_close(sac.loss.log_alpha[a], one.log_alpha, **close)


@pytest.mark.parametrize(("hidden", "actions"), [((64, 64), 1), ((256, 256), 1), ((32,), 2), ((16, 24, 8), 3)])
def test_gradients_are_those_of_sacloss(hidden, actions):
    """To 1e-5 of the largest, through several steps; also where log_std is beyond its bounds."""
    sac = Learner((3, 4, 5), SACSettings(hidden=hidden, batch=32, polyak=0.1), action_size=actions)
    set_temperatures(sac, [1.0, 0.3, 0.05])
    with torch.no_grad():
        sac.loss.actor_leaves[-1][1, 0, actions:] += 2.0
    for k in range(4):
        batch = data(3, 32, seed=10 * k, action_size=actions)
        for name in ("critic_gradients", "actor_gradients"):
            gradients, defined = getattr(sac.loss, name)(batch), getattr(StackedSACLoss, name)(sac.loss, batch)
            for ours, theirs in zip(gradients, defined, strict=True):
                assert (theirs != 0.0).any()
                torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-5 * float(theirs.abs().max()))
        sac.update(batch)


def test_torchrl_calls_it_as_any_of_its_losses():
    """The losses of one call, whose gradients are the loop's: the critics' before they have learned."""
    loss, batch = Learner((0, 1, 2), SMALL).loss, data(3, 8)
    answer = loss(batch.copy())
    assert {"loss_qvalue", "loss_actor", "loss_alpha"} <= set(answer.keys())
    expected = torch.autograd.grad(answer["loss_qvalue"], loss.critic_leaves)
    for ours, theirs in zip(loss.critic_gradients(batch), expected, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_an_update_leaves_its_input_alone():
    batch = data(2, 8)
    kept = batch.clone()
    Learner((0, 1), SMALL).update(batch)
    assert (batch == kept).all()


def test_learning_uses_no_global_randomness():
    torch.manual_seed(5)
    state = torch.get_rng_state()
    sac = Learner((0, 1), SMALL)
    sac.update(data(2, 8))
    assert torch.equal(state, torch.get_rng_state())


def test_initial_networks_come_from_the_own_seed():
    together, alone = Learner((7, 8), SMALL).loss, Learner((8,), SMALL).loss
    for ours, theirs in zip(together.actor_leaves, alone.actor_leaves, strict=True):
        assert torch.equal(ours[1], theirs[0])
    for ours, theirs in zip(together.critic_leaves, alone.critic_leaves, strict=True):
        assert torch.equal(ours[:, 1], theirs[:, 0])
    w = together.critic_leaves[0]
    assert not torch.equal(w[0, 0], w[1, 0]) and not torch.equal(w[0, 0], w[0, 1])
    assert all(map(torch.equal, together.critic_leaves, together.target_leaves))


def probe(settings, reward, terminated, steps):
    """Train two agents on one observation; `reward` of the action (A, B, 1), actions uniform."""
    sac, rng = Learner((0, 1), settings, observation_size=1, action_size=1), torch.Generator().manual_seed(0)
    seen = torch.zeros(2, settings.batch, 1)
    for _ in range(steps):
        action = 2.0 * torch.rand(seen.shape, generator=rng) - 1.0
        noise, next_noise = torch.randn((2, *seen.shape), generator=rng)
        ended = torch.full_like(seen, terminated, dtype=torch.bool)
        sac.update(transitions(seen, action, reward(action), seen, ended, noise, next_noise))
    return sac


COLD = SACSettings(hidden=(64,), batch=64, gamma=0.5, polyak=0.2, learning_rate=3e-3, initial_temperature=1e-6)


def q_values(sac, action):
    x = torch.tensor([[0.0, action]])
    (w0, b0), (w1, b1) = layers_of(sac.loss.critic_leaves)
    return (torch.relu(x @ w0 + b0) @ w1 + b1).flatten().tolist()


@pytest.mark.parametrize(("reward", "terminated", "worth"), [(-1.0, True, -1.0), (1.0, False, 1.0 / (1.0 - 0.5))])
def test_probe_of_one_terminal_step_is_worth_its_reward_and_an_endless_one_the_discounted_sum(
    reward, terminated, worth
):
    sac = probe(COLD, lambda action: torch.full_like(action, reward), terminated, steps=400)
    for action in (0.2, -0.4):
        assert q_values(sac, action) == pytest.approx([worth] * 4, abs=0.05)


def test_probe_with_one_best_action_finds_it():
    sac = probe(COLD, lambda action: -((action - 0.5) ** 2), terminated=True, steps=700)
    nothing = TensorDict({"observation": torch.zeros(2, 1), "noise": torch.zeros(2, 1)}, [2])
    best = sac.loss.act(nothing)["action"].flatten()
    assert best.tolist() == pytest.approx([0.5, 0.5], abs=0.15)


def test_temperature_falls_while_the_policy_is_more_random_than_wanted_and_rises_otherwise():
    for target, direction in ((-3.0, -1.0), (1.0, 1.0)):
        sac = Learner((0, 1), SACSettings(hidden=(16, 16), batch=64, target_entropy=target))
        sac.update(data(2, 64))
        moved = sac.loss.log_alpha.flatten()
        assert moved.tolist() == pytest.approx([direction * 1e-3] * 2, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("hidden", ()),
        ("batch", 1),
        ("learning_rate", 0.0),
        ("gamma", 1.5),
        ("polyak", -0.1),
        ("steps", 0),
    ],
)
def test_settings_that_mean_nothing_are_refused(name, value):
    with pytest.raises(InvalidInput, match=name):
        SACSettings(**{name: value})
