"""Random numbers are a function of seed, purpose and step."""

import numpy as np
import torch

from policies.learning.feed import Feed
from policies.streams import Purpose


def draw(rng, length):
    return rng.random((length, 3))


def numbers(feed, steps):
    drawn = []
    for step in steps:
        block, k = divmod(step, feed.length)
        feed.load(block)
        drawn.append(feed.at(torch.tensor([k])).numpy())
    return np.array(drawn)


def test_numbers_do_not_depend_on_the_order_of_asking():
    forward, backward = Feed((1, 2), Purpose.LOSS, draw, length=10), Feed((1, 2), Purpose.LOSS, draw, length=10)
    ascending = numbers(forward, range(35))
    np.testing.assert_array_equal(ascending, numbers(backward, reversed(range(35)))[::-1])
    assert len(np.unique(ascending)) == ascending.size


def test_neighbours_change_nothing_and_a_shared_seed_shares_its_numbers():
    together, alone = Feed((1, 2, 3, 2), Purpose.LOSS, draw), Feed((2,), Purpose.LOSS, draw)
    of_all, of_one = numbers(together, [123])[0], numbers(alone, [123])[0]
    np.testing.assert_array_equal(of_all[1], of_one[0])
    np.testing.assert_array_equal(of_all[3], of_one[0])
    assert (of_all[0] != of_all[1]).all()
