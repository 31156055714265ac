"""Plants: their equations, and the combinations of numbers that are the same plant."""

import math

import gymnasium
import numpy as np
import pytest

from study.paper.protocol import paper_model
from sysid import CATALOGUE, RK4, GeneralJoint, LinearAxis, Model, PointMassPendulum, RodPendulum, simulate


@pytest.mark.parametrize(("m", "l"), [(1.0, 1.0), (2.0, 1.5), (0.4, 0.7)])
def test_rod_is_gymnasiums_pendulum_step_for_step(m, l):  # noqa: E741
    env = gymnasium.make("Pendulum-v1").unwrapped
    env.m, env.l = m, l
    env.reset(seed=3)
    model = paper_model(m, l)
    start = np.array(env.state)
    u = np.random.default_rng(0).uniform(-2.0, 2.0, 200)
    states = [start]
    for command in u:
        env.step(np.array([command]))
        states.append(np.array(env.state))
    run = simulate(model, u, *start)
    np.testing.assert_allclose(np.stack([run.theta, run.theta_dot], axis=1), states, rtol=1e-9, atol=1e-11)


def test_gravity_pulls_towards_hanging(pendulum):
    theta = np.linspace(0.05, math.pi - 0.05, 50)
    assert np.all(pendulum.gravity_torque(theta) > 0.0)
    np.testing.assert_allclose(pendulum.gravity_torque(-theta), -pendulum.gravity_torque(theta))
    np.testing.assert_allclose(
        pendulum.gravity_torque(theta + 2.0 * math.pi), pendulum.gravity_torque(theta), atol=1e-12
    )


def test_small_swings_have_the_textbook_period(pendulum):
    model = Model(pendulum, integrator=RK4(substeps=4), dt=0.01)
    omega = math.sqrt(pendulum.gravity_torque(0.5 * math.pi) / pendulum.inertia())
    run = simulate(model, np.zeros(400), math.pi + 1e-4, 0.0)
    np.testing.assert_allclose(run.theta - math.pi, 1e-4 * np.cos(omega * run.t), atol=1e-10)


@pytest.mark.parametrize("plant", [RodPendulum(m=1.3, l=0.9), PointMassPendulum(m=0.7, l=0.6)], ids=["rod", "point"])
def test_every_pendulum_is_a_general_joint(plant):
    joint = GeneralJoint(J=plant.inertia(), G=plant.gravity_torque(0.5 * math.pi))
    u = np.random.default_rng(1).uniform(-2.0, 2.0, 200)
    one, other = (simulate(Model(p, dt=0.02), u, 2.0, 0.0) for p in (plant, joint))
    np.testing.assert_allclose(one.theta, other.theta, rtol=1e-10)


def test_an_axis_moves_by_half_f_over_m_t_squared():
    run = simulate(Model(LinearAxis(m=2.5), dt=0.01), np.full(100, 5.0), 0.2, -0.3)
    np.testing.assert_allclose(run.theta, 0.2 - 0.3 * run.t + 0.5 * 2.0 * run.t**2, atol=1e-13)
    np.testing.assert_allclose(run.theta_dot, -0.3 + 2.0 * run.t, atol=1e-13)


@pytest.mark.parametrize(
    ("turning", "sliding"),
    [
        ("N m", "N"),
        ("N m s/rad", "N s/m"),
        ("N m s^2/rad^2", "N s^2/m^2"),
        ("rad/s", "m/s"),
        ("kg m^2", "kg"),
        ("m/s^2", "m/s^2"),
        ("samples", "samples"),
    ],
)
def test_an_axis_is_told_in_metres_and_newtons(turning, sliding):
    assert LinearAxis().unit(turning) == sliding
    assert all(p.unit(turning) == turning for p in (RodPendulum(), GeneralJoint()))


def test_a_models_parameters_have_the_units_of_its_plant():
    effects = tuple(kind() for kind in CATALOGUE.values() if not kind.excludes)
    turning = {p.unit for p in Model(GeneralJoint(), effects).parameters.values()}
    sliding = {p.unit for p in Model(LinearAxis(), effects).parameters.values()}
    assert {"N m", "rad/s"} <= turning
    assert {"N", "m/s"} <= sliding
    assert not any("rad" in unit or "N m" in unit for unit in sliding)
