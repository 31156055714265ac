"""Soft actor-critic as a TorchRL program: an environment of batch size (A,), a replay buffer, a loss, two optimisers
and a target update, with TensorDicts between them.

    population = SACPopulation(model, [Band({"m": 2.0, "l": 1.5}, w=0.1)] * 3, seeds=[0, 1, 2])
    population.train(75_000)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from policies.environments.random_streams import Purpose
from policies.training.cuda_graph import CudaGraph
from policies.training.networks import ExploringPolicy
from policies.training.optimization import FusedAdam
from policies.training.population import Population
from policies.training.random_blocks import BLOCK_LENGTH, RandomBlocks
from policies.training.replay import replay_buffer
from policies.training.sac import FastSACLoss, SACSettings, StackedSACLoss


class SACPopulation(Population):
    """Soft actor-critic agents, trained together, each with one pendulum and a memory of transitions."""

    parts: ClassVar[tuple[str, ...]] = ("env", "replay", "loss", "critic_optimizer", "actor_optimizer")
    settings_of: ClassVar[type[SACSettings]] = SACSettings
    loss_of: ClassVar[type[StackedSACLoss]] = FastSACLoss
    """The loss: that of TorchRL with its gradients written out."""
    settings: SACSettings

    def _loss(self, observation_size: int) -> StackedSACLoss:
        return self.loss_of(self.seeds, self.settings, observation_size)

    def _prepare(self) -> None:
        settings, loss = self.settings, self.loss
        self._k = torch.zeros(1, dtype=torch.long, device=self.device)
        draws: dict[Purpose, Callable[[np.random.Generator, int], NDArray]] = {
            Purpose.EXPLORATION: _exploration,
            Purpose.REPLAY: lambda rng, n: rng.random((n, settings.batch)),
            Purpose.LOSS: lambda rng, n: rng.standard_normal((n, 2, settings.batch, 1), dtype=np.float32),
        }
        self._blocks = [RandomBlocks(self.seeds, purpose, draw, self.device) for purpose, draw in draws.items()]
        self._exploration, self._uniform, self._normal = self._blocks
        capacity, example = min(settings.capacity, settings.steps), self.env.fake_tensordict()
        self.replay = replay_buffer(capacity, settings.batch, example, lambda: self._uniform.at(self._k))
        self.policy = ExploringPolicy(loss.actor_leaves)
        self.critic_optimizer = FusedAdam(loss.critic_leaves, settings.learning_rate)
        self.actor_optimizer = FusedAdam([*loss.actor_leaves, loss.log_alpha], settings.learning_rate)
        self.resumed()

    def train(self, steps: int) -> None:
        """Advance every agent by `steps` environment steps, but not beyond settings.steps."""
        for _ in range(min(steps, self.settings.steps - self.steps_done)):
            self._step()

    def _step(self) -> None:
        block, k = divmod(self.steps_done, BLOCK_LENGTH)
        if block != self._block:
            self._load(block, k)
        if self.steps_done >= self.settings.random_steps:
            self._learning_step()
        else:
            self._explore()
        self.steps_done += 1
        if self.steps_done % self.env.horizon == 0:
            self._curve.append((self.steps_done, self.returns.clone()))
            self.returns.zero_()
            self.observation.copy_(self.env.reset()["observation"])

    def _load(self, block: int, k: int) -> None:
        """Take up the random numbers of a block, from its step k on."""
        for numbers in self._blocks:
            numbers.load(block)
        self._block = block
        self._k.fill_(k)

    def _explore(self) -> None:
        """A step with uniform actions."""
        self._move(self._seen(action=self._exploration.at(self._k)[:, :1]))
        self._k.add_(1)

    def _learn(self) -> None:
        """A step with the policy's actions and an update. Nothing in it waits for the device or depends on the host."""
        self._move(self.policy(self._seen(noise=self._exploration.at(self._k)[:, 1:])))
        batch = self.replay.sample()
        noise, next_noise = self._normal.at(self._k).unbind(1)
        batch = batch.set("noise", noise).set(("next", "noise"), next_noise)
        self.critic_optimizer.descend(self.loss.critic_gradients(batch))
        self.actor_optimizer.descend(self.loss.actor_gradients(batch))  # of the temperature, too
        self.target_update.step()
        self._k.add_(1)

    def _seen(self, **more: Tensor) -> TensorDict:
        return TensorDict({"observation": self.observation, **more}, self.env.batch_size)

    def _move(self, acted: TensorDictBase) -> None:
        """One step of every pendulum, remembered. A time limit is no terminal state."""
        moved = self.env.step(acted)
        self.replay.extend(moved.unsqueeze(0))
        after = moved.get("next")
        self.observation.copy_(after.get("observation"))
        self.returns.add_(after.get("reward").squeeze(1))

    def resumed(self) -> None:
        """Random numbers are loaded anew, and a step is captured anew."""
        self._block = -1
        self._learning_step = CudaGraph(self._learn, self.device)


def _exploration(rng: np.random.Generator, length: int) -> NDArray[np.float32]:
    """(length, 2): a uniform action in [-1, 1] and the normal noise of the policy's action, for each step."""
    uniform = rng.uniform(-1.0, 1.0, length)
    return np.stack((uniform, rng.standard_normal(length)), 1).astype(np.float32)
