"""A hidden plant of the benchmark: what following the advice loses, and what fixed numbers of rollouts do."""

import pytest

from tests.benchmarks.rollout_worth import FIXED, case, told

pytestmark = pytest.mark.long


def test_a_plant_is_measured_as_advised_and_told():
    found = case("least squares", 1, 3.0)
    fixed = [getattr(found, f"fixed_{n}") + 3.0 * n for n in FIXED]
    assert found.advised + 3.0 * found.advised_n < max(fixed)
    assert found.advised_n in (1, 2, 3, 4, 5)
    lines = told([found, found]).splitlines()
    assert lines[0] == "least squares, 2 plants, a rollout costs 3"
    assert len(lines) == 2 + len(FIXED)
