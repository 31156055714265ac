"""The speed benchmark counts what an update multiplies, and its contenders run."""

import pytest

from tests.benchmarks.training import BATCH, OURS, SACLOSS, products, turn


def test_the_work_of_an_update_is_sixteen_products_of_its_hidden_layers():
    wide = 4096
    assert products((wide, wide)) / (2.0 * BATCH * wide * wide) == pytest.approx(16.0, rel=0.01)


@pytest.mark.parametrize("who", [OURS, SACLOSS])
def test_a_contender_runs_in_a_process_of_its_own_and_says_its_rate(who):
    measured = turn(who, 8, 2, 0.01)
    assert measured["rate"] > 0.0 and measured["memory"] > 1e7
