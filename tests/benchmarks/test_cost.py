"""The cost of a diagnosis is that of its process."""

import numpy as np
import pytest

from tests.benchmarks.cost import SIZES, Cost, cost, table
from tests.benchmarks.experiments import Log

pytestmark = pytest.mark.long


def test_every_size_is_as_large_as_it_says():
    assert all(samples == log.rollouts * log.samples for samples, log in SIZES.items())


def test_a_short_log_takes_time_and_memory_that_are_not_those_of_the_process_that_asks():
    held = np.ones(250_000_000)  # 2 GB
    measured = cost(Log(seconds=2.0, rollouts=3))
    assert measured.samples == 300
    assert 0.0 < measured.processor < 60.0
    assert 30.0 < measured.memory < 1e-6 * held.nbytes
    assert measured.said


def test_a_cost_that_grows_with_the_samples_has_slope_one_and_the_first_size_none():
    rows = table([Cost(1000, 50.0, 2.0, 1.0, 100.0, ""), Cost(10_000, 50.0, 2.0, 10.0, 1000.0, "")])
    first, second = rows.splitlines()[2:]
    assert first.count("|  |") == second.count("| 1.00 |") == 2
