"""Responses: exact derivatives, every reading scored once, and the motion that the simulator makes."""

from __future__ import annotations

import math
from itertools import pairwise

import casadi
import numpy as np
import pytest

from sysid import (
    RK4,
    Dahl,
    Delay,
    DynamicEffect,
    Effect,
    FlexibleTransmission,
    Lag,
    Model,
    Record,
    RodPendulum,
    SemiImplicitEuler,
    Sensor,
    SensorDelay,
    Stamp,
    VelocityGain,
    Viscous,
    simulate,
)
from sysid.estimation.linearisation import Samples
from sysid.estimation.output_error import CHANNELS, Response, evaluate_mapped
from sysid.estimation.windows import cut
from sysid.planning.excitation import multisine
from tests.sysid.planted import DT, SENSOR, without_noise
from tests.sysid.planted import truth as rod

SENSORS = {"both": SENSOR, "angles": Sensor(0.003), "speeds": Sensor(None, 0.05)}


def logs(model: Model, lengths: tuple[int, ...] = (61, 48), seed: int = 3, sensor: Sensor = SENSOR) -> list[Record]:
    rng = np.random.default_rng(seed)
    records = []
    for i, n in enumerate(lengths):
        u = multisine(rng, n, model.dt, 2.0, 3.0)
        run = simulate(model, u, math.pi + 0.4 * (-1) ** i, 0.3)
        records += sensor.measure(run, rng)
    return records


def differences(response: Response, starts: np.ndarray) -> np.ndarray:
    """-d residual / d starts (K, R, 2), by central differences."""
    moved = [[response.linearise(starts + s * 1e-6 * x).e for s in (1.0, -1.0)] for x in np.eye(2)]
    return np.stack([(down - up) / 2e-6 for up, down in moved], axis=-1)


def assert_exact(response: Response, starts: np.ndarray) -> None:
    lin = response.linearise(starts)
    np.testing.assert_allclose(lin.states, response.states(starts), atol=1e-12)
    by_differences = differences(response, starts)
    size = np.max(np.abs(by_differences), axis=(0, 1))
    assert np.all(np.max(np.abs(lin.S_x - by_differences), axis=(0, 1)) <= 2e-4 * size + 1e-6)


def nudged(response: Response) -> np.ndarray:
    """Starts off the readings, off the kinks and at no speed that is exactly 0."""
    rng = np.random.default_rng(8)
    return response.starts + rng.normal(0.0, [0.02, 0.1], response.starts.shape)


@pytest.mark.parametrize("horizon", [0.4, math.inf], ids=["windows", "whole rollouts"])
def test_derivatives_are_exact_for_every_effect(effect: Effect, horizon: float) -> None:
    model = rod(effect)
    records = logs(model)
    for sensor in (SENSOR, SENSORS["angles"], SENSORS["speeds"]) if math.isfinite(horizon) else (SENSOR,):
        response = Response(model, Samples(model, records, sensor), cut(records, horizon, 0.1))
        assert_exact(response, nudged(response))


@pytest.mark.parametrize("integrator", [RK4(substeps=1), SemiImplicitEuler(theta_dot_max=8.0)])
def test_derivatives_are_exact_for_all_effects_at_once(
    all_effects: tuple[Effect, ...], integrator: RK4 | SemiImplicitEuler
) -> None:
    model = Model(RodPendulum(m=1.0, l=0.9), all_effects, integrator, dt=DT)
    records = logs(model)
    response = Response(model, Samples(model, records, SENSOR), cut(records, 0.6, 0.1))
    assert_exact(response, nudged(response))


def test_windows_with_models_of_their_own_are_windows_of_each_model(effect: Effect) -> None:
    model = rod(effect)
    other = model.with_numbers(model.parameters, [p.value + 0.05 * p.scale for p in model.parameters.values()])
    samples = Samples(model, logs(model), SENSOR)
    windows = cut(samples.records, 0.4, 0.1)
    of_windows = [other if k % 3 else model for k in range(len(windows))]
    together = Response(of_windows, samples, windows)
    starts, some = nudged(together), np.arange(1, len(windows))
    lin = together.linearise(starts[some], some)
    for one in (model, other):
        at = np.array([of_windows[k] is one for k in some])
        alone = Response(one, samples, windows).linearise(starts[some][at], some[at])
        np.testing.assert_allclose(lin.e[at], alone.e, rtol=0, atol=1e-9)
        np.testing.assert_allclose(lin.S_x[at], alone.S_x, rtol=0, atol=1e-5 * np.max(np.abs(alone.S_x)))


LENGTHS = (1, 2, 37, 100, 151)


@pytest.mark.parametrize("length", [0.02, 0.05, 0.3, 0.5, 1.0, math.inf])
@pytest.mark.parametrize("lead", [0.0, 0.07, 10.0])
def test_windows_tile_the_records(length: float, lead: float) -> None:
    records = logs(rod(), LENGTHS)
    windows = cut(records, length, lead)
    for i, record in enumerate(records):
        of_record = [w for w in windows if w.record == i]
        scored = [(w.begin + w.lead, w.begin + w.count) for w in of_record]
        assert scored[0][0] == 0 and scored[-1][1] == len(record)
        assert all(end == begin for (_, end), (begin, _) in pairwise(scored))
        counts = [end - begin for begin, end in scored]
        assert max(counts) - min(counts) <= 1
        shortest = min(2.0 / 3.0 * length / DT, len(record))
        assert min(counts) >= math.floor(shortest)
        assert len(of_record) == 1 or max(counts) <= math.ceil(1.5 * length / DT)
        assert [w.lead for w in of_record] == [min(w.begin + w.lead, math.ceil(lead / DT - 1e-9)) for w in of_record]


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS.keys())
@pytest.mark.parametrize("length", [0.3, math.inf])
@pytest.mark.parametrize("lead", [0.0, 0.1])
def test_every_reading_is_scored_once(sensor: Sensor, length: float, lead: float) -> None:
    records = logs(rod(), LENGTHS, sensor=sensor)
    response = Response(rod(), Samples(rod(), records, sensor), cut(records, length, lead))
    times = [np.zeros((2, len(r) + 1)) for r in records]
    for window, weight, value in zip(response.windows, response.weight, response.y, strict=True):
        at = slice(window.begin, window.begin + window.count + 1)
        seen = weight[:, : window.count + 1] > 0.0
        times[window.record][:, at] += seen
        assert not np.any(weight[:, : window.lead]) and not np.any(weight[:, window.count + 1 :])
        for row, channel in enumerate(CHANNELS):
            readings = getattr(records[window.record], channel)
            if np.any(seen[row]):
                whole = np.zeros(len(records[window.record]) + 1)
                whole[: len(readings)] = readings
                np.testing.assert_allclose(value[row, : window.count + 1][seen[row]], whole[at][seen[row]])
    for record, count in zip(records, times, strict=True):
        for row, channel in enumerate(CHANNELS):
            readings = getattr(record, channel)
            expected = np.arange(len(record) + 1) < (0 if readings is None else len(readings))
            np.testing.assert_array_equal(count[row], expected)
    total = [sum(len(getattr(r, c)) for r in records if getattr(r, c) is not None) for c in CHANNELS]
    np.testing.assert_array_equal(np.count_nonzero(response.weight, axis=(0, 2)), total)


SIGNAL = {
    "nothing": (),
    "stamped early": (Stamp(s=-0.6),),
    "stamped late": (Stamp(s=0.4), Lag(T=0.03)),
    "delayed, lagged, read late": (Delay(T=0.047), Lag(T=0.03), SensorDelay(T=0.033), VelocityGain(c=1.1)),
}


@pytest.mark.parametrize("name", [*SIGNAL, "all effects"])
def test_the_nominal_trajectory_is_the_simulation(name: str, all_effects: tuple[Effect, ...]) -> None:
    # the states of dynamic effects are those of the readings, not those of the simulation
    model = rod(*SIGNAL.get(name, tuple(e for e in all_effects if not isinstance(e, DynamicEffect))))
    rng = np.random.default_rng(2)
    u = np.array([multisine(rng, 80, DT, 2.0, 3.0) for _ in range(3)])
    run = simulate(model, u, math.pi + rng.uniform(-1.0, 1.0, 3), rng.normal(0.0, 1.0, 3))
    records = without_noise(run)
    truth = np.stack([run.theta, run.theta_dot], axis=-1)

    whole = Response(model, Samples(model, records, SENSOR), cut(records))
    lin = whole.linearise(truth[:, 0])
    np.testing.assert_allclose(lin.states, truth, atol=1e-11)
    assert np.max(np.abs(lin.e)) < 1e-8, "readings are not those of the simulation"

    windows = Response(model, Samples(model, records, SENSOR), cut(records, 0.4, 0.2))
    starts = np.array([truth[w.record, w.begin] for w in windows.windows])
    for w, states in zip(windows.windows, windows.states(starts), strict=True):
        np.testing.assert_allclose(states[: w.count + 1], truth[w.record, w.begin : w.begin + w.count + 1], atol=1e-11)
    if name != "all effects":  # a play's memory outlasts any lead-in
        assert np.max(np.abs(windows.linearise(starts).e)) < 1e-8, "the lead-in does not fill the memories"


def test_the_states_of_a_dynamic_effect_settle_before_a_window_is_scored() -> None:
    """They begin it as the readings left them, which is nearly as the motion did."""
    model = rod(Dahl(tau_c=0.1, z_s=0.1), FlexibleTransmission(J=0.03, f=3.0, zeta=0.3))
    rng = np.random.default_rng(2)
    run = simulate(model, multisine(rng, 400, DT, 2.0, 3.0)[None], math.pi, 0.0)
    record = Record(run.t, run.u[0], run.theta_read[0], run.theta_dot_read[0])
    windows = Response(model, Samples(model, [record], SENSOR), cut([record], 1.0, 1.0))
    starts = np.array([[run.theta[0, w.begin], run.theta_dot[0, w.begin]] for w in windows.windows])
    assert np.sqrt(np.mean(windows.linearise(starts).e ** 2)) < 0.3


def test_readings_that_no_window_holds_do_not_matter() -> None:
    """Padding and lead-in: neither residuals nor derivatives."""
    records = logs(rod(), (100, 33))
    response = Response(rod(), Samples(rod(), records, SENSOR), cut(records, math.inf, 0.2))
    lin = response.linearise(response.starts)
    padded = response.weight.reshape(2, -1) == 0.0
    assert np.count_nonzero(padded) == 2 * 67
    assert not np.any(lin.e[padded]) and not np.any(lin.S_x[padded])


def test_a_mapped_function_gives_what_casadi_gives_with_rows_for_columns() -> None:
    rng = np.random.default_rng(0)
    x, y, none = casadi.SX.sym("x", 2), casadi.SX.sym("y", 3), casadi.SX.sym("none", 0)
    mapped = casadi.Function("f", [x, none, y], [casadi.vertcat(x[0] * y[:2], casadi.sin(x[1]), y[2])]).map(5)
    X, Y = rng.standard_normal((5, 2)), rng.standard_normal((3, 5)).T  # Y is not contiguous
    called = np.asarray(mapped(X.T, np.zeros((0, 5)), Y.T)).T
    np.testing.assert_array_equal(evaluate_mapped(mapped, X, np.zeros((5, 0)), Y), called)


def test_inputs_stay_as_they_are() -> None:
    model = rod(Viscous(b=0.1), Delay(T=0.03))
    records = logs(model)
    response = Response(model, Samples(model, records, SENSOR), cut(records, 0.5))
    starts = response.starts.copy()
    once, again = response.linearise(starts), response.linearise(starts)
    np.testing.assert_array_equal(starts, response.starts)
    np.testing.assert_array_equal(once.S_x, again.S_x)
