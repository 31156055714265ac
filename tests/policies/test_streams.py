"""Random numbers are a function of seed, purpose and step."""

import numpy as np

from policies.streams import Blocks, Purpose, generator


def draw(rng, length):
    return rng.random((length, 3))


def test_numbers_do_not_depend_on_the_order_of_asking():
    forward, backward = Blocks((1, 2), Purpose.LOSS, draw, 10), Blocks((1, 2), Purpose.LOSS, draw, 10)
    steps = range(35)
    ascending = [forward[k].copy() for k in steps]
    descending = [backward[k].copy() for k in reversed(steps)]
    np.testing.assert_array_equal(ascending, descending[::-1])


def test_neighbours_change_nothing():
    together, alone = Blocks((1, 2, 3), Purpose.LOSS, draw), Blocks((2,), Purpose.LOSS, draw)
    np.testing.assert_array_equal(together[123][1], alone[123][0])


def test_seeds_purposes_and_blocks_have_streams_of_their_own():
    firsts = [generator(s, p, b).random() for s in (0, 1) for p in Purpose for b in (0, 1)]
    assert len(set(firsts)) == len(firsts)
