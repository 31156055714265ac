"""The random numbers of all agents where they train, a block of steps at a time.

Agents that share a seed share their numbers, which are drawn and carried once. On another device the next block is
drawn while this one is used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from policies.environments.random_streams import Purpose, generator

BLOCK_LENGTH = 100
"""Steps in a block. It is part of the results: each block has generators of its own."""


class RandomBlocks:
    """Numbers of A agents for every step: `load(block)`, then `at(k)` (A, ...) for the block's step k.

    `draw(rng, length)` returns one agent's numbers (length, ...) for a block.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        purpose: Purpose,
        draw: Callable[[np.random.Generator, int], NDArray],
        device: str | torch.device = "cpu",
        length: int = BLOCK_LENGTH,
    ) -> None:
        self.purpose, self.draw, self.length = purpose, draw, length
        self.seeds = tuple(dict.fromkeys(seeds))
        self._which = torch.tensor([self.seeds.index(seed) for seed in seeds], device=device)
        self._numbers = torch.from_numpy(self._drawn(0)).to(device)
        self._ahead: tuple[int, Future[NDArray]] | None = None
        self._pool = ThreadPoolExecutor(1) if self._numbers.device.type != "cpu" else None

    def _drawn(self, block: int) -> NDArray:
        """(length, seeds, ...)."""
        return np.stack([self.draw(generator(s, self.purpose, block), self.length) for s in self.seeds], axis=1)

    def load(self, block: int) -> None:
        """Take up the numbers of a block, in place of those of another."""
        ready = self._ahead is not None and self._ahead[0] == block
        numbers = self._ahead[1].result() if self._ahead is not None and ready else self._drawn(block)
        self._numbers.copy_(torch.from_numpy(numbers))
        if self._pool is not None:
            self._ahead = block + 1, self._pool.submit(self._drawn, block + 1)

    def at(self, k: Tensor) -> Tensor:
        """The numbers (A, ...) of the block's step k, an index (1,) on the device."""
        return self._numbers.index_select(0, k)[0].index_select(0, self._which)

    def all(self) -> Tensor:
        """The numbers (length, A, ...) of every step of the block."""
        return self._numbers.index_select(1, self._which)
