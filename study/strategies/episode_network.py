"""A network that is asked about episodes and a place among the parameters: what strategies learn from simulations."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from sysid.physics.ops import Array


class EpisodeNetwork:
    """Numbers (N, A) from statistics of episodes (N, F) and a place x (N, P) in the unit cube, by two hidden layers."""

    def __init__(self, width: int, epochs: int) -> None:
        self.width, self.epochs = width, epochs

    def fit(self, seen: Array, x: Array, targets: Array, loss: str, rng: np.random.Generator) -> None:
        """Train on targets (N, A) by a loss of torch.nn.functional, on all data at once."""
        import torch

        self.shift, self.scale = np.mean(seen, axis=0), np.std(seen, axis=0) + 1e-9
        inputs, sizes = self._inputs(seen, x), (seen.shape[1] + x.shape[1], self.width, self.width, targets.shape[1])
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(rng.integers(2**31)))
            layers = [torch.nn.Linear(a, b) for a, b in pairwise(sizes)]
            tanh = torch.nn.Tanh()
            self.network = torch.nn.Sequential(layers[0], tanh, layers[1], tanh, layers[2]).double()
        wanted, optimizer = torch.as_tensor(targets), torch.optim.Adam(self.network.parameters(), lr=1e-2)
        for _ in range(self.epochs):
            optimizer.zero_grad()
            getattr(torch.nn.functional, loss)(self.network(inputs), wanted).backward()
            optimizer.step()

    def answers(self, seen: Array, x: Array) -> Array:
        """What it says of each episode (N, F), its place x (P,) the same for all."""
        import torch

        with torch.no_grad():
            found: Array = self.network(self._inputs(seen, np.broadcast_to(x, (len(seen), x.shape[-1])))).numpy()
        return found

    def _inputs(self, seen: Array, x: Array) -> Any:
        import torch

        return torch.as_tensor(np.concatenate([(seen - self.shift) / self.scale, 2.0 * x - 1.0], axis=1))
