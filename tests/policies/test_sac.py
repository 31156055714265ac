"""The population's SAC is plain SAC, for every agent by itself."""

import copy

import numpy as np
import pytest
import torch
from torch import nn

from policies.training.cpu_settings import tune_cpu
from policies.training.replay import Batch
from policies.training.sac import SAC, SACSettings
from policies.training.torchrl_reference import TorchRLReference, in_order
from sysid import InvalidInput

SMALL = SACSettings(hidden=(16, 16), batch=8)


def data(agents, batch, seed=0, observation_size=3, action_size=1):
    """A batch and the two noises, agent a's numbers from seed + a alone."""
    drawn = []
    for a in range(agents):
        rng = np.random.default_rng(seed + a)
        drawn.append(
            (
                rng.standard_normal((batch, observation_size)),
                rng.uniform(-1.0, 1.0, (batch, action_size)),
                rng.standard_normal(batch) - 3.0,
                rng.standard_normal((batch, observation_size)),
                rng.random(batch) < 0.3,
                rng.standard_normal((batch, action_size)),
                rng.standard_normal((batch, action_size)),
            )
        )
    stacked = [np.stack(column) for column in zip(*drawn, strict=True)]
    *fields, noise, next_noise = [torch.from_numpy(c if c.dtype == bool else c.astype(np.float32)) for c in stacked]
    return Batch(*fields), noise, next_noise


def set_temperatures(sac, values):
    sac.log_alpha.copy_(torch.tensor(values).log().reshape(-1, 1))


def gradients(sac):
    """Of the critics (2, A, ...), and of actor and temperature (A, ...)."""
    critics = in_order(sac.critic_gradients, sac.agents)
    return critics, [*in_order(sac.actor_gradients, sac.agents), sac.actor_gradients.extra]


class PlainSAC:
    """One agent's SAC in the words of the papers, with ordinary layers: what the population must agree with."""

    def __init__(self, sac, a):
        def network(stack, index):
            modules = []
            for w, b in stack.weights:
                linear = nn.Linear(*w[index].shape)
                linear.weight.data, linear.bias.data = w[index].T.clone(), b[index][0].clone()
                modules += [linear, nn.ReLU()]
            return nn.Sequential(*modules[:-1])

        self.settings = sac.settings
        self.actor = network(sac.actor, a)
        self.critics = nn.ModuleList([network(sac.critics, 2 * a + i) for i in range(2)])
        self.targets = copy.deepcopy(self.critics)
        self.log_alpha = sac.log_alpha[a].clone().requires_grad_()
        self.critic_optimizer = torch.optim.Adam(self.critics.parameters(), lr=sac.settings.learning_rate)
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), lr=sac.settings.learning_rate)
        self.alpha_optimizer = torch.optim.Adam([self.log_alpha], lr=sac.settings.learning_rate)

    def pi(self, observation, noise):
        loc, log_std = self.actor(observation).chunk(2, -1)
        normal = torch.distributions.Normal(loc, log_std.clamp(-20.0, 2.0).exp())
        x = loc + normal.scale * noise
        action = torch.tanh(x)
        return action, (normal.log_prob(x) - torch.log(1.0 - action**2 + 1e-12)).sum(-1)

    @staticmethod
    def q(critics, observation, action):
        return torch.stack([critic(torch.cat((observation, action), -1)).squeeze(-1) for critic in critics])

    def update(self, batch, noise, next_noise):
        s, alpha = self.settings, self.log_alpha.detach().exp()
        with torch.no_grad():
            action, log_prob = self.pi(batch.next_observation, next_noise)
            value = self.q(self.targets, batch.next_observation, action).min(0).values - alpha * log_prob
            y = batch.reward + s.gamma * (~batch.terminated).float() * value
        q = self.q(self.critics, batch.observation, batch.action)
        self.step(self.critic_optimizer, 0.5 * sum(nn.functional.mse_loss(qi, y) for qi in q))
        self.critic_gradients = [[p.grad.clone() for p in critic.parameters()] for critic in self.critics]
        action, log_prob = self.pi(batch.observation, noise)
        q = self.q(self.critics, batch.observation, action).min(0).values
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


def test_updates_are_those_of_plain_sac():
    sac = SAC((3, 4, 5), SACSettings(hidden=(16, 16), batch=8, gamma=0.9, polyak=0.3))
    set_temperatures(sac, [1.0, 0.3, 0.05])
    plain = [PlainSAC(sac, a) for a in range(3)]
    close = {"rtol": 1e-4, "atol": 2e-5}
    for k in range(5):
        batch, noise, next_noise = data(3, 8, seed=10 * k)
        sac.update(batch, noise, next_noise)
        for a, one in enumerate(plain):
            one.update(Batch(*(field[a] for field in batch)), noise[a], next_noise[a])
            pairs = [((w[a], b[a]), linear) for (w, b), linear in zip(sac.actor.weights, one.actor[::2], strict=True)]
            for i in range(2):
                for stack, networks in ((sac.critics, one.critics), (sac.targets, one.targets)):
                    own = [(w[2 * a + i], b[2 * a + i]) for w, b in stack.weights]
                    pairs += list(zip(own, networks[i][::2], strict=True))
                ours = [leaf[2 * a + i] for layer in sac.critic_gradients.weights for leaf in layer]
                for leaf, theirs in zip(ours, one.critic_gradients[i], strict=True):
                    torch.testing.assert_close(leaf.T.squeeze(-1), theirs.reshape(leaf.T.squeeze(-1).shape), **close)
            for (w, b), linear in pairs:
                torch.testing.assert_close(w, linear.weight.T, **close)
                torch.testing.assert_close(b[0], linear.bias, **close)
            torch.testing.assert_close(sac.log_alpha[a], one.log_alpha, **close)


@pytest.fixture(params=["as it is", "tuned"])
def process(request):
    """Products as torch does them by itself, and as they are done where agents train."""
    threads, settings = torch.get_num_threads(), torch.backends.mkldnn.matmul
    before = settings.fp32_precision
    if request.param == "tuned":
        tune_cpu(threads=threads)
    yield request.param
    settings.fp32_precision = before


@pytest.mark.parametrize(("hidden", "actions"), [((64, 64), 1), ((256, 256), 1), ((32,), 2), ((16, 24, 8), 3)])
def test_gradients_are_those_of_sacloss(hidden, actions, process):
    """To 1e-5 of the largest, through several steps; also where log_std is beyond its bounds."""
    sac = SAC((3, 4, 5), SACSettings(hidden=hidden, batch=32, polyak=0.1), action_size=actions)
    set_temperatures(sac, [1.0, 0.3, 0.05])
    sac.actor.weights[-1][1][1, 0, actions:] += 2.0
    definition = TorchRLReference(sac)
    for k in range(4):
        numbers = data(3, 32, seed=10 * k, action_size=actions)
        sac.update(*numbers)
        definition.update(*numbers)
        assert (sac.critic_gradients.flat != 0.0).any() and (sac.actor_gradients.flat != 0.0).any()
        critics, actor = gradients(sac)
        defined = [leaf.grad for layer in definition.critics for leaf in layer]
        defined_actor = [leaf.grad for layer in definition.actor for leaf in layer] + [definition.loss.log_alpha.grad]
        for ours, theirs in zip(critics + actor, defined + defined_actor, strict=True):
            torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-5 * float(theirs.abs().max()))
    for stack, layers in ((sac.critics, definition.critics), (sac.targets, definition.targets)):
        for ours, theirs in zip(in_order(stack, 3), [leaf for layer in layers for leaf in layer], strict=True):
            torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("agents", [2, 8])
def test_gradients_together_and_alone_agree(agents):
    """Also where the number of agents equals the batch size, which a wrong broadcast of alpha would not notice."""
    temperatures = np.linspace(0.1, 2.0, agents).tolist()
    together = SAC(range(agents), SMALL)
    set_temperatures(together, temperatures)
    batch, noise, next_noise = data(agents, 8)
    together.update(batch, noise, next_noise)
    for a in range(agents):
        alone = SAC([a], SMALL)
        set_temperatures(alone, temperatures[a : a + 1])
        alone.update(*data(1, 8, seed=a))
        for ours, theirs in zip(gradients(together)[0], gradients(alone)[0], strict=True):
            torch.testing.assert_close(ours[:, a], theirs[:, 0], rtol=1e-5, atol=1e-5)
        for ours, theirs in zip(gradients(together)[1], gradients(alone)[1], strict=True):
            torch.testing.assert_close(ours[a], theirs[0], rtol=1e-5, atol=1e-5)


def test_the_pass_over_both_critics_is_sacloss_own_loop():
    definition, (batch, noise, next_noise) = TorchRLReference(SAC((0, 1, 2), SMALL)), data(3, 8)
    fast, _ = definition.loss.qvalue_v2_loss(definition._tensordict(batch, noise, next_noise))
    definition.loss._make_vmap()
    own, _ = definition.loss.qvalue_v2_loss(definition._tensordict(batch, noise, next_noise))
    torch.testing.assert_close(fast, own)


def test_an_actor_follows_its_own_critic_and_always_the_latest():
    def actor_gradients(change):
        sac = SAC((0, 1), SMALL)
        sac.update(*data(2, 8))
        for w, _ in sac.critics.weights:
            w[2:] *= change
        sac.update(*data(2, 8))
        return gradients(sac)[1][:-1]

    for before, after in zip(actor_gradients(1.0), actor_gradients(-2.0), strict=True):
        assert torch.equal(before[0], after[0])
        assert not torch.allclose(before[1], after[1])


def test_an_update_leaves_its_input_alone():
    batch, noise, next_noise = data(2, 8)
    kept = copy.deepcopy((batch, noise, next_noise))
    SAC((0, 1), SMALL).update(batch, noise, next_noise)
    for ours, theirs in zip((*batch, noise, next_noise), (*kept[0], *kept[1:]), strict=True):
        assert torch.equal(ours, theirs)


def test_learning_uses_no_global_randomness():
    torch.manual_seed(5)
    state = torch.get_rng_state()
    sac = SAC((0, 1), SMALL)
    sac.update(*data(2, 8))
    assert torch.equal(state, torch.get_rng_state())


def test_initial_networks_come_from_the_own_seed():
    together, alone = SAC((7, 8), SMALL), SAC((8,), SMALL)
    for ours, theirs in zip(in_order(together.actor, 2), in_order(alone.actor, 1), strict=True):
        assert torch.equal(ours[1], theirs[0])
    for ours, theirs in zip(in_order(together.critics, 2), in_order(alone.critics, 1), strict=True):
        assert torch.equal(ours[:, 1], theirs[:, 0])
    w = together.critics.weights[0][0]
    assert not torch.equal(w[0], w[1]) and not torch.equal(w[0], w[2])


def probe(settings, reward, terminated, steps):
    """Train two agents on one observation; `reward` of the action (A, B, 1), actions uniform."""
    sac, rng = SAC((0, 1), settings, observation_size=1, action_size=1), torch.Generator().manual_seed(0)
    seen = torch.zeros(2, settings.batch, 1)
    for _ in range(steps):
        action = 2.0 * torch.rand(seen.shape, generator=rng) - 1.0
        noise, next_noise = torch.randn((2, *seen.shape), generator=rng)
        ended = torch.full(seen.shape[:2], terminated)
        sac.update(Batch(seen, action, reward(action).squeeze(-1), seen, ended), noise, next_noise)
    return sac


COLD = SACSettings(hidden=(64,), batch=64, gamma=0.5, polyak=0.2, learning_rate=3e-3, initial_temperature=1e-6)


def q_values(sac, action):
    x = torch.tensor([[0.0, action]]).expand(4, 1, 2)
    (w0, b0), (w1, b1) = sac.critics.weights
    return (torch.relu(x @ w0 + b0) @ w1 + b1).flatten().tolist()


def test_probe_of_one_terminal_step_is_worth_its_reward():
    sac = probe(COLD, lambda action: torch.full_like(action, -1.0), terminated=True, steps=400)
    assert q_values(sac, 0.2) == pytest.approx([-1.0] * 4, abs=0.05)


def test_probe_of_an_endless_reward_is_worth_the_discounted_sum():
    sac = probe(COLD, torch.ones_like, terminated=False, steps=400)
    assert q_values(sac, -0.4) == pytest.approx([1.0 / (1.0 - 0.5)] * 4, abs=0.05)


def test_probe_with_one_best_action_finds_it():
    sac = probe(COLD, lambda action: -((action - 0.5) ** 2), terminated=True, steps=700)
    best = sac.act(torch.zeros(2, 1), torch.zeros(2, 1)).flatten()
    assert best.tolist() == pytest.approx([0.5, 0.5], abs=0.15)


def test_temperature_falls_while_the_policy_is_more_random_than_wanted_and_rises_otherwise():
    for target, direction in ((-3.0, -1.0), (1.0, 1.0)):
        sac = SAC((0, 1), SACSettings(hidden=(16, 16), batch=64, target_entropy=target))
        sac.update(*data(2, 64))
        moved = sac.log_alpha.flatten()
        assert moved.tolist() == pytest.approx([direction * 1e-3] * 2, rel=1e-3)


@pytest.mark.parametrize(
    ("name", "value"),
    [("hidden", ()), ("batch", 1), ("learning_rate", 0.0), ("gamma", 1.5), ("polyak", -0.1), ("steps", 0)],
)
def test_settings_that_mean_nothing_are_refused(name, value):
    with pytest.raises(InvalidInput, match=name):
        SACSettings(**{name: value})
