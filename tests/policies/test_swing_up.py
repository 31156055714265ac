"""The swing-up brings up every pendulum that can be brought up, within its torque, by pumping energy."""

import dataclasses
import math

import numpy as np
import pytest

from policies.control.lqr import design_lqr
from policies.control.swing_up import design_swing_up
from policies.evaluation import evaluate, start_states
from study.paper.protocol import paper_model
from sysid import RK4, Delay, GeneralJoint, InvalidInput, SemiImplicitEuler, State, Viscous

HIDDEN = paper_model(m=2.0, l=1.5)


def upright(policy, model, steps, start):
    """Whether each episode is upright at the end, and the largest command on the way."""
    state, largest = model.initial_state(*start), 0.0
    for k in range(steps):
        u = policy(state, k * model.dt)
        largest = max(largest, np.max(np.abs(u)))
        state = model.advance(state, u)
    return np.cos(state.theta) > 0.999, largest


@pytest.mark.parametrize(
    ("m", "l", "steps"),
    [
        (0.3, 0.3, 60),
        (0.3, 3.0, 200),
        (2.0, 1.5, 300),
        (3.0, 0.8, 200),
        (3.0, 3.0, 1000),
    ],
)
def test_it_brings_the_pendulum_up_from_everywhere(m, l, steps):  # noqa: E741
    model = paper_model(m=m, l=l)
    up, largest = upright(design_swing_up(model), model, steps, start_states(seed=1, episodes=25))
    assert up.all()
    assert largest <= model.u_max


def test_it_starts_from_hanging_at_rest_and_copes_with_friction_and_another_integrator():
    model = dataclasses.replace(HIDDEN, integrator=RK4(substeps=2)).with_effect(Viscous(b=0.05))
    up, _ = upright(design_swing_up(model), model, 500, (np.array([math.pi]), np.array([0.0])))
    assert up.all()


def test_a_misjudged_mass_is_forgiven():
    """Energy by inertia depends on g / l alone. A misjudged length is not forgiven: the target is wrong."""
    design = paper_model(m=2.6, l=1.5)
    up, _ = upright(design_swing_up(design), HIDDEN, 400, start_states(seed=2))
    assert up.all()


def test_energy_is_kept_without_torque_and_never_falls_while_pumping():
    fine = dataclasses.replace(HIDDEN, integrator=RK4(), dt=0.002)
    policy = design_swing_up(fine)
    free = pumped = fine.initial_state(np.array([2.5, math.pi, -2.0]), np.array([0.5, 0.0, 1.0]))
    start = policy.energy(free.theta, free.theta_dot)
    for _ in range(10_000):
        before = policy.energy(pumped.theta, pumped.theta_dot)
        free, pumped = fine.advance(free, 0.0), fine.advance(pumped, policy.pump(pumped))
        after = policy.energy(pumped.theta, pumped.theta_dot)
        assert np.all(np.abs(after) < np.abs(before) + 1e-4)  # a step across a turn pushes the wrong way
    np.testing.assert_allclose(policy.energy(free.theta, free.theta_dot), start, atol=1e-6)
    np.testing.assert_allclose(after, 0.0, atol=0.01)


def test_energy_is_zero_upright_and_twice_the_gravity_torque_below_it_hanging():
    policy = design_swing_up(HIDDEN)
    assert policy.energy(0.0, 0.0) == 0.0
    assert policy.energy(math.pi, 0.0) == pytest.approx(-2.0 * 2.0 * 10.0 * 0.75)  # -2 m g l / 2


def test_what_it_says_the_lqr_catches_the_lqr_catches():
    policy, lqr, rng = design_swing_up(HIDDEN), design_lqr(HIDDEN), np.random.default_rng(0)
    start = HIDDEN.initial_state(rng.uniform(-1.0, 1.0, 400), rng.uniform(-3.0, 3.0, 400))
    promised = policy.catches(start)
    up, _ = upright(lqr, HIDDEN, 100, start[:2])
    assert up[promised].all()
    assert 0.05 < promised.mean() < 0.95


def test_it_is_worth_far_more_than_the_lqr_alone():
    starts = [np.concatenate(x) for x in zip(*(start_states(seed) for seed in range(10)), strict=True)]
    swing_up = evaluate(design_swing_up(HIDDEN), HIDDEN, *starts).mean
    lqr = evaluate(design_lqr(HIDDEN), HIDDEN, *starts).mean
    assert lqr == pytest.approx(-964.0, abs=1.0)
    assert swing_up > -336.0  # the optimum is -330.7


@pytest.mark.parametrize(
    ("model", "reason"),
    [
        (HIDDEN.with_effect(Delay()), "input effects"),
        (dataclasses.replace(HIDDEN, u_max=math.inf), "u_max"),
        (dataclasses.replace(HIDDEN, plant=GeneralJoint(J=1.0, G=0.0)), "G > 0"),
    ],
)
def test_it_says_why_a_model_has_no_swing_up(model, reason):
    with pytest.raises(InvalidInput, match=reason):
        design_swing_up(model)


def test_the_speed_limit_and_not_the_swing_up_keeps_short_heavy_rods_down():
    """From the bottom at 8 rad/s, J 8^2 / 2 + u_max phi < G (1 - cos phi) before phi reaches the top."""
    phi, model = np.linspace(0.0, math.pi, 200), paper_model(m=3.0, l=0.5)
    policy = design_swing_up(model)
    assert np.any(0.5 * policy.J * 64.0 + model.u_max * phi < policy.G * (1.0 - np.cos(phi)))
    hanging = (np.array([math.pi]), np.array([0.0]))
    assert not upright(policy, model, 600, hanging)[0].any()
    free = dataclasses.replace(model, integrator=SemiImplicitEuler())
    assert upright(design_swing_up(free), free, 600, hanging)[0].all()


def test_one_state_or_many_give_the_same_command():
    policy, (theta, theta_dot) = design_swing_up(HIDDEN), start_states(seed=4, episodes=6)
    many = policy(State(theta, theta_dot))
    np.testing.assert_array_equal(many, [float(policy(State(a, b))) for a, b in zip(theta, theta_dot, strict=True)])
