"""Spikes: readings that jump away and back are found, and nothing else is."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from sysid import Coulomb, Effect, GeneralJoint, Model, Viscous, read, simulate
from sysid.data.spikes import spikes
from sysid.planning.excitation import steps

DT = 0.02
STICKING = (Viscous(b=0.05), Coulomb(tau_c=1.0))
DAMPED = (Viscous(b=0.3), Coulomb(tau_c=0.3))


@functools.cache
def motion(seed: int, effects: tuple[Effect, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """The angle and the speed [rad], [rad/s] of a joint under steps of torque, without noise."""
    rng = np.random.default_rng(seed)
    model = Model(GeneralJoint(J=0.1, G=2.0), effects, dt=DT)
    u = steps(rng, 400, DT, 3.0, 0.3)
    run = simulate(model, u[None], np.array([math.pi]), np.zeros(1))
    return np.asarray(run.theta_read[0]), np.asarray(run.theta_dot_read[0])


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("noise", [0.0, 1e-4, 3e-3])
@pytest.mark.parametrize("rounded", [0.0, 0.01])
def test_steps_of_torque_sticking_and_rounding_are_no_spikes(seed: int, noise: float, rounded: float) -> None:
    for y in motion(seed, STICKING):
        seen = y + noise * np.random.default_rng(seed).standard_normal(len(y))
        seen = rounded * np.round(seen / rounded) if rounded else seen
        assert not np.any(spikes(seen))


@pytest.mark.parametrize("seed", range(5))
def test_a_joint_that_hits_a_stop_or_jolts_shows_no_spike(seed: int) -> None:
    """Its speed turns about within a sample, and a jolt pushes it for one."""
    rng = np.random.default_rng(seed)
    theta, _ = motion(seed)
    stopped = math.pi + np.abs(theta - math.pi) + 1e-4 * rng.standard_normal(len(theta))
    pushed = theta.copy()
    pushed[200:] += 0.3 * (1.0 - np.exp(-DT * np.arange(201) / 0.1)) + 1e-4 * rng.standard_normal(201)
    assert not np.any(spikes(stopped)) and not np.any(spikes(pushed))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("length", [1, 2])
def test_spikes_are_found_and_nothing_else(seed: int, length: int) -> None:
    """Two wrong readings in a row are wrong by about as much."""
    rng = np.random.default_rng(seed)
    theta, _ = motion(seed, DAMPED)
    at = 20 + 40 * np.arange(9) + rng.integers(0, 20, 9)
    seen = theta + 1e-3 * rng.standard_normal(len(theta))
    sizes = rng.choice([-1.0, 1.0], 9) * rng.uniform(3.0, 6.0, 9)
    for k in range(length):
        seen[at + k] += sizes * (1.0 + 0.02 * k)
    np.testing.assert_array_equal(np.flatnonzero(spikes(seen)), np.sort([at + k for k in range(length)], axis=None))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("ready", [0.0, 5.0])
def test_what_a_sensor_shows_before_it_is_ready_and_after_it_is_off_is_found(
    seed: int, count: int, ready: float
) -> None:
    """Its speed at the ends of a log, in which the torque steps at once, is a constant that it never had."""
    _, theta_dot = motion(seed, DAMPED)
    seen = theta_dot + 1e-3 * np.random.default_rng(seed).standard_normal(len(theta_dot)) - ready
    seen[:count] = 40.0 - ready
    seen[-count:] = -30.0 - ready
    expected = [*range(count), *range(len(seen) - count, len(seen))]
    np.testing.assert_array_equal(np.flatnonzero(spikes(seen)), expected)


def test_few_readings_and_missing_ones_show_none() -> None:
    assert not np.any(spikes(np.array([0.0, 0.0, 9.0, 0.0])))
    assert not np.any(spikes(np.full(50, math.nan)))
    y = np.sin(0.1 * np.arange(100.0))
    y[30] = math.nan
    y[70] += 1.0
    assert np.flatnonzero(spikes(y)).tolist() == [70]


def test_a_log_is_read_without_its_spikes(tmp_path) -> None:
    theta, theta_dot = motion(0, DAMPED)
    rng = np.random.default_rng(0)
    seen = theta + 1e-3 * rng.standard_normal(len(theta))
    wrong = seen.copy()
    wrong[[50, 120]] += [2.0, -1.5]
    rows = np.column_stack([DT * np.arange(len(theta)), 0.0 * theta, wrong, theta_dot])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,torque,theta,theta_dot", comments="")
    log = read(tmp_path / "log.csv")
    (record,) = log
    assert np.max(np.abs(np.asarray(record.theta) - seen)) < 0.02
    assert "2 rows with readings that jump away and back" in str(log)
