"""The LQR is the best linear feedback on the linearised step, and keeps what it promises there."""

import dataclasses

import numpy as np
import pytest

from policies.control.lqr import design_lqr
from policies.evaluation import evaluate
from study.paper.protocol import paper_model
from sysid import RK4, Delay, InvalidInput, State, Tilt, TorqueBias, Viscous

HIDDEN = paper_model(m=2.0, l=1.5)
MODELS = {
    "hidden": HIDDEN,
    "light": paper_model(m=0.3, l=0.3),
    "heavy": paper_model(m=3.0, l=3.0),
    "rk4": dataclasses.replace(HIDDEN, integrator=RK4(substeps=2)),
    "friction": HIDDEN.with_effect(Viscous(b=0.5)),
    "bias": HIDDEN.with_effect(TorqueBias(tau_0=0.7)),
}


@pytest.fixture(params=MODELS)
def model(request):
    return MODELS[request.param]


def test_linearisation_is_the_steps_derivative(model):
    lqr, h = design_lqr(model), 1e-6

    def step(theta, theta_dot, u):
        return np.array(model.advance(State(theta, theta_dot), lqr.u_0 + u)[:2])

    numeric = np.column_stack([(step(*d) - step(*-d)) / (2.0 * h) for d in h * np.eye(3)])
    np.testing.assert_allclose(np.column_stack([lqr.A, lqr.B]), numeric, atol=1e-8)


def test_weights_are_the_papers():
    lqr = design_lqr(HIDDEN)
    np.testing.assert_allclose(lqr.Q, np.diag([1.0, 0.1]), atol=1e-15)
    np.testing.assert_allclose(lqr.R, [[0.001]])
    np.testing.assert_allclose(lqr.N, 0.0, atol=1e-15)


def test_riccati_equation_holds(model):
    q = design_lqr(model)
    gain = np.linalg.solve(q.R + q.B.T @ q.S @ q.B, q.B.T @ q.S @ q.A + q.N.T)
    np.testing.assert_allclose(q.K, gain, rtol=1e-8)
    riccati = q.A.T @ q.S @ q.A - (q.A.T @ q.S @ q.B + q.N) @ gain + q.Q
    np.testing.assert_allclose(riccati, q.S, rtol=1e-8)
    assert np.all(np.linalg.eigvalsh(q.S) > 0.0)


def test_closed_loop_is_stable(model):
    assert np.all(np.abs(design_lqr(model).poles) < 1.0)


def test_promised_cost_is_what_the_pendulum_pays_near_the_upright():
    lqr = design_lqr(HIDDEN)
    theta, theta_dot = np.array([0.02, -0.01, 0.0]), np.array([0.0, 0.05, 0.08])
    paid = -evaluate(lqr, HIDDEN, theta, theta_dot).returns
    np.testing.assert_allclose(paid, lqr.cost_to_go(theta, theta_dot), rtol=1e-3)


def test_command_is_saturated_and_the_same_after_a_turn():
    lqr, rng = design_lqr(HIDDEN), np.random.default_rng(0)
    theta, theta_dot = rng.uniform(-3.0, 3.0, 200), rng.uniform(-8.0, 8.0, 200)
    u = lqr(State(theta, theta_dot))
    assert np.max(np.abs(u)) == HIDDEN.u_max
    np.testing.assert_allclose(lqr(State(theta + 4.0 * np.pi, theta_dot)), u, atol=1e-10)


def test_it_holds_the_upright_against_a_torque_bias():
    model = MODELS["bias"]
    lqr = design_lqr(model)
    assert lqr.u_0 == pytest.approx(-0.7)
    state = State(0.03, 0.0)
    for _ in range(200):
        state = model.advance(state, lqr(state))
    assert abs(state.theta) < 1e-6 and abs(state.theta_dot) < 1e-6


def test_it_holds_a_tilted_base():
    """The torque that does is found by Newton's method; what a single step leaves is no drift."""
    model = HIDDEN.with_effect(Tilt(alpha=0.05))
    lqr = design_lqr(model)
    assert lqr.u_0 == pytest.approx(-float(model.acceleration(0.0, 0.0, 0.0, 0.0) * model.inertia()), rel=1e-6)
    after = model.advance(State(0.0, 0.0), lqr(State(0.0, 0.0)))
    assert abs(after.theta) < 1e-12 and abs(after.theta_dot) < 1e-12


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        (HIDDEN.with_effect(Delay()), "input effects \\(delay\\)"),
        (HIDDEN.with_effect(TorqueBias(tau_0=3.0)), "equilibrium"),
        (HIDDEN.with_parameters({"m": np.array([1.0, 2.0])}), "one number"),
    ],
)
def test_it_says_why_a_model_has_no_lqr(model, reason):
    with pytest.raises(InvalidInput, match=reason):
        design_lqr(model)
