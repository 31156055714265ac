"""Laws of a world with a random torque and of the table that is made of its answers."""

import numpy as np
import pytest

from tests.benchmarks.random_torque import EFFECTS, case, report, solve, world

pytestmark = pytest.mark.long


def test_a_world_pushes_with_the_torque_that_its_key_tells():
    chosen = case(7, 0.1, 0.3)
    made = world(chosen, 0.1, 0.3)
    assert made.gust == 1.0
    assert np.std(made.plan.wind) == pytest.approx(0.1, rel=0.2)
    assert {k.split(".")[0] for k in made.numbers} == {EFFECTS[7 % len(EFFECTS)]}


def test_coverage_counts_the_numbers_of_the_named_effect_alone():
    cases = [case(seed, 0.1, 0.3) for seed in (0, 5)]
    row = {"verdict": "partly", "truth": {"coulomb.tau_c": 0.12}, "random_torque": 0.11, "unconfirmed": []}
    rows = {
        cases[0].key: row | {"named": [["coulomb"]], "intervals": {"m": [1.0, 1.1], "coulomb.tau_c": [0.1, 0.13]}},
        cases[1].key: row | {"named": [], "intervals": {"m": [1.0, 1.1]}, "random_torque": 0.2},
    }
    first, second, third, *wrong = report(cases, rows, 0.1)
    assert "named 1 of 2" in first
    assert "1.000 of 1 " in second
    assert "1 of 2" in third
    assert len(wrong) == 1


@pytest.mark.parametrize("seed", [9, 74])
def test_a_spring_is_named_beside_a_random_torque_though_predictions_hardly_improve(seed):
    (row,) = solve(case(seed, 0.1, 0.3), ["ours"], None)[1].values()
    assert [set(names) & {"spring"} for names in row["named"]] == [{"spring"}]
    assert row["random_torque"] == pytest.approx(0.1, rel=0.2)
