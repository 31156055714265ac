"""Torques from outside: what they do to a free mass, in closed form."""

import math

import numpy as np
import pytest

from sysid import RK4, Drift, Extent, LinearAxis, Model, Periodic, TorqueBias, simulate

W = 2.0 * math.pi * 1.7


@pytest.mark.parametrize(
    ("effect", "impulse", "atol"),
    [
        (TorqueBias(tau_0=0.3), lambda t: 0.3 * t, 1e-13),
        (Drift(r=0.3), lambda t: 0.5 * 0.3 * t**2, 1e-13),
        (Periodic(0.2, -0.3, f=1.7), lambda t: (0.2 * (1.0 - np.cos(W * t)) - 0.3 * np.sin(W * t)) / W, 1e-7),
    ],
    ids=lambda e: getattr(e, "name", ""),
)
def test_a_free_mass_has_the_speed_of_the_impulse(effect, impulse, atol):
    run = simulate(Model(LinearAxis(m=0.8), (effect,), RK4(substeps=4), 0.02), np.zeros(200), 0.0, 0.0)
    np.testing.assert_allclose(run.theta_dot, impulse(run.t) / 0.8, atol=atol)


@pytest.mark.parametrize(("dt", "duration", "highest"), [(0.02, 8.0, 12.0), (0.05, 8.0, 8.0), (0.001, 100.0, 12.0)])
def test_frequencies_to_try_reach_from_two_periods_to_the_highest_that_the_log_shows(dt, duration, highest):
    f = np.array(Periodic().parameters["f"].probes(Extent(dt, duration, 1.0)))
    assert f[0] == pytest.approx(2.0 / duration) and f[-1] == pytest.approx(highest)
    assert np.all(np.diff(f) > 0.0) and len(f) <= 200
    assert len(f) == 200 or np.allclose(np.diff(f), 0.5 / duration, rtol=0.02)


def swing(f, seconds=30.0):
    """A sine motion of f [Hz], its instants, and the commands of a free swing."""
    t = np.arange(0.0, seconds, 0.02)
    return math.pi + 0.8 * np.sin(2.0 * math.pi * f * t), t, 0.0 * t


@pytest.mark.parametrize("seconds", [20.0, 30.0, 41.0, 60.0])
@pytest.mark.parametrize("f", [0.1, 0.2, 0.3, 1.0])
def test_a_torque_that_comes_back_with_the_motion_may_be_a_function_of_it(f, seconds):
    """However many whole periods the record has: a motion that comes back after 10 s does so after 20 s, too."""
    assert Periodic(f=f).recurrences(*swing(0.1, seconds)) == -math.inf


@pytest.mark.parametrize("f", [0.14, 0.25, 0.35, 1.07])
def test_a_torque_that_does_not_come_back_with_the_motion_counts_its_periods(f):
    theta, t, u = swing(0.1)
    assert Periodic(f=f).recurrences(theta, t, u) == pytest.approx(f * np.ptp(t))


def test_beside_a_motion_that_never_comes_back_every_frequency_counts():
    t = np.arange(0.0, 30.0, 0.02)
    chirp = math.pi + np.sin(2.0 * math.pi * (0.05 * t + 0.015 * t**2))
    drifting = np.cumsum(np.cumsum(np.random.default_rng(0).standard_normal(len(t))))
    for motion in (chirp, drifting, np.full_like(t, math.pi)):
        for f in (0.1, 0.3, 1.0):
            assert Periodic(f=f).recurrences(motion, t, 0.0 * t) == pytest.approx(f * np.ptp(t))
