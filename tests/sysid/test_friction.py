"""Friction: it opposes motion, only dissipates, holds a joint at rest, and its kinds contain each other."""

import math

import numpy as np
import pytest

from sysid import (
    RK4,
    AsymmetricCoulomb,
    AsymmetricViscous,
    BackEmf,
    Coulomb,
    DirectionalLoadFriction,
    Drag,
    Joint,
    LinearAxis,
    LoadFriction,
    Model,
    RodPendulum,
    Saturation,
    Stribeck,
    TorqueBias,
    TorqueSpeedLimit,
    Viscous,
    WarmingFriction,
    simulate,
)
from sysid.planning.excitation import multisine
from tests.sysid.planted import assert_named, assert_recovered, energy, logs, truth

ROD = RodPendulum(m=1.3, l=0.9)
WET = [Viscous(b=0.1), Drag(c=0.05), BackEmf(k=0.1), AsymmetricViscous(b_plus=0.12, b_minus=0.05)]
DRY = [
    Coulomb(tau_c=0.2),
    Stribeck(tau_c=0.1, excess=0.1),
    AsymmetricCoulomb(tau_plus=0.2, tau_minus=0.1),
    WarmingFriction(tau_c=0.1, excess=0.1, T=2.0),
]


def seen(theta_dot):
    return Joint(0.3, theta_dot, 0.0, 0.0, ROD, lambda: 1.5)


@pytest.mark.parametrize("friction", [*DRY, LoadFriction(mu=0.1)], ids=lambda e: e.name)
def test_dry_friction_only_dissipates(pendulum, friction):
    run = simulate(Model(pendulum, (friction,), RK4(substeps=8), 0.02), np.zeros(400), 1.0, 0.0)
    e, swing = energy(pendulum, run.theta, run.theta_dot), pendulum.gravity_torque(0.5 * math.pi)
    assert np.all(np.diff(e) < 1e-6 * swing)
    assert e[-1] < e[0] - 0.1 * swing


@pytest.mark.parametrize("friction", WET, ids=lambda e: e.name)
def test_wet_friction_opposes_motion(friction):
    theta_dot = np.linspace(-5.0, 5.0, 101)
    torque = friction.torque(seen(theta_dot))
    assert np.all(torque * theta_dot <= 0.0)
    assert np.sum(torque * theta_dot < 0.0) == 100


@pytest.mark.parametrize(("friction", "power"), [(Viscous(b=0.1), 2), (Drag(c=0.1), 3)])
def test_friction_takes_its_power(friction, power):
    run = simulate(Model(ROD, (friction,), RK4(substeps=4), 0.01), np.zeros(400), 1.0, 0.0)
    e = energy(ROD, run.theta, run.theta_dot)
    assert e[-1] - e[0] == pytest.approx(-0.1 * np.trapezoid(np.abs(run.theta_dot) ** power, run.t), rel=1e-4)


def test_stribeck_friction_falls_from_the_static_to_the_sliding_limit():
    friction = Stribeck(tau_c=0.1, excess=0.3, v_s=0.2)
    limits = [friction.limits(seen(v))[0] for v in (0.0, 0.2, -0.2, 2.0)]
    assert limits == pytest.approx([0.4, 0.1 + 0.3 / math.e, 0.1 + 0.3 / math.e, 0.1])


@pytest.mark.parametrize(
    ("special", "general"),
    [
        (Coulomb(tau_c=0.1), Stribeck(tau_c=0.1)),
        (Coulomb(tau_c=0.1), AsymmetricCoulomb(tau_plus=0.1, tau_minus=0.1)),
        (Coulomb(tau_c=0.1), WarmingFriction(tau_c=0.1)),
        (Viscous(b=0.1), AsymmetricViscous(b_plus=0.1, b_minus=0.1)),
        (LoadFriction(mu=0.1), DirectionalLoadFriction(mu=0.2, share=0.5)),
        (Viscous(b=0.1), BackEmf(k=0.1)),
        (Saturation(limit=1.1), TorqueSpeedLimit(limit=1.1, k=0.0)),
    ],
    ids=lambda e: e.name,
)
def test_a_general_law_contains_the_special_one(special, general):
    u = multisine(np.random.default_rng(0), 200, 0.02, 1.5, 3.0)
    one, other = (simulate(Model(ROD, (e,), dt=0.02), u, 2.0, 0.0) for e in (special, general))
    np.testing.assert_allclose(one.theta, other.theta, rtol=1e-12)


def test_where_it_slides_asymmetric_friction_is_coulomb_and_a_bias():
    plant, u = LinearAxis(m=1.0), np.sin(0.3 * np.arange(50))
    both = (Coulomb(tau_c=0.15), TorqueBias(tau_0=-0.05))
    for v in (3.0, -3.0):
        one = simulate(Model(plant, (AsymmetricCoulomb(tau_plus=0.2, tau_minus=0.1),), dt=0.02), u, 0.0, v)
        assert np.all(one.theta_dot * v > 0.0)
        np.testing.assert_allclose(one.theta, simulate(Model(plant, both, dt=0.02), u, 0.0, v).theta, atol=1e-12)


def test_asymmetric_friction_holds_more_one_way():
    model = Model(LinearAxis(m=1.0), (AsymmetricCoulomb(tau_plus=0.2, tau_minus=0.1),), dt=0.02)
    for force, moves in ((0.19, False), (0.21, True), (-0.09, False), (-0.11, True)):
        run = simulate(model, np.full(20, force), 0.0, 0.0)
        assert np.any(run.theta_dot != 0.0) == moves


def test_load_friction_is_a_share_of_the_load():
    model = Model(LinearAxis(m=2.0), (LoadFriction(mu=0.25),), dt=0.02)
    run = simulate(model, np.full(50, 3.0), 0.0, 0.0)
    np.testing.assert_allclose(run.theta_dot, 0.75 * 3.0 / 2.0 * run.t, rtol=1e-12)


def test_a_carriage_on_warming_friction_slows_as_its_integral_says():
    """Sliding, without force:  v = v_0 - (tau_c t + excess T (1 - exp(-t/T))) / m."""
    friction = WarmingFriction(tau_c=0.1, excess=0.3, T=2.0)
    run = simulate(Model(LinearAxis(m=0.5), (friction,), RK4(substeps=4), 0.01), np.zeros(200), 0.0, 3.0)
    expected = 3.0 - (0.1 * run.t - 0.3 * 2.0 * np.expm1(-run.t / 2.0)) / 0.5
    np.testing.assert_allclose(run.theta_dot, expected, atol=1e-5)


WARMING = WarmingFriction(tau_c=0.04, excess=0.15, T=3.0)


@pytest.mark.long
def test_friction_that_falls_while_the_record_runs_is_found_and_named():
    records = logs(truth(WARMING), n=4, seconds=10.0)
    assert_recovered(WARMING, records)
    assert_named(WARMING, records)


def test_friction_that_stays_is_no_warming():
    assert_named(Coulomb(tau_c=0.1), logs(truth(Coulomb(tau_c=0.1)), n=4, seconds=10.0))
