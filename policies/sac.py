"""Soft actor-critic for A agents at once, through TorchRL's SACLoss, with Stable-Baselines3's conventions.

Of agent a, with its two critics Q_i, their slow copies Q'_i, its policy pi and its temperature alpha:

    y        = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha log pi(a'|s')),   a' ~ pi(s')
    L_critic = 1/2 sum_i mean (Q_i(s, a) - y)^2
    L_actor  = mean (alpha log pi(a|s) - min_i Q_i(s, a)),   a ~ pi(s)
    L_alpha  = -mean log_alpha (log pi(a|s) + target_entropy)
    Q'      <- Q' + polyak (Q - Q')

Means run over the B transitions of the agent's own batch; the agents' losses are summed, so that every gradient is
the agent's own, and Adam, which works element by element, serves them all in one call.
Sources: Haarnoja et al., "Soft Actor-Critic Algorithms and Applications" (2018); Stable-Baselines3, sac.py.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.objectives import SACLoss, SoftUpdate, ValueEstimators

from policies.networks import both_critics, head, layers_of, linear_init, make_actor, make_critic, mlp
from policies.replay import Batch
from policies.streams import Purpose, generator
from sysid import InvalidInput


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


def make_loss(agents: int, observation_size: int, action_size: int, settings: SACSettings) -> SACLoss:
    """TorchRL's SACLoss for data of batch size (A, B), with a temperature an agent.

    Two things make it treat every agent alone. Critics answer with (A, B) instead of (A, B, 1), and log_alpha is
    (A, 1): with the trailing axis, SACLoss multiplies alpha (A, 1) with log_prob (A, B, 1), which broadcasts to a
    wrong shape, and silently to a wrong number where A = B. And no loss is reduced here, so the mean over B can be
    taken before the sum over A.
    """
    with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loss = SACLoss(
            make_actor(agents, observation_size, action_size, settings.hidden),
            make_critic(agents, observation_size, action_size, settings.hidden),
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=settings.initial_temperature,
            target_entropy=settings.target_entropy,
            reduction="none",
            scalar_output_mode="exclude",
            deactivate_vmap=True,
        )
        loss.make_value_estimator(ValueEstimators.TD0, gamma=settings.gamma)
    loss._vmap_qnetworkN0 = both_critics  # a sixth faster than its loop over the critics, which computes the same
    loss.log_alpha = nn.Parameter(torch.full((agents, 1), math.log(settings.initial_temperature)))
    return loss


class SAC:
    """The learners of A agents: networks, temperatures, optimisers, and one `update`.

    seeds (A,): agent a's initial weights come from seeds[a] alone.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        settings: SACSettings,
        observation_size: int = 3,
        action_size: int = 1,
        device: str = "cpu",
    ) -> None:
        self.settings, self.agents, self.device = settings, len(seeds), torch.device(device)
        self.loss = make_loss(self.agents, observation_size, action_size, settings).to(self.device)
        self.actor = layers_of(self.loss.actor_network_params)
        self.critics = layers_of(self.loss.qvalue_network_params)
        self._initialise(seeds)
        self.targets = SoftUpdate(self.loss, tau=settings.polyak)
        self.critic_optimizer = torch.optim.Adam(
            [p for layer in self.critics for p in layer], lr=settings.learning_rate, fused=True
        )
        self.actor_optimizer = torch.optim.Adam(
            [p for layer in self.actor for p in layer] + [self.loss.log_alpha], lr=settings.learning_rate, fused=True
        )

    @torch.no_grad()
    def _initialise(self, seeds: Sequence[int]) -> None:
        for a, seed in enumerate(seeds):
            rng = generator(seed, Purpose.WEIGHTS)
            networks = [[(w[a], b[a]) for w, b in self.actor]]
            networks += [[(w[i, a], b[i, a]) for w, b in self.critics] for i in range(2)]
            for network in networks:
                sizes = [network[0][0].shape[0]] + [w.shape[1] for w, _ in network]
                flat = [leaf for layer in network for leaf in layer]
                for leaf, numbers in zip(flat, linear_init(rng, sizes), strict=True):
                    leaf.copy_(torch.from_numpy(numbers))

    @torch.no_grad()
    def act(self, observation: Tensor, noise: Tensor) -> Tensor:
        """Exploring actions (A, D) in [-1, 1] for observations (A, O) and standard normal noise (A, D)."""
        loc, log_std = head(mlp(observation.unsqueeze(1), self.actor))
        return (loc.squeeze(1) + log_std.squeeze(1).exp() * noise).tanh()

    def update(self, batch: Batch, noise: Tensor, next_noise: Tensor) -> None:
        """A step of the critics, then of actor and temperature, then of the targets.

        noise and next_noise (A, B, D): standard normal, for the actions drawn from pi(s) and pi(s').
        """
        shape = batch.reward.shape
        critic_loss, _ = self.loss.qvalue_v2_loss(self._tensordict(batch, noise, next_noise))
        self.critic_optimizer.zero_grad()
        (0.5 * critic_loss.sum() / shape[1]).backward()
        self.critic_optimizer.step()

        actor_loss, metadata = self.loss.actor_loss(self._tensordict(batch, noise, next_noise))
        alpha_loss = self.loss.alpha_loss(metadata["log_prob"])
        self.actor_optimizer.zero_grad()
        ((actor_loss + alpha_loss).sum() / shape[1]).backward()
        self.actor_optimizer.step()

        self.targets.step()

    def _tensordict(self, batch: Batch, noise: Tensor, next_noise: Tensor) -> TensorDict:
        """A fresh one for every use: SACLoss writes what its networks answer into what it is given."""
        shape = batch.reward.shape
        after = TensorDict(
            {
                "observation": batch.next_observation,
                "noise": next_noise,
                "reward": batch.reward,
                "terminated": batch.terminated,
                "done": batch.terminated,
            },
            batch_size=shape,
        )
        before = {"observation": batch.observation, "action": batch.action, "noise": noise, "next": after}
        return TensorDict(before, batch_size=shape)

    def snapshot(self) -> dict[str, Any]:
        """Networks, temperatures, slow copies and the optimisers' moments."""
        return {
            "loss": dict(self.loss.state_dict()),
            "critic_optimizer": self.critic_optimizer.state_dict(),
            "actor_optimizer": self.actor_optimizer.state_dict(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot, in place: the optimisers and the loss's caches keep pointing at the same tensors."""
        self.loss.load_state_dict(snapshot["loss"])
        self.critic_optimizer.load_state_dict(snapshot["critic_optimizer"])
        self.actor_optimizer.load_state_dict(snapshot["actor_optimizer"])
