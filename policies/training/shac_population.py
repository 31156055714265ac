"""Short-horizon actor-critic as a TorchRL program: a differentiable environment of batch size (A, E), a loss, two
optimisers and a target update, with TensorDicts between them.

    population = SHACPopulation(model, [Band({"m": 2.0, "l": 1.5}, w=0.1)] * 3, seeds=[0, 1, 2])
    population.train(population.settings.steps)
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from policies.environments.random_streams import Purpose
from policies.training.optimization import FusedAdam
from policies.training.population import Population
from policies.training.random_blocks import RandomBlocks
from policies.training.shac import SHACLoss, SHACSettings
from sysid import InvalidInput

LAST_RATE = 0.02
"""Share of the learning rate that is left at the end."""
FORGETTING = 0.95
"""How much of its last mean square an optimiser keeps."""


class SHACPopulation(Population):
    """Agents that learn from the gradient through the model, each with its own pendulums, whose episodes end one after
    another."""

    parts: ClassVar[tuple[str, ...]] = ("env", "loss", "value_optimizer", "actor_optimizer")
    settings_of: ClassVar[type[SHACSettings]] = SHACSettings
    differentiable: ClassVar[bool] = True
    settings: SHACSettings

    def _loss(self, observation_size: int) -> SHACLoss:
        return SHACLoss(self.seeds, self.settings, observation_size)

    def _prepare(self) -> None:
        settings, rate = self.settings, self.settings.learning_rate
        shape = (settings.horizon, settings.environments, 1)
        which = torch.arange(settings.environments, device=self.device)
        self.env.steps.add_(which * self.env.horizon // settings.environments)
        self.value_optimizer = FusedAdam(self.loss.value_leaves, rate, FORGETTING)
        self.actor_optimizer = FusedAdam(self.loss.actor_leaves, rate, FORGETTING)
        self._noise = RandomBlocks(
            self.seeds,
            Purpose.EXPLORATION,
            lambda rng, _: rng.standard_normal(shape, dtype=np.float32),
            self.device,
            settings.horizon,
        )

    def train(self, steps: int) -> None:
        """Advance every agent by `steps` environment steps, or up to a window more, but not beyond settings.steps.

        Raises InvalidInput where the gradient through the model is not finite.
        """
        last = min(self.settings.steps, self.steps_done + steps)
        while self.steps_done < last:
            self._learn()

    def _learn(self) -> None:
        """A window, an update of the policy, some of the value function, and one of its slow copy."""
        self._set_rate()
        window = self._window()
        gradients = self.loss.actor_gradients(window)
        if not all(bool(gradient.isfinite().all()) for gradient in gradients):
            raise InvalidInput(
                f"the gradient through the model is not finite after {self.steps_done} steps: expected a model whose "
                "motion does not run away; sac trains without gradients of the model"
            )
        self.actor_optimizer.descend(gradients)
        taught, parts = self.loss.taught(window), self.settings.minibatches
        for part in range(parts):
            self.value_optimizer.descend(self.loss.value_gradients(taught[:, part::parts]))
        self.target_update.step()
        self.steps_done = min(self.settings.steps, self.steps_done + self.settings.window)
        self._begin_anew(window)

    def _set_rate(self) -> None:
        self.loss.progress = done = self.steps_done / self.settings.steps
        for optimizer in (self.value_optimizer, self.actor_optimizer):
            optimizer.param_groups[0]["lr"] = self.settings.learning_rate * (1.0 - (1.0 - LAST_RATE) * done)

    def _window(self) -> TensorDictBase:
        """Steps (A, E, T) of the pendulums under the policy as it is, from where they are."""
        self.env.detach_state()
        self._noise.load(self.steps_done // self.settings.window)
        seen, moved = self.observation.detach(), []
        for noise in self._noise.all():
            acted = self.loss.act(TensorDict({"observation": seen, "noise": noise}, self.env.batch_size))
            moved.append(self.env.step(acted))
            seen = moved[-1].get(("next", "observation"))
        self.observation = seen
        return torch.stack(moved, 2)

    def _begin_anew(self, window: TensorDictBase) -> None:
        """Where episodes have ended, others begin."""
        self.returns.add_(window.get(("next", "reward")).detach().sum((2, 3)))
        ended = window.get(("next", "done"))[:, :, -1]
        if not bool(ended.any()):
            return
        over = ended.squeeze(-1)
        if bool(over[0, 0]):
            self._curve.append((self.steps_done, self.returns[:, 0].clone()))
        self.returns.masked_fill_(over, 0.0)
        self.observation = self.env.reset(TensorDict({"_reset": ended}, self.env.batch_size)).get("observation")
