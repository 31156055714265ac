"""Where an agent's random numbers come from: its seed, the purpose and a block number, and nothing else.

Every generator is made afresh from numpy's SeedSequence(seed, spawn_key=(purpose, block)). So an agent's draws do not
depend on its neighbours, agents that share a seed share their draws, and a checkpoint needs no generator state:
the numbers of step k are the same whenever they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Purpose(IntEnum):
    """What a stream is for. The numbers are part of the results: never reorder."""

    WEIGHTS = 0
    EPISODES = 1
    EXPLORATION = 2
    REPLAY = 3
    LOSS = 4
    EVALUATION = 5


def generator(seed: int, purpose: Purpose, block: int = 0) -> np.random.Generator:
    """The generator of one block of one purpose; calling it again starts it anew."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(purpose), block)))


class Blocks:
    """Numbers of A agents for every step, drawn `length` steps at a time: `blocks[k]` has shape (A, ...).

    `draw(rng, length)` returns one agent's numbers (length, ...) for a block.
    """

    def __init__(
        self,
        seeds: Sequence[int],
        purpose: Purpose,
        draw: Callable[[np.random.Generator, int], NDArray],
        length: int = 100,
    ) -> None:
        self.seeds, self.purpose, self.draw, self.length = tuple(seeds), purpose, draw, length
        self._block = -1
        self._numbers: NDArray = np.empty(0)

    def __getitem__(self, step: int) -> NDArray:
        block, k = divmod(step, self.length)
        if block != self._block:
            drawn = [self.draw(generator(seed, self.purpose, block), self.length) for seed in self.seeds]
            self._numbers, self._block = np.stack(drawn, axis=1), block
        return self._numbers[k]
