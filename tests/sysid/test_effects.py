"""Effects: neutral values, dissipation, the exact input path, and classes of the user's own."""

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
import torch

import sysid
from sysid import (
    CATALOGUE,
    RK4,
    Coulomb,
    Delay,
    InputEffect,
    InvalidInput,
    Joint,
    JointEffect,
    Lag,
    Model,
    QuadraticDrag,
    RodPendulum,
    Viscous,
    parameter,
    register,
    simulate,
)
from sysid.excitation import uniform_noise

ROD = RodPendulum(m=1.3, l=0.9)
FRICTIONS = [Viscous(b=0.1), Coulomb(tau_c=0.2), QuadraticDrag(c=0.05)]


def drives(model, u):
    """The drive torques of a record, (N, substeps)."""
    memory, found = model.rest(), []
    for command in u:
        drive, memory = model.drive(float(command), memory)
        found.append(drive)
    return np.array(found)


def test_every_effect_of_the_catalogue_is_tested(all_effects):
    ours = {name for name, kind in CATALOGUE.items() if kind.__module__.startswith("sysid.")}
    assert ours == {e.name for e in all_effects}


def test_neutral_changes_nothing(plant, effect, integrator):
    u = uniform_noise(np.random.default_rng(0), 300, 2.0)
    without = simulate(Model(plant, (), integrator, 0.02), u, 2.0, 0.5)
    neutral = simulate(Model(plant, (effect.at_neutral(),), integrator, 0.02), u, 2.0, 0.5)
    np.testing.assert_allclose(neutral.theta, without.theta, rtol=1e-10)
    acting = simulate(Model(plant, (effect,), integrator, 0.02), u, 2.0, 0.5)
    assert np.max(np.abs(acting.theta - without.theta)) > 1e-3


def test_effects_are_made_neutral_by_name(effect):
    named, neutral = sysid.effect(effect.name).parameters, effect.at_neutral().parameters
    assert {k: p.value for k, p in named.items()} == {k: p.value for k, p in neutral.items()}


@pytest.mark.parametrize("friction", FRICTIONS, ids=lambda e: e.name)
def test_friction_only_dissipates(plant, friction):
    run = simulate(Model(plant, (friction,), RK4(substeps=8), 0.02), np.zeros(400), 1.0, 0.0)
    swing = plant.gravity_torque(0.5 * math.pi)
    e = 0.5 * plant.inertia() * run.theta_dot**2 + swing * np.cos(run.theta)
    assert np.all(np.diff(e) < 1e-9)
    assert e[-1] < e[0] - 0.1 * swing


@pytest.mark.parametrize("friction", FRICTIONS, ids=lambda e: e.name)
def test_friction_opposes_motion_and_is_odd(plant, friction):
    theta_dot = np.linspace(-5.0, 5.0, 101)
    torque = friction.torque(Joint(0.0, theta_dot, 0.0, 0.0, 0.0, plant))
    assert np.all(torque * theta_dot <= 0.0)
    np.testing.assert_allclose(torque, -torque[::-1], atol=1e-15)


def test_viscous_friction_takes_the_power_b_theta_dot_squared():
    run = simulate(Model(ROD, (Viscous(b=0.1),), RK4(substeps=4), 0.01), np.zeros(400), 1.0, 0.0)
    e = 0.5 * ROD.inertia() * run.theta_dot**2 + ROD.gravity_torque(0.5 * math.pi) * np.cos(run.theta)
    assert e[-1] - e[0] == pytest.approx(-0.1 * np.trapezoid(run.theta_dot**2, run.t), rel=1e-4)


@pytest.mark.parametrize("k", [0, 1, 3, 5])
def test_a_delay_of_whole_samples_is_the_shifted_command(k, integrator):
    u = uniform_noise(np.random.default_rng(1), 100, 2.0)
    shifted = np.concatenate([np.zeros(k), u[: 100 - k]])
    delayed = simulate(Model(ROD, (Delay(T=k * 0.02, longest=0.1),), integrator, 0.02), u, 2.0, 0.0)
    undelayed = simulate(Model(ROD, (), integrator, 0.02), shifted, 2.0, 0.0)
    np.testing.assert_allclose(delayed.theta, undelayed.theta, rtol=1e-10)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("T", [0.0, 0.0041, 0.01, 0.0333, 0.06])
def test_a_delay_conserves_the_commands_integral(T, substeps):
    u = np.concatenate([uniform_noise(np.random.default_rng(2), 50, 2.0), np.zeros(4)])
    drive = drives(Model(ROD, (Delay(T=T, longest=0.06),), RK4(substeps=substeps), 0.02), u)
    assert np.sum(drive) / substeps == pytest.approx(np.sum(u), rel=1e-12)


@pytest.mark.parametrize("T", [0.0003, 0.02, 0.7])
def test_lag_has_the_exact_step_response(T):
    lag, dt, s = Lag(T=T), 0.02, 1.7
    memory, t, means = lag.rest(dt), 0.0, []
    for k in range(1, 51):
        signal, memory = lag.advance((s, s), memory, dt)
        t = k * dt
        assert memory[0] == pytest.approx(s * -math.expm1(-t / T), rel=1e-11)
        means.extend(signal)
    # the integral of the response is  s (t - T (1 - exp(-t/T)))
    assert np.sum(means) * dt / 2 == pytest.approx(s * (t + T * math.expm1(-t / T)), rel=1e-11)


@pytest.mark.parametrize("T", [0.0, 1e-12, 0.05])
def test_lag_and_delay_have_unit_gain_at_rest(T):
    drive = drives(Model(ROD, (Delay(T=min(T, 0.03)), Lag(T=T)), RK4(substeps=2), 0.02), np.full(200, 1.3))
    np.testing.assert_allclose(drive[-1], 1.3, rtol=1e-12)


@pytest.mark.parametrize("T", [0.0, 1e-14, 1e-9, 1e-4])
def test_lag_is_safe_as_its_time_constant_vanishes(T):
    """The drive tends to the command and its derivative to (z - s) / h, in both differentiating back ends."""
    h, s, z = 0.02, 1.3, 0.4
    tensor = torch.tensor(T, dtype=torch.float64, requires_grad=True)
    (drive,), _ = Lag(T=tensor).advance((s,), (z,), h)
    drive.backward()
    symbol = ca.SX.sym("T")
    (expression,), _ = Lag(T=symbol).advance((s,), (z,), h)
    value, slope = ca.Function("f", [symbol], [expression, ca.jacobian(expression, symbol)])(T)
    expected = s + (z - s) * T / h
    assert drive.item() == pytest.approx(expected, rel=1e-12) and float(value) == pytest.approx(expected, rel=1e-12)
    assert tensor.grad.item() == pytest.approx((z - s) / h, rel=1e-9)
    assert float(slope) == pytest.approx((z - s) / h, rel=1e-9)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_at_the_neutral_value_are_finite(effect, dtype):
    neutral = effect.at_neutral()
    numbers = {k: torch.tensor(p.value, dtype=dtype, requires_grad=True) for k, p in neutral.parameters.items()}
    model = Model(ROD, (neutral.with_parameters(numbers),), dt=0.02)
    state = model.initial_state(torch.tensor(2.0, dtype=dtype), torch.tensor(0.0, dtype=dtype))
    for k in range(10):
        state = model.advance(state, 1.0 + 0.1 * k, 0.02 * k)
    for slope in torch.autograd.grad(state.theta, list(numbers.values())):
        assert torch.isfinite(slope)


def test_a_static_input_effect_acts_before_delay_and_lag(catalogue, agree):
    @register
    @dataclass(frozen=True, eq=False)
    class CheapDriver(InputEffect):
        """drive = k u - 0.1 u^3."""

        k: float = parameter(1.0, unit="1", bounds=(0.0, 2.0))

        def advance(self, signal, memory, dt):
            return tuple(self.k * s - 0.1 * s * s * s for s in signal), memory

    u = uniform_noise(np.random.default_rng(4), 100, 1.5)
    path = (Lag(T=0.05), Delay(T=0.033), CheapDriver(k=0.8))
    found = drives(Model(ROD, path, dt=0.02), u)
    np.testing.assert_allclose(found, drives(Model(ROD, path[:2], dt=0.02), 0.8 * u - 0.1 * u**3), atol=1e-12)
    agree(Model(ROD, path, dt=0.02), steps=100)


def test_a_users_own_class_joins_the_catalogue_and_every_back_end(catalogue, agree):
    @register
    @dataclass(frozen=True, eq=False)
    class RubberBand(JointEffect):
        """tau = -k sin(theta - theta_0), with a rotor of inertia J_r."""

        k: float = parameter(0.0, unit="N m", bounds=(0.0, 5.0), neutral=0.0)
        theta_0: float = parameter(0.3, unit="rad")
        J_r: float = parameter(0.0, unit="kg m^2", bounds=(0.0, 1.0), neutral=0.0)

        def inertia(self):
            return self.J_r

        def torque(self, joint):
            return -self.k * sysid.ops.sin(joint.theta - self.theta_0)

    band = sysid.effect("rubber_band", k=0.9, J_r=0.05)
    model = Model(ROD, (band, Viscous(b=0.1)), dt=0.02)
    assert list(model.parameters)[3:6] == ["rubber_band.k", "rubber_band.theta_0", "rubber_band.J_r"]
    assert (band.at_neutral().k, band.at_neutral().theta_0) == (0.0, 0.3)
    agree(model)
    with pytest.raises(InvalidInput, match=r"expected one of coulomb, .*rubber_band, .*viscous"):
        sysid.effect("rubber")


def test_a_taken_name_is_refused(catalogue):
    class Viscous(JointEffect):
        def torque(self, joint):
            return 0.0

    with pytest.raises(InvalidInput, match="named 'viscous' is in the catalogue: give the class another name"):
        register(Viscous)
    assert catalogue["viscous"] is sysid.Viscous
    assert register(sysid.Viscous) is sysid.Viscous


def test_friction_sees_the_load_and_other_effects_do_not(catalogue):
    seen = {}

    @dataclass(frozen=True, eq=False)
    class Push(JointEffect):
        def torque(self, joint):
            seen["push"] = joint.load
            return 0.5

    @dataclass(frozen=True, eq=False)
    class Grip(JointEffect):
        friction = True

        def torque(self, joint):
            seen["grip"] = joint.load
            return -0.1

    model = Model(ROD, (Grip(), Push()), dt=0.02)
    a = model.acceleration(1.0, 0.0, 0.0, 0.25)
    load = ROD.gravity_torque(1.0) + 0.25 + 0.5
    assert seen["push"] == 0.0 and seen["grip"] == pytest.approx(load)
    assert a == pytest.approx((load - 0.1) / ROD.inertia())
