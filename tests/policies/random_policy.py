"""A policy of random weights: what files of policies are tried with."""

from itertools import pairwise

import numpy as np

from policies.network_policy import NetworkPolicy


def random_policy(history=2, hidden=(8, 6), seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    layers = tuple(
        ((scale * rng.normal(size=pair)).astype(np.float32), rng.normal(size=pair[1]).astype(np.float32))
        for pair in pairwise([3 + history, *hidden, 1])
    )
    return NetworkPolicy(layers, 1.7, history)
