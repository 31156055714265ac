"""The pendulums of a population as a TorchRL environment, for other learners."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from policies.environments.batched_pendulums import BatchedPendulums
from policies.environments.randomization import Randomization
from sysid import Model


class TorchRLPendulums(EnvBase):
    """`BatchedPendulums` with TorchRL's interface; batch_size (A,), arguments and errors are the same.

    observation (A, O) float32, action (A, 1) in [-1, 1]. A time limit truncates and never terminates.
    """

    def __init__(
        self,
        model: Model,
        randomizations: Sequence[Randomization],
        seeds: Sequence[int],
        horizon: int | None = None,
        device: str = "cpu",
        history: int = 0,
    ) -> None:
        pendulums = BatchedPendulums(model, randomizations, seeds, horizon, device, history)
        super().__init__(device=pendulums.device, batch_size=torch.Size([pendulums.agents]))
        self.pendulums = pendulums
        self._make_specs()

    def _make_specs(self) -> None:
        shape, device = (self.pendulums.agents, 1), self.device
        seen = (self.pendulums.agents, 3 + self.pendulums.history)
        self.observation_spec = Composite(
            observation=Unbounded(seen, dtype=torch.float32, device=device),
            shape=self.batch_size,
            device=device,
        )
        self.action_spec = Bounded(-1.0, 1.0, shape, dtype=torch.float32, device=device)
        self.reward_spec = Unbounded(shape, dtype=torch.float32, device=device)
        flags = {
            name: Binary(1, shape, dtype=torch.bool, device=device) for name in ("done", "terminated", "truncated")
        }
        self.done_spec = Composite(**flags, shape=self.batch_size, device=device)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        which = tensordict.get("_reset", None) if tensordict is not None else None
        observation = self.pendulums.restart(None if which is None else which.reshape(self.pendulums.agents))
        no = torch.zeros(self.pendulums.agents, 1, dtype=torch.bool, device=self.device)
        flags = {name: no.clone() for name in ("done", "terminated", "truncated")}
        return TensorDict({"observation": observation, **flags}, self.batch_size, device=self.device)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        observation, reward, truncated = self.pendulums.advance(tensordict.get("action"))
        ended = truncated.unsqueeze(1)
        after = {
            "observation": observation,
            "reward": reward.unsqueeze(1),
            "done": ended,
            "truncated": ended.clone(),
            "terminated": torch.zeros_like(ended),
        }
        return TensorDict(after, self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        """Agent a takes seed + a, and starts at its first episode."""
        if seed is not None:
            self.pendulums.seeds = tuple(seed + a for a in range(self.pendulums.agents))
            self.pendulums.forget()
