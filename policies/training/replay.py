"""Each agent's own memory of transitions, and even draws from it, for all agents at once.

Everything that changes is a tensor on the device, the count of transitions too, so that adding and drawing can be
replayed as parts of a CUDA graph.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor


class Batch(NamedTuple):
    """Transitions of A agents: (A, B, O), (A, B, D), (A, B), (A, B, O), (A, B) bool."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor


class Replay:
    """A ring of `capacity` transitions an agent: float32 rows [observation, action, reward, next, terminated].

    rows (capacity, A, row)
    """

    def __init__(
        self, agents: int, capacity: int, observation_size: int, action_size: int, device: str | torch.device = "cpu"
    ) -> None:
        self.agents, self.capacity = agents, capacity
        self.widths = (observation_size, action_size, 1, observation_size, 1)
        self.rows = torch.zeros(capacity, agents, sum(self.widths), device=device)
        self.added = torch.zeros(1, dtype=torch.long, device=device)
        self._agent = torch.arange(agents, device=device).unsqueeze(1)

    def add(
        self, observation: Tensor, action: Tensor, reward: Tensor, next_observation: Tensor, terminated: Tensor
    ) -> None:
        """Keep one transition of every agent: (A, O), (A, D), (A,), (A, O), (A,); the oldest gives way."""
        columns = (observation, action, reward.unsqueeze(1), next_observation, terminated.unsqueeze(1))
        row = torch.cat([c.to(self.rows.dtype) for c in columns], 1)
        self.rows.index_copy_(0, self.added % self.capacity, row.unsqueeze(0))
        self.added.add_(1)

    def sample(self, uniform: Tensor) -> Batch:
        """The transitions at floor(uniform * size), uniform (A, B) in [0, 1) float64: drawn with replacement."""
        size = self.added.clamp(max=self.capacity)
        index = (uniform * size).long() * self.agents + self._agent
        rows = self.rows.view(-1, self.rows.shape[2]).index_select(0, index.flatten())
        fields = rows.view(*uniform.shape, -1).split(self.widths, -1)
        observation, action, reward, next_observation, terminated = fields
        return Batch(observation, action, reward.squeeze(-1), next_observation, terminated.squeeze(-1) != 0.0)

    def snapshot(self) -> dict[str, Any]:
        """The filled part."""
        added = int(self.added)
        return {"rows": self.rows[: min(added, self.capacity)].clone(), "added": added}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot."""
        self.added.fill_(snapshot["added"])
        self.rows[: len(snapshot["rows"])] = snapshot["rows"].to(self.rows.device)
