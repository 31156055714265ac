"""Integrators: order of convergence, energy, the speed clip, and dry friction against exact stick-slip."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sysid import (
    RK4,
    Coulomb,
    DryFriction,
    GeneralJoint,
    Joint,
    LinearAxis,
    LoadFriction,
    Model,
    Periodic,
    RodPendulum,
    SemiImplicitEuler,
    Stribeck,
    TorqueBias,
    Viscous,
    simulate,
)
from sysid.physics.integrators import stick_slip
from sysid.planning.excitation import multisine
from tests.sysid.planted import energy

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


def test_semi_implicit_euler_is_symplectic_its_energy_error_does_not_grow(pendulum):
    run = simulate(Model(pendulum, (), SemiImplicitEuler(), 0.02), np.zeros(10_000), 1.0, 0.0)
    off = np.abs(energy(pendulum, run.theta, run.theta_dot) - energy(pendulum, np.array(1.0), np.array(0.0)))
    assert np.max(off[5_000:]) < 1.05 * np.max(off[:1_000])


def test_speed_is_clipped_before_the_angle_moves():
    model = Model(RodPendulum(), (), SemiImplicitEuler(theta_dot_max=2.0), dt=0.05)
    state = model.advance(model.initial_state(1.0, 1.99), 5.0)
    assert state.theta_dot == 2.0 and state.theta == 1.0 + 0.05 * 2.0


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("v", [1.0, -0.37])
def test_a_sliding_block_stops_in_v_squared_over_two_a_and_stays(v, substeps):
    m, tau_c = 0.8, 0.3
    run = simulate(Model(LinearAxis(m=m), (Coulomb(tau_c=tau_c),), RK4(substeps), 0.05), np.zeros(200), 0.5, v)
    assert run.theta[-1] - 0.5 == pytest.approx(v * abs(v) / (2.0 * tau_c / m), rel=1e-12)
    after = run.t > abs(v) * m / tau_c
    assert np.all(run.theta_dot[after] == 0.0) and np.ptp(run.theta[after]) == 0.0
    np.testing.assert_allclose(run.theta_dot[~after], v - math.copysign(tau_c / m, v) * run.t[~after], atol=1e-13)


def test_a_damped_block_stops_where_it_should_to_second_order():
    m, tau_c, b, v = 0.8, 0.3, 0.5, 1.0
    expected = m / b * (v - tau_c / b * math.log(1.0 + b * v / tau_c))
    errors, substeps = [], np.array([1, 2, 4, 8])
    for s in substeps:
        model = Model(LinearAxis(m=m), (Coulomb(tau_c=tau_c), Viscous(b=b)), RK4(int(s)), 0.1)
        errors.append(abs(simulate(model, np.zeros(40), 0.0, v).theta[-1] - expected))
    assert slope(1.0 / substeps, errors) > 1.8


DRY = [Coulomb(tau_c=0.12), Stribeck(tau_c=0.08, excess=0.06, v_s=0.1), LoadFriction(mu=0.15)]


@pytest.mark.parametrize("integrator", [SemiImplicitEuler(), RK4(2), RK4(3)])
def test_below_its_limit_friction_holds_for_ever_without_creep(integrator):
    u = 0.18 * np.sin(0.3 * np.arange(3000))
    hum = Periodic(a=0.1, b=0.05, f=3.3)
    model = Model(GeneralJoint(J=0.05, G=0.8), (Coulomb(tau_c=0.5), hum, Viscous(b=0.1)), integrator, 0.02)
    run = simulate(model, u, math.pi - 0.2, 0.0)
    assert np.all(run.theta == run.theta[0]) and np.all(run.theta_dot == 0.0)


@pytest.mark.parametrize("friction", DRY[:2], ids=lambda e: e.name)
@pytest.mark.parametrize("integrator", [SemiImplicitEuler(), RK4(1), RK4(4)])
def test_it_breaks_away_above_the_static_limit_and_not_below(friction, integrator):
    static = float(friction.limits(Joint(0.0, 0.0, 0.0, 0.0, LinearAxis(), float))[0])
    for sign in (1.0, -1.0):
        for force, moves in ((0.999 * static, False), (1.001 * static, True)):
            model = Model(LinearAxis(m=0.05), (friction, Viscous(b=0.1)), integrator, 0.02)
            run = simulate(model, np.full(10, sign * force), 0.0, 0.0)
            assert bool(sign * run.theta_dot[-1] > 0.0) == moves
            assert moves or run.theta[-1] == 0.0


def stick_slip_reference(model: Model, friction: DryFriction, u: np.ndarray, theta: float) -> np.ndarray:
    """Angles (N+1,) from rest by events: slide to the next zero of the speed, then stay or leave under the load."""
    y, path = np.array([theta, 0.0]), [theta]

    def smooth(y, tau):
        return model.acceleration(y[0], y[1], 0.0, tau) * model.inertia()

    def limit(y, tau):
        load = model.plant.gravity_torque(y[0])
        return float(friction.limits(Joint(y[0], y[1], 0.0, tau, model.plant, lambda: load))[0])

    def stop(t, y):
        return y[1]

    stop.terminal = True
    for tau in u:
        t = 0.0
        while t < model.dt:
            if y[1] == 0.0 and abs(smooth(y, tau)) <= limit(y, tau):
                break
            sign = np.sign(y[1] or smooth(y, tau))
            stop.direction = -sign
            solved = solve_ivp(
                lambda t, y, s=sign, tau=tau: [y[1], (smooth(y, tau) - s * limit(y, tau)) / model.inertia()],
                (t, model.dt),
                y,
                events=stop,
                rtol=1e-9,
                atol=1e-11,
            )
            t, y = solved.t[-1], solved.y[:, -1]
            if solved.status == 1:
                y = np.array([y[0], 0.0])
        path.append(y[0])
    return np.array(path)


@pytest.mark.parametrize("friction", DRY, ids=lambda e: e.name)
def test_stick_slip_under_a_multisine_converges_to_the_event_driven_solution(friction):
    joint = GeneralJoint(J=0.05, G=0.8)
    u = multisine(np.random.default_rng(1), 250, 0.02, 0.6, 3.0)
    truth = stick_slip_reference(Model(joint, (Viscous(b=0.02),), dt=0.02), friction, u, math.pi)
    assert np.ptp(truth) > 0.3
    substeps, worst = np.array([1, 2, 4, 8]), []
    for s in substeps:
        run = simulate(Model(joint, (Viscous(b=0.02), friction), RK4(int(s)), 0.02), u, math.pi, 0.0)
        worst.append(float(np.max(np.abs(run.theta - truth))))
    assert worst[2] < 2e-4, "substeps of 5 ms"
    assert slope(1.0 / substeps, worst) > 1.4


def test_stick_slip_is_exact_for_constant_torques():
    """Against a crawl of 20,000 steps, from every mix of speed, acceleration and limits."""
    rng, h, n = np.random.default_rng(4), 0.3, 20_000
    v, a = rng.uniform(-1.0, 1.0, (2, 200)) * np.array([[0.3], [3.0]])
    plus, minus = rng.uniform(0.0, 3.0, (2, 200))
    v[:40] = 0.0
    speed, moved, dt = v.copy(), np.zeros(200), h / n
    for _ in range(n):
        free = speed + dt * a
        after = free - np.where(free > 0.0, np.minimum(free, dt * plus), np.maximum(free, -dt * minus))
        speed, moved = after, moved + 0.5 * dt * (speed + after)
    exact, path, moving = stick_slip(v, a, plus, minus, h)
    np.testing.assert_allclose(exact, speed, atol=1e-3)
    np.testing.assert_allclose(path, moved, atol=1e-3)
    assert np.all((moving >= 0.0) & (moving <= 1.0 + 1e-12))
    stays = (v == 0.0) & (a <= plus) & (a >= -minus)
    assert np.any(stays) and np.all(exact[stays] == 0.0) and np.all(path[stays] == 0.0) and np.all(moving[stays] == 0.0)
