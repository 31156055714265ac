"""Integrators: order of convergence, energy, the speed clip."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sysid import (
    RK4,
    InvalidInput,
    Model,
    RodPendulum,
    SemiImplicitEuler,
    TorqueBias,
    Viscous,
    simulate,
)

ORDERS = [(SemiImplicitEuler, 1), (RK4, 4)]
DT, N = 0.1, 20
TORQUE = np.sin(1.5 * DT * np.arange(N))
MODEL = Model(RodPendulum(m=1.1, l=0.8), (Viscous(b=0.05), TorqueBias(tau_0=0.3)), dt=DT)


def reference(model: Model, u: np.ndarray, theta: float, theta_dot: float) -> np.ndarray:
    """The end state, each interval solved to 1e-13 under its held torque."""
    y = np.array([theta, theta_dot])
    for k, command in enumerate(u):
        solved = solve_ivp(
            lambda t, y, tau=command: [y[1], model.acceleration(y[0], y[1], t, tau)],
            (k * model.dt, (k + 1) * model.dt),
            y,
            method="DOP853",
            rtol=1e-13,
            atol=1e-13,
        )
        y = solved.y[:, -1]
    return y


def slope(h: np.ndarray, errors: list[float]) -> float:
    return float(np.polyfit(np.log(h), np.log(errors), 1)[0])


@pytest.mark.parametrize(("integrator", "order"), ORDERS)
def test_order_of_convergence(integrator, order, plant):
    model = Model(plant, MODEL.effects, dt=DT)
    truth = reference(model, TORQUE, 2.5, 0.0)
    substeps = np.array([4, 8, 16, 32])
    errors = []
    for s in substeps:
        run = simulate(Model(plant, MODEL.effects, integrator(substeps=int(s)), DT), TORQUE, 2.5, 0.0)
        errors.append(float(np.hypot(run.theta[-1] - truth[0], run.theta_dot[-1] - truth[1])))
    assert slope(1.0 / substeps, errors) == pytest.approx(order, abs=0.15)


def energy(plant: object, theta: np.ndarray, theta_dot: np.ndarray) -> np.ndarray:
    """1/2 J theta_dot^2 + G cos(theta), G the largest gravity torque."""
    return 0.5 * plant.inertia() * theta_dot**2 + plant.gravity_torque(0.5 * math.pi) * np.cos(theta)


@pytest.mark.parametrize(("integrator", "order"), ORDERS)
def test_free_swing_keeps_its_energy_to_the_order(integrator, order, plant):
    substeps, worst = np.array([1, 2, 4, 8]), []
    for s in substeps:
        run = simulate(Model(plant, (), integrator(substeps=int(s)), 0.02), np.zeros(250), 1.0, 0.0)
        e = energy(plant, run.theta, run.theta_dot)
        worst.append(float(np.max(np.abs(e - e[0]))))
    assert slope(1.0 / substeps, worst) > order - 0.1


def test_semi_implicit_euler_is_symplectic_its_energy_error_does_not_grow(plant):
    run = simulate(Model(plant, (), SemiImplicitEuler(), 0.02), np.zeros(10_000), 1.0, 0.0)
    off = np.abs(energy(plant, run.theta, run.theta_dot) - energy(plant, np.array(1.0), np.array(0.0)))
    assert np.max(off[5_000:]) < 1.05 * np.max(off[:1_000])


def test_speed_is_clipped_before_the_angle_moves():
    model = Model(RodPendulum(), (), SemiImplicitEuler(theta_dot_max=2.0), dt=0.05)
    state = model.advance(model.initial_state(1.0, 1.99), 5.0)
    assert state.theta_dot == 2.0 and state.theta == 1.0 + 0.05 * 2.0


@pytest.mark.parametrize("integrator", [SemiImplicitEuler, RK4])
def test_substeps_below_one_are_refused(integrator):
    with pytest.raises(InvalidInput, match="substeps = 0: expected a whole number >= 1"):
        integrator(substeps=0)


def test_time_reaches_the_acceleration_at_every_stage():
    """theta_ddot = t^3 has the exact solution t^4 / 4, which fourth order meets exactly."""
    rk4 = RK4(substeps=2)
    _, speed = rk4.advance(lambda theta, theta_dot, t, drive: t**3, 0.0, 0.0, 1.0, (0.0, 0.0), 1.0)
    assert speed == pytest.approx((2.0**4 - 1.0) / 4.0, rel=1e-13)
