"""The losses of `policies.training.sac` by TorchRL's SACLoss and autograd: what its written-out gradients are held to.

    definition = TorchRLReference(sac)                  # starts from the weights and temperatures of sac
    definition.update(batch, noise, next_noise)   # takes the steps that sac.update takes, from SACLoss

Training uses `policies.training.sac`, which computes the same numbers in two thirds of the time.
"""

from __future__ import annotations

import math
import warnings

import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torchrl.objectives import SACLoss, SoftUpdate, ValueEstimators

from policies.training.networks import Stack
from policies.training.replay import Batch
from policies.training.sac import SAC, SACSettings
from policies.training.torchrl_networks import Layers, both_critics, layers_of, make_actor, make_critic


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


class TorchRLReference:
    """The learners of A agents as SACLoss defines them, from the state of a fresh SAC."""

    def __init__(self, sac: SAC) -> None:
        self.settings, self.agents = sac.settings, sac.agents
        self.loss = make_loss(sac.agents, sac.observation_size, sac.action_size, sac.settings).to(sac.device)
        self.actor = layers_of(self.loss.actor_network_params)
        self.critics = layers_of(self.loss.qvalue_network_params)
        self.targets = layers_of(self.loss.target_qvalue_network_params)
        self._soft_update = SoftUpdate(self.loss, tau=sac.settings.polyak)
        with torch.no_grad():
            self.loss.log_alpha.copy_(sac.log_alpha)
            for ours, theirs in ((self.actor, sac.actor), (self.critics, sac.critics), (self.targets, sac.targets)):
                for leaf, numbers in zip(_leaves(ours), in_order(theirs, sac.agents), strict=True):
                    leaf.copy_(numbers)
        rate = sac.settings.learning_rate
        self.critic_optimizer = torch.optim.Adam(_leaves(self.critics), lr=rate, fused=True)
        self.actor_optimizer = torch.optim.Adam([*_leaves(self.actor), self.loss.log_alpha], lr=rate, fused=True)

    def update(self, batch: Batch, noise: Tensor, next_noise: Tensor) -> None:
        """As `SAC.update`; the gradients stay with the parameters."""
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

        self._soft_update.step()

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


def in_order(stack: Stack, agents: int) -> list[Tensor]:
    """W and b of every layer of a SAC's stack in the order of SACLoss: (A, ...), or (2, A, ...) for critics."""
    leaves = [leaf for layer in stack.weights for leaf in layer]
    if stack.count == agents:
        return leaves
    return [leaf.unflatten(0, (agents, 2)).transpose(0, 1) for leaf in leaves]


def _leaves(layers: Layers) -> list[Tensor]:
    return [leaf for layer in layers for leaf in layer]
