"""Torques from outside: what they do to a free mass, in closed form."""

import math

import numpy as np
import pytest

from sysid import RK4, Drift, Extent, LinearAxis, Model, Periodic, TorqueBias, simulate

M = 0.8


def speed(effect):
    run = simulate(Model(LinearAxis(m=M), (effect,), RK4(substeps=4), 0.02), np.zeros(200), 0.0, 0.0)
    return run.t, run.theta_dot


def test_a_bias_pushes_steadily():
    t, theta_dot = speed(TorqueBias(tau_0=0.3))
    np.testing.assert_allclose(theta_dot, 0.3 * t / M, atol=1e-13)


def test_a_drift_grows_with_time():
    t, theta_dot = speed(Drift(r=0.3))
    np.testing.assert_allclose(theta_dot, 0.5 * 0.3 * t**2 / M, atol=1e-13)


def test_a_periodic_torque_has_its_frequency_and_phase():
    a, b, f = 0.2, -0.3, 1.7
    t, theta_dot = speed(Periodic(a=a, b=b, f=f))
    w = 2.0 * math.pi * f
    np.testing.assert_allclose(theta_dot, (a * (1.0 - np.cos(w * t)) + b * np.sin(w * t)) / (w * M), atol=1e-7)


@pytest.mark.parametrize(("dt", "duration", "highest"), [(0.02, 8.0, 12.0), (0.05, 8.0, 8.0), (0.001, 100.0, 12.0)])
def test_frequencies_to_try_reach_from_two_periods_to_the_highest_that_the_log_shows(dt, duration, highest):
    f = np.array(Periodic().parameters["f"].probes(Extent(dt, duration, 1.0)))
    assert f[0] == pytest.approx(2.0 / duration) and f[-1] == pytest.approx(highest)
    assert np.all(np.diff(f) > 0.0) and len(f) <= 200
