"""Where an agent's random numbers come from: its seed, the purpose and a block number, and nothing else.

Every generator is made afresh from numpy's SeedSequence(seed, spawn_key=(purpose, block)). So an agent's draws do not
depend on its neighbours, agents that share a seed share their draws, and a checkpoint needs no generator state:
the numbers of step k are the same whenever they are asked for.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


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
