"""The driver's benchmark goes through a whole study of invented runs."""

from tests.benchmarks.driver import measure


def test_every_phase_is_measured_and_every_run_kept():
    cost = measure(250)
    assert min(cost.values()) > 0.0
    assert cost["folder [kB]"] > 250 * 10.0
