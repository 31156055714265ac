"""The last transitions of A agents, each with its own memory; a batch is one gather over all of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor


class Batch(NamedTuple):
    """Transitions: observation, next_observation (A, B, O), action (A, B, D), reward and terminated (A, B)."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor


class Replay:
    """A ring of `capacity` transitions an agent: float32 rows [observation, action, reward, next, terminated]."""

    def __init__(
        self, agents: int, capacity: int, observation_size: int, action_size: int, device: str = "cpu"
    ) -> None:
        self.agents, self.capacity = agents, capacity
        self.widths = (observation_size, action_size, 1, observation_size, 1)
        self.rows = torch.zeros(agents, capacity, sum(self.widths), device=device)
        self._first = (torch.arange(agents, device=device) * capacity).unsqueeze(1)
        self.added = 0

    @property
    def size(self) -> int:
        """Transitions an agent holds."""
        return min(self.added, self.capacity)

    def add(
        self, observation: Tensor, action: Tensor, reward: Tensor, next_observation: Tensor, terminated: Tensor
    ) -> None:
        """Keep one transition of every agent: (A, O), (A, D), (A,), (A, O), (A,); the oldest gives way."""
        columns = (observation, action, reward.unsqueeze(1), next_observation, terminated.unsqueeze(1))
        torch.cat([c.to(self.rows.dtype) for c in columns], 1, out=self.rows[:, self.added % self.capacity])
        self.added += 1

    def sample(self, uniform: Tensor) -> Batch:
        """The transitions at floor(uniform * size), uniform (A, B) in [0, 1) float64: drawn with replacement."""
        index = (uniform * self.size).long() + self._first
        rows = self.rows.view(-1, self.rows.shape[2])[index]
        observation, action, reward, next_observation, terminated = rows.split(self.widths, -1)
        return Batch(observation, action, reward.squeeze(-1), next_observation, terminated.squeeze(-1) != 0.0)

    def snapshot(self) -> dict[str, Any]:
        """The filled part."""
        return {"rows": self.rows[:, : self.size].clone(), "added": self.added}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot."""
        self.added = snapshot["added"]
        self.rows[:, : self.size] = snapshot["rows"].to(self.rows.device)
