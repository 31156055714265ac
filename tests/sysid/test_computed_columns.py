"""A torque that a controller computed from the readings carries their noise; it must not explain it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from sysid import Record, sensor_noise
from sysid.data.computed_columns import follows_readings
from sysid.planning.excitation import multisine, steps

NOISE = (0.001, 0.05)


def aims(kind: str, rng: np.random.Generator, n: int, dt: float) -> np.ndarray:
    return multisine(rng, n, dt, 0.6, 2.0) if kind == "sines" else steps(rng, n, dt, 1.0, 0.8)


Controller = Callable[[int, np.ndarray, np.ndarray], float]
"""The torque of step k, by the readings of the angle and the speed so far."""


def rollout(controller: Controller, rng: np.random.Generator, dt: float, n: int) -> Record:
    """A pendulum that begins hanging, under a controller that reads noisy sensors."""
    x, v, y, w, u = math.pi, 0.0, np.empty(n + 1), np.empty(n + 1), np.empty(n)
    for k in range(n + 1):
        y[k], w[k] = np.array([x, v]) + np.array(NOISE) * rng.standard_normal(2)
        if k < n:
            u[k] = controller(k, y, w)
            for _ in range(10):
                v += 0.1 * dt * (4.95 * math.sin(x) + u[k]) / 0.326
                x += 0.1 * dt * v
    return Record(dt * np.arange(n + 1), u, y, w)


def servo(kind: str, dt: float, kd: float = 2.0, late: int = 0, n: int = 800) -> list[Record]:
    """Rollouts under a digital PD controller that reads its sensors `late` samples ago."""

    def controller(aim: np.ndarray, k: int, y: np.ndarray, w: np.ndarray) -> float:
        read = max(k - late, 0)
        return 10.0 * (math.pi + aim[k] - y[read]) - kd * w[read]

    rng = np.random.default_rng(0)
    return [rollout(partial(controller, aims(kind, rng, n, dt)), rng, dt, n) for _ in range(4)]


@pytest.mark.parametrize("kind", ["steps", "sines"])
@pytest.mark.parametrize("dt", [0.02, 0.005])
def test_the_noise_of_a_servos_log_is_found(kind: str, dt: float) -> None:
    records = servo(kind, dt)
    assert follows_readings(records)
    sensor = sensor_noise(records).sensor
    assert sensor.theta == pytest.approx(NOISE[0], rel=0.1)
    assert sensor.theta_dot == pytest.approx(NOISE[1], rel=0.1)


def test_a_controller_that_reads_late_is_seen_too() -> None:
    assert follows_readings(servo("steps", 0.01, kd=1.0, late=2))


@pytest.mark.parametrize("kind", ["steps", "sines", "white"])
def test_an_open_loop_follows_nothing(kind: str) -> None:
    rng, dt, n, records = np.random.default_rng(1), 0.02, 800, []
    for _ in range(4):
        u = rng.uniform(-2.0, 2.0, n) if kind == "white" else 2.0 * aims(kind, rng, n, dt)
        records.append(rollout(lambda k, _, __, u=u: u[k], rng, dt, n))
    assert not follows_readings(records)
