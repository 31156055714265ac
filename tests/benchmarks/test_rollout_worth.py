"""A hidden plant of the benchmark: what following the advice loses, and what fixed numbers of rollouts do."""

import pytest

from tests.benchmarks.rollout_worth import FIXED, case, summary

pytestmark = pytest.mark.long


def test_a_plant_is_measured_as_advised_and_told():
    measured = case("least squares", 1, 3.0)
    fixed = [getattr(measured, f"fixed_{n}") + 3.0 * n for n in FIXED]
    assert measured.advised + 3.0 * measured.advised_n < max(fixed)
    assert measured.advised_n in (1, 2, 3, 4, 5)
    lines = summary([measured, measured]).splitlines()
    assert lines[0] == "least squares, 2 plants, a rollout costs 3"
    assert len(lines) == 2 + len(FIXED)
