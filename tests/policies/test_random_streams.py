"""A stream is a function of seed, purpose and block."""

from policies.environments.random_streams import Purpose, generator


def test_seeds_purposes_and_blocks_have_streams_of_their_own():
    firsts = [generator(s, p, b).random() for s in (0, 1) for p in Purpose for b in (0, 1)]
    assert len(set(firsts)) == len(firsts)
    assert generator(1, Purpose.LOSS, 3).random() == generator(1, Purpose.LOSS, 3).random()
