"""Random numbers are a function of seed, purpose and step."""

import numpy as np
import torch

from policies.environments.random_streams import Purpose, generator
from policies.training.random_blocks import RandomBlocks


def draw(rng, length):
    return rng.random((length, 3))


def numbers(blocks, steps):
    drawn = []
    for step in steps:
        block, k = divmod(step, blocks.length)
        blocks.load(block)
        drawn.append(blocks.at(torch.tensor([k])).numpy())
    return np.array(drawn)


def test_numbers_do_not_depend_on_the_order_of_asking():
    forward, backward = (RandomBlocks((1, 2), Purpose.LOSS, draw, length=10) for _ in range(2))
    ascending = numbers(forward, range(35))
    np.testing.assert_array_equal(ascending, numbers(backward, reversed(range(35)))[::-1])
    assert len(np.unique(ascending)) == ascending.size


def test_seeds_purposes_and_blocks_have_streams_of_their_own():
    firsts = [generator(s, p, b).random() for s in (0, 1) for p in Purpose for b in (0, 1)]
    assert len(set(firsts)) == len(firsts)
    assert generator(1, Purpose.LOSS, 3).random() == generator(1, Purpose.LOSS, 3).random()
