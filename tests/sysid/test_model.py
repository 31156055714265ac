"""Model: one physics for three back ends, names of parameters, order of the input path, broadcasting."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from sysid import (
    RK4,
    Delay,
    Lag,
    Model,
    RodPendulum,
    Stamp,
    simulate,
)


def test_back_ends_agree_for_every_plant_without_effects(plant, integrator, agree):
    agree(Model(plant, integrator=integrator, dt=0.02))


@pytest.mark.long
def test_back_ends_agree_for_every_effect_alone(effect, integrator, agree):
    agree(Model(RodPendulum(m=1.3, l=0.9), (effect,), integrator, dt=0.02))


@pytest.mark.long
def test_back_ends_agree_for_all_effects_together(plant, all_effects, agree):
    agree(Model(plant, all_effects, RK4(), dt=0.02), steps=80)


@pytest.mark.parametrize("T", [0.0123, 0.03, 0.0591])
@pytest.mark.parametrize("kind", [Delay, Lag])
def test_back_ends_agree_on_the_derivatives_of_a_delay_and_a_lag(kind, T, agree):
    agree(Model(RodPendulum(m=1.3, l=0.9), (kind(T=T),), RK4(substeps=3), dt=0.02), steps=60)


@pytest.mark.parametrize(
    ("theta", "theta_dot", "commands", "kind"),
    [
        (math.pi, 0.0, (1.0, -2.0, 0.5), float),
        (torch.full((4,), 3.0), torch.zeros(4), (torch.ones(4),), torch.float32),
    ],
    ids=["floats", "single precision"],
)
def test_numbers_stay_of_their_kind(theta, theta_dot, commands, kind, all_effects, integrator):
    model = Model(RodPendulum(m=1.3, l=0.9), all_effects, integrator, dt=0.02)
    state, sensing = model.initial_state(theta, theta_dot), model.sensing(theta, theta_dot)
    for u in commands:
        state = model.advance(state, u, 0.1)
        reading, sensing = model.read(state.theta, state.theta_dot, sensing, 0.1)
    entries = [state.theta, state.theta_dot, *reading, *(v for memory in (*state.memory, *sensing) for v in memory)]
    assert {getattr(v, "dtype", type(v)) for v in entries} == {kind}


def test_numbers_come_out_in_the_order_in_which_they_went_in(all_effects):
    model = Model(RodPendulum(m=1.3, l=0.9), all_effects)
    names = tuple(reversed(model.parameters))
    numbers = model.numbers(names)
    other = Model(RodPendulum(), tuple(e.at_neutral() for e in all_effects))
    assert np.any(other.numbers(names) != numbers)
    assert np.array_equal(other.with_numbers(names, numbers).numbers(names), numbers)


def test_a_thousand_rollouts_at_once_equal_the_single_ones(all_effects, integrator):
    rng, n = np.random.default_rng(0), 1000
    model = Model(RodPendulum(m=1.3, l=0.9), all_effects, integrator, dt=0.02)
    numbers = {
        "m": rng.uniform(0.5, 2.0, n),
        "l": rng.uniform(0.5, 2.0, n),
        "viscous.b": rng.uniform(0.0, 0.1, n),
        "delay.T": rng.uniform(0.0, 0.04, n),
        "lag.T": rng.uniform(0.0, 0.1, n),
    }
    theta, theta_dot, u = rng.uniform(-3.0, 3.0, n), rng.uniform(-1.0, 1.0, n), rng.uniform(-2.0, 2.0, (n, 40))
    together = simulate(model.with_parameters(numbers), u, theta, theta_dot)
    assert together.theta.shape == (n, 41)
    for i in range(0, n, 97):
        alone = simulate(
            model.with_parameters({k: float(v[i]) for k, v in numbers.items()}), u[i], theta[i], theta_dot[i]
        )
        np.testing.assert_allclose(together.theta[i], alone.theta, rtol=1e-12)
        np.testing.assert_allclose(together.theta_dot[i], alone.theta_dot, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(together.theta_read[i], alone.theta_read, rtol=1e-12)
        np.testing.assert_allclose(together.theta_dot_read[i], alone.theta_dot_read, rtol=1e-10, atol=1e-12)


def test_shapes_of_parameters_starts_and_commands_broadcast(all_effects):
    model = Model(RodPendulum(m=1.3, l=0.9), all_effects, dt=0.02)
    masses = np.array([[0.8], [1.1]])
    run = simulate(model.with_parameters({"m": masses}), np.ones((5, 10)), 0.3, np.linspace(-1.0, 1.0, 5))
    assert run.theta.shape == (2, 5, 11) and run.u.shape == (2, 5, 10)
    alone = simulate(model.with_parameters({"m": 1.1}), np.ones(10), 0.3, -0.5)
    np.testing.assert_allclose(run.theta[1, 1], alone.theta, rtol=1e-12)


def held_signal_mean(u: np.ndarray, dt: float, T: float, a: float, b: float) -> float:
    """The mean over [a, b] of the command delayed by T: a difference of its integral, which is piecewise linear."""
    t = dt * np.arange(-100, len(u) + 1)
    integral = np.concatenate([np.zeros(101), dt * np.cumsum(u)])
    return float(np.interp(b - T, t, integral) - np.interp(a - T, t, integral)) / (b - a)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("T_lag", [0.0, 0.0003, 0.003, 0.08, 0.7])
@pytest.mark.parametrize("T_delay", [0.0, 0.0071, 0.02, 0.0537, 0.1])
def test_input_path_step_by_step_equals_the_whole_record(T_delay, T_lag, substeps):
    model = Model(RodPendulum(), (Lag(T=T_lag), Delay(T=T_delay)), RK4(substeps), dt=0.02)
    u = np.random.default_rng(1).uniform(-2.0, 2.0, 60)
    memory, stepwise = model.rest(), []
    for command in u:
        drives, memory = model.drive(float(command), memory)
        stepwise.extend(drives)
    h = model.dt / substeps
    delayed = np.array([held_signal_mean(u, model.dt, T_delay, j * h, (j + 1) * h) for j in range(60 * substeps)])
    whole, z = delayed.copy(), 0.0
    if T_lag > 0.0:
        for j, s in enumerate(delayed):
            whole[j] = s + (z - s) * T_lag / h * -math.expm1(-h / T_lag)
            z = s + (z - s) * math.exp(-h / T_lag)
    np.testing.assert_allclose(stepwise, whole, rtol=0.0, atol=1e-12)


def test_a_trajectory_is_its_steps(all_effects, integrator):
    model = Model(RodPendulum(m=1.3, l=0.9), all_effects, integrator, dt=0.02)
    u = np.random.default_rng(2).uniform(-2.0, 2.0, 200)
    run, state = simulate(model, u, 2.0, -0.5), model.initial_state(2.0, -0.5)
    for k, command in enumerate(u):
        assert (state.theta, state.theta_dot) == pytest.approx((run.theta[k], run.theta_dot[k]), rel=1e-12, abs=1e-12)
        state = model.advance(state, float(command), k * model.dt)
    np.testing.assert_allclose(run.t, 0.02 * np.arange(201))


def test_input_effects_act_by_stage_however_they_are_listed():
    u = np.random.default_rng(3).uniform(-2.0, 2.0, 100)
    lag, delay = Lag(T=0.05), Delay(T=0.033)
    one, other = (
        simulate(Model(RodPendulum(), effects, dt=0.02), u, math.pi, 0.0) for effects in ((lag, delay), (delay, lag))
    )
    np.testing.assert_array_equal(one.theta, other.theta)


def test_what_looks_ahead_is_handed_the_next_row_and_primed_before_the_first():
    u = np.random.default_rng(4).uniform(-2.0, 2.0, 30)
    model = Model(RodPendulum(), (Stamp(), Lag(T=0.05)), dt=0.02)
    assert model.ahead == 1 and Model(RodPendulum(), (Delay(),)).ahead == 0
    without = Model(RodPendulum(), (Lag(T=0.05),), dt=0.02)
    np.testing.assert_allclose(list(model.drives(u)), list(without.drives(u)), rtol=0.0, atol=1e-15)
    early = model.with_parameters({"stamp.s": -1.0})
    np.testing.assert_allclose(list(early.drives(u))[:-1], list(without.drives(u))[1:], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("T", [0.0, 0.0071, 0.02, 0.1])
def test_a_whole_record_at_once_equals_interval_by_interval(T, substeps, all_effects):
    u = np.random.default_rng(5).uniform(-2.0, 2.0, 80)
    late = {"delay": Delay(T=T, longest=0.1), "lag": Lag(T=T), "stamp": Stamp(s=8.0 * T - 0.6)}
    for left_out in ("delay", "stamp"):
        others = [e for e in all_effects if e.name not in late]
        path = (*others, *(e for name, e in late.items() if name != left_out))
        model = Model(RodPendulum(), path, RK4(substeps), dt=0.02)
        np.testing.assert_allclose(model.drive_record(u), list(model.drives(u.tolist())), rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(model.drive_record(np.stack([0.5 * u, u]))[1], model.drive_record(u))


def test_a_model_steps_finely_if_nothing_else_is_asked_for():
    for dt, substeps in ((0.002, 2), (0.02, 2), (0.05, 2), (0.088, 4), (1.0, 40), (1000.0, 200)):
        assert Model(RodPendulum(), dt=dt).integrator == RK4(substeps=substeps)
    coarse = Model(RodPendulum(), integrator=RK4(substeps=1), dt=1.0)
    assert coarse.integrator == RK4(substeps=1) == replace(coarse, dt=2.0).integrator
