"""Soft actor-critic for A agents at once, with Stable-Baselines3's conventions and its gradients written out.

Of agent a, with its two critics Q_i, their slow copies Q'_i, its policy pi and its temperature alpha:

    y        = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha log pi(a'|s')),   a' ~ pi(s')
    L_critic = 1/2 sum_i mean (Q_i(s, a) - y)^2
    L_actor  = mean (alpha log pi(a|s) - min_i Q_i(s, a)),   a ~ pi(s)
    L_alpha  = -mean log_alpha (log pi(a|s) + target_entropy)
    Q'      <- Q' + polyak (Q - Q')

    a = tanh x,   x = loc + exp(log_std) noise,   d log pi / dx = 2 a,   d log pi / d log_std = -1 + 2 a (x - loc)

Means run over the B transitions of the agent's own batch. The losses are those of TorchRL's SACLoss, which a test holds
this module to (`torchrl_reference`); no graph is recorded for them, no gradient is computed that no step needs, and
everything that a step fills lies ready in memory.
Sources: Haarnoja et al., "Soft Actor-Critic Algorithms and Applications" (2018); Stable-Baselines3, sac.py.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import softplus
from torch.optim.adam import adam

from policies.environments.random_streams import Purpose, generator
from policies.training.networks import Stack, activations, backward, forward
from policies.training.replay import Batch
from sysid import InvalidInput

LOG_STD_BOUNDS = (-20.0, 2.0)
"""log(std) of the policy is clamped to this (Stable-Baselines3)."""


@dataclass(frozen=True)
class SACSettings:
    """The paper's settings, which are Stable-Baselines3's but for learning_rate; polyak is its tau."""

    hidden: tuple[int, ...] = (256, 256)
    learning_rate: float = 1e-3
    batch: int = 256
    gamma: float = 0.99
    capacity: int = 100_000
    polyak: float = 0.005
    initial_temperature: float = 1.0
    target_entropy: float = -1.0
    random_steps: int = 1000
    steps: int = 75_000

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(self.hidden))
        if not self.hidden or min(self.hidden) < 1:
            raise InvalidInput(f"hidden = {self.hidden}: expected one or more layer sizes >= 1")
        if self.batch < 2:
            raise InvalidInput(f"batch = {self.batch}: expected at least 2 transitions")
        for name in ("learning_rate", "capacity", "initial_temperature", "random_steps", "steps"):
            if not getattr(self, name) > 0:
                raise InvalidInput(f"{name} = {getattr(self, name)}: expected a positive number")
        for name in ("gamma", "polyak"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InvalidInput(f"{name} = {getattr(self, name)}: expected a number in [0, 1]")

    def memory(self, agents: int, observation_size: int) -> float:
        """Bytes that the networks of so many agents take with their optimisers, and their transitions."""
        sizes = (observation_size + 1, *self.hidden, 2)
        weights = 14 * sum(a * b for a, b in pairwise(sizes))  # 4 copies of the actor's, 5 of each critic's
        activations = 8 * self.batch * sum(self.hidden)
        transitions = min(self.capacity, self.steps) * (2 * observation_size + 3)
        return 4.0 * agents * (weights + activations + transitions)


class SAC:
    """The learners of A agents: networks, temperatures, optimisers, and one `update`.

    seeds (A,): agent a's initial weights come from seeds[a] alone. Critic i of agent a is network 2 a + i of
    `critics`; log_alpha (A, 1) is the extra number of `actor`. After an update, `actor_gradients` and
    `critic_gradients` hold the gradients of the losses above, each the agent's own.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        settings: SACSettings,
        observation_size: int = 3,
        action_size: int = 1,
        device: str | torch.device = "cpu",
    ) -> None:
        self.settings, self.agents, self.device = settings, len(seeds), torch.device(device)
        self.observation_size, self.action_size = observation_size, action_size
        self.actor, self.actor_gradients = self._actor(), self._actor()
        self.critics, self.critic_gradients, self.targets = self._critics(), self._critics(), self._critics()
        for a, seed in enumerate(seeds):
            rng = generator(seed, Purpose.WEIGHTS)
            for stack, network in ((self.actor, a), (self.critics, 2 * a), (self.critics, 2 * a + 1)):
                stack.initialise(network, rng)
        self.targets.flat.copy_(self.critics.flat)
        self.log_alpha = self.actor.extra.fill_(math.log(settings.initial_temperature))
        self.actor_optimizer = Adam(self.actor.flat, self.actor_gradients.flat, settings.learning_rate)
        self.critic_optimizer = Adam(self.critics.flat, self.critic_gradients.flat, settings.learning_rate)
        self._make_room()

    def _actor(self) -> Stack:
        sizes = (self.observation_size, *self.settings.hidden, 2 * self.action_size)
        return Stack(self.agents, sizes, self.device, extra=True)

    def _critics(self) -> Stack:
        sizes = (self.observation_size + self.action_size, *self.settings.hidden, 1)
        return Stack(2 * self.agents, sizes, self.device)

    def _make_room(self) -> None:
        """Inputs end with a column of ones; s and s' are [0] and [1] of what the actor sees and answers."""
        agents, batch, hidden, device = self.agents, self.settings.batch, self.settings.hidden, self.device
        inputs, outputs = self.observation_size, self.action_size
        self._seen = torch.ones(2, agents, batch, inputs + 1, device=device)
        self._answered = torch.zeros(2, agents, batch, 2 * outputs, device=device)
        self._judged = torch.ones(agents, 2, batch, inputs + outputs + 1, device=device)
        self._q = torch.zeros(2 * agents, batch, 1, device=device)
        self._actor_slope = torch.zeros(agents, batch, 2 * outputs, device=device)
        self._actor_hidden = activations(agents, batch, hidden, device)
        self._actor_spare = activations(agents, batch, hidden, device)
        self._critic_hidden = activations(2 * agents, batch, hidden, device)
        self._critic_spare = activations(2 * agents, batch, hidden, device)

    @torch.no_grad()
    def act(self, observation: Tensor, noise: Tensor) -> Tensor:
        """Exploring actions (A, D) in [-1, 1] for observations (A, O) and standard normal noise (A, D)."""
        seen = torch.cat((observation, torch.ones_like(observation[:, :1])), 1).unsqueeze(1)
        hidden = activations(self.agents, 1, self.settings.hidden, self.device)
        answered = forward(seen, self.actor.layers, hidden, seen.new_empty(self.agents, 1, 2 * self.action_size))
        loc, log_std = answered.squeeze(1).chunk(2, -1)
        return torch.addcmul(loc, log_std.clamp(*LOG_STD_BOUNDS).exp(), noise).tanh()

    @torch.no_grad()
    def update(self, batch: Batch, noise: Tensor, next_noise: Tensor) -> None:
        """A step of the critics, then of actor and temperature, then of the targets.

        noise and next_noise (A, B, D): standard normal, for the actions drawn from pi(s) and pi(s').
        """
        self._seen[0, ..., :-1], self._seen[1, ..., :-1] = batch.observation, batch.next_observation
        for k in (1, 0):  # s last: its activations stay for the actor's step
            forward(self._seen[k], self.actor.layers, self._actor_hidden, self._answered[k])
        loc, log_std = self._answered.chunk(2, -1)
        within = (log_std >= LOG_STD_BOUNDS[0]) & (log_std <= LOG_STD_BOUNDS[1])
        log_std = log_std.clamp(*LOG_STD_BOUNDS)
        both = torch.stack((noise, next_noise))
        spread = log_std.exp() * both
        x = loc + spread
        action, log_prob = x.tanh(), _log_prob(x, log_std, both)

        self._critic_step(batch, action[1], log_prob[1])
        self._actor_step(batch, action[0], log_prob[0], spread[0], within[0])
        self.targets.flat.lerp_(self.critics.flat, self.settings.polyak)

    def _critic_step(self, batch: Batch, next_action: Tensor, next_log_prob: Tensor) -> None:
        settings = self.settings
        value = self._judge(self.targets, batch.next_observation, next_action).amin(1)
        value = value - self.log_alpha.exp() * next_log_prob
        y = batch.reward + settings.gamma * value.masked_fill(batch.terminated, 0.0)
        q = self._judge(self.critics, batch.observation, batch.action)
        slope = (q - y.unsqueeze(1)).div_(settings.batch).view_as(self._q)
        inputs = self._judged.flatten(0, 1)
        gradients = self.critic_gradients.layers
        backward(inputs, self.critics.layers, self._critic_hidden, slope, self._critic_spare, gradients)
        self.critic_optimizer.step()

    def _actor_step(self, batch: Batch, action: Tensor, log_prob: Tensor, spread: Tensor, within: Tensor) -> None:
        settings, size = self.settings, self.action_size
        q_slope = self._slope_of_least_q(batch.observation, action)
        alpha = (self.log_alpha.exp() / settings.batch).unsqueeze(-1)
        slope = 2.0 * alpha * action + q_slope * (1.0 - action * action)
        self._actor_slope[..., :size] = slope
        self._actor_slope[..., size:] = (slope * spread - alpha) * within
        gradients = self.actor_gradients
        backward(
            self._seen[0], self.actor.layers, self._actor_hidden, self._actor_slope, self._actor_spare, gradients.layers
        )
        gradients.extra.copy_(log_prob.mean(1, keepdim=True).add_(settings.target_entropy).neg_())
        self.actor_optimizer.step()

    def _slope_of_least_q(self, observation: Tensor, action: Tensor) -> Tensor:
        """d/da of -mean_b min_i Q_i(s, a), (A, B, D)."""
        q = self._judge(self.critics, observation, action)
        first = q[:, 0] <= q[:, 1]
        slope = torch.stack((first, ~first), 1).to(q.dtype).div_(-self.settings.batch).view_as(self._q)
        inputs = self._judged.flatten(0, 1)
        slope = backward(inputs, self.critics.layers, self._critic_hidden, slope, self._critic_spare)
        of_action = self.critics.layers[0][0][:, self.observation_size : -1].mT
        return (slope @ of_action).view(self.agents, 2, self.settings.batch, self.action_size).sum(1)

    def _judge(self, critics: Stack, observation: Tensor, action: Tensor) -> Tensor:
        """Q (A, 2, B) of both critics, whose inputs and activations stay."""
        self._judged[..., : self.observation_size] = observation.unsqueeze(1)
        self._judged[..., self.observation_size : -1] = action.unsqueeze(1)
        inputs = self._judged.flatten(0, 1)
        return forward(inputs, critics.layers, self._critic_hidden, self._q).view(self.agents, 2, -1)

    def snapshot(self) -> dict[str, Any]:
        """Networks, temperatures, slow copies and the optimisers' moments."""
        return {
            "actor": self.actor.flat,
            "critics": self.critics.flat,
            "targets": self.targets.flat,
            "actor_optimizer": self.actor_optimizer.snapshot(),
            "critic_optimizer": self.critic_optimizer.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot, in place."""
        for name in ("actor", "critics", "targets"):
            getattr(self, name).flat.copy_(snapshot[name])
        self.actor_optimizer.restore(snapshot["actor_optimizer"])
        self.critic_optimizer.restore(snapshot["critic_optimizer"])


class Adam:
    """Adam (Kingma & Ba 2015) on one tensor and its gradient, by torch's fused kernel."""

    def __init__(self, numbers: Tensor, gradient: Tensor, learning_rate: float) -> None:
        self.numbers, self.gradient, self.learning_rate = numbers, gradient, learning_rate
        self.mean, self.square = torch.zeros_like(numbers), torch.zeros_like(numbers)
        self.steps = torch.zeros((), device=numbers.device)

    def step(self) -> None:
        """One step against the gradient."""
        adam(
            [self.numbers], [self.gradient], [self.mean], [self.square], [], [self.steps],
            fused=True, capturable=self.numbers.is_cuda, amsgrad=False, beta1=0.9, beta2=0.999, lr=self.learning_rate,
            weight_decay=0.0, eps=1e-8, maximize=False,
        )  # fmt: skip

    def snapshot(self) -> dict[str, Tensor]:
        """Both moments and the number of steps."""
        return {"mean": self.mean, "square": self.square, "steps": self.steps}

    def restore(self, snapshot: dict[str, Tensor]) -> None:
        """Go on from a snapshot, in place."""
        for name, numbers in self.snapshot().items():
            numbers.copy_(snapshot[name])


def _log_prob(x: Tensor, log_std: Tensor, noise: Tensor) -> Tensor:
    """log pi of tanh(x), x = loc + exp(log_std) noise, (..., D) -> (...); it never overflows (Haarnoja, appendix C)."""
    log_normal = -0.5 * noise * noise - log_std - 0.5 * math.log(2.0 * math.pi)
    return (log_normal - 2.0 * (math.log(2.0) - x - softplus(-2.0 * x))).sum(-1)
