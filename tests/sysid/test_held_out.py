"""The error that is shown is 1.0 for a perfect model, whatever is measured and however often, and only then."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from sysid import (
    Backlash,
    Coulomb,
    Delay,
    Model,
    RodPendulum,
    Sensor,
    SensorDelay,
    Viscous,
    simulate,
)
from sysid.estimation.held_out import held_out_error, lead_of, refit
from sysid.estimation.linearisation import Samples
from sysid.estimation.output_error import Response
from sysid.estimation.windows import cut
from tests.sysid import planted
from tests.sysid.planted import SENSOR

logs = partial(planted.logs, n=8, seconds=6.0)


def rod(dt: float = 0.02) -> Model:
    return Model(RodPendulum(m=1.0, l=0.9), dt=dt)


def band(n: int) -> float:
    """Half the 99.7 % band of sqrt(chi2_n / n)."""
    return 3.0 / math.sqrt(2.0 * n)


@pytest.mark.parametrize("dt", [0.005, 0.02, 0.05, 0.1])
def test_a_perfect_model_gets_one_at_any_rate_in_each_channel(dt: float) -> None:
    records = logs(rod(dt), n=6)
    error = held_out_error(rod(dt), records, SENSOR)
    degrees = error.n_readings - 2 * error.n_windows
    for ratio in error.ratios.values():
        assert abs(ratio - 1.0) < band(degrees // 2)
    assert abs(error.ratio - 1.0) < band(degrees)
    assert error.theta == pytest.approx(error.ratios["theta"] * SENSOR.theta)
    assert error.theta_dot == pytest.approx(error.ratios["theta_dot"] * SENSOR.theta_dot)


def test_leverage_is_taken_out_channel_by_channel() -> None:
    """Two instants a window: four readings, two of which the state uses up, mostly the angles."""
    ratios = np.array(
        [list(held_out_error(rod(), logs(rod(), seed), SENSOR, window=0.04).ratios.values()) for seed in range(10)]
    )
    mean, error = ratios.mean(axis=0), ratios.std(axis=0, ddof=1) / math.sqrt(len(ratios))
    assert np.all(np.abs(mean - 1.0) < 4.0 * error)
    assert np.all(error < 0.01)


@pytest.mark.parametrize("sensor", [Sensor(0.003), Sensor(None, 0.05)])
def test_one_channel_is_enough(sensor: Sensor) -> None:
    error = held_out_error(rod(), logs(rod(), sensor=sensor), sensor)
    assert abs(error.ratio - 1.0) < band(error.n_readings - 2 * error.n_windows)
    assert (error.theta is None) == (sensor.theta is None)
    assert (error.theta_dot is None) == (sensor.theta_dot is None)


def test_of_the_angle_its_start_is_enough() -> None:
    sensor = Sensor(0.001, 0.05)
    records = [replace(r, theta=r.theta[:1]) for r in logs(rod(), sensor=sensor) if r.theta is not None]
    error = held_out_error(rod(), records, sensor)
    assert abs(error.ratio - 1.0) < band(error.n_readings - 2 * error.n_windows)


@pytest.mark.parametrize(
    "effect", [Delay(T=0.05), SensorDelay(T=0.05), Backlash(width=0.05), Coulomb(tau_c=0.2)], ids=lambda e: e.name
)
def test_memories_are_full_and_dry_friction_is_followed(effect: object) -> None:
    model = rod().with_effect(effect)
    records = logs(model)
    error = held_out_error(model, records, SENSOR)
    assert error.ratio < 1.0 + 2.0 * band(error.n_readings)
    assert held_out_error(rod(), records, SENSOR).ratio > 1.3
    assert lead_of(model) == (1.0 if effect.name in ("sensor_delay", "backlash") else 0.0)


def test_the_state_is_refitted_to_the_least_squares_optimum() -> None:
    model = rod().with_effect(Viscous(b=0.3))
    records = logs(rod())
    fit = refit(Response(model, Samples(model, records, SENSOR), cut(records, 1.0)))
    best = 0.5 * np.sum(fit.lin.e**2, axis=1)
    rng = np.random.default_rng(1)
    for size in (1e-4, 1e-2):
        moved = fit.response.linearise(fit.starts + size * rng.standard_normal(fit.starts.shape)).e
        assert np.all(
            0.5 * np.sum(moved.reshape(len(best), -1) ** 2, axis=1) > best - 2e-3 * np.maximum(1.0, 0.1 * best)
        )


def test_an_error_in_one_rollout_is_found_there() -> None:
    push = np.zeros(300)
    push[120:135] = 1.0
    worst = held_out_error(rod(), planted.pushed(logs(rod()), 3, rod(), push, seed=7), SENSOR).worst[0]
    assert worst.record == "pushed"
    assert worst.begin <= 120 * 0.02 < worst.end
    assert worst.ratio > 3.0


def test_longer_windows_show_more_of_a_wrong_model() -> None:
    records = logs(rod().with_effect(Viscous(b=0.1)))
    ratios = [held_out_error(rod(), records, SENSOR, w).ratio for w in (0.04, 0.5, 1.0, math.inf)]
    assert ratios == sorted(ratios)
    assert ratios[0] < 1.1 and ratios[-1] > 5.0


def test_it_prints_and_becomes_json() -> None:
    error = held_out_error(rod(), logs(rod()), SENSOR)
    data = json.loads(json.dumps(error.to_dict(), allow_nan=False))
    assert data["ratio"] == error.ratio and data["n_windows"] == 48 and len(data["worst"]) == 3
    assert "rad/s" in str(error) and "x the sensor noise over 48 windows of 1 s" in str(error)


@pytest.mark.parametrize("sensing", [SensorDelay(T=0.0), Backlash(width=0.0)], ids=lambda e: e.name)
def test_a_sensor_that_remembers_and_changes_nothing_changes_no_error(sensing: SensorDelay | Backlash) -> None:
    """Also where the angle is coarse and the speed poor, and random torque of a second hides where a window began."""
    model, sensor, rng = (
        Model(RodPendulum(m=2.0, l=1.5), dt=0.05, u_max=2.0),
        Sensor(0.01, 1.0),
        np.random.default_rng(3),
    )
    start = rng.uniform(-math.pi, math.pi, 5), rng.uniform(-1.0, 1.0, 5)
    records = sensor.measure(simulate(model, rng.uniform(-2.0, 2.0, (5, 200)), *start), rng)
    plain = held_out_error(model, records, sensor)
    assert held_out_error(model.with_effect(sensing), records, sensor).ratio == pytest.approx(plain.ratio, abs=0.01)
    assert abs(plain.ratio - 1.0) < 0.05
