"""Torques of angle and load: each against an exact law."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ellipj

from sysid import (
    RK4,
    AngleOffset,
    CubicSpring,
    DirectionalLoadFriction,
    Drag,
    GeneralJoint,
    Joint,
    LinearAxis,
    LoadFriction,
    Model,
    Record,
    Ripple,
    RodPendulum,
    Sensor,
    Spring,
    Tilt,
    TorqueBias,
    Viscous,
    diagnose,
    effect,
    simulate,
)
from tests.sysid.planted import assert_named, assert_recovered, logs, truth

U = np.random.default_rng(0).uniform(-2.0, 2.0, 200)


def test_a_tilted_base_is_an_encoder_that_is_off(pendulum):
    alpha = 0.15
    tilted = simulate(Model(pendulum, (Tilt(alpha=alpha),), dt=0.02), U, 2.0, 0.3)
    offset = simulate(Model(pendulum, (AngleOffset(offset=-alpha),), dt=0.02), U, 2.0 + alpha, 0.3)
    np.testing.assert_allclose(tilted.theta_read, offset.theta_read, atol=1e-11)
    np.testing.assert_allclose(tilted.theta_dot_read, offset.theta_dot_read, atol=1e-10)


@pytest.mark.parametrize(
    ("spring", "k_3", "a", "atol"), [(Spring(k=3.0), 0.0, 0.4, 1e-8), (CubicSpring(k=3.0, k_3=5.0), 5.0, 0.6, 1e-7)]
)
@pytest.mark.parametrize(("plant", "rest"), [(LinearAxis(m=0.75), 0.0), (GeneralJoint(J=0.75, G=0.0), math.pi)])
def test_a_spring_swings_about_its_rest_as_duffings_oscillator(spring, k_3, a, atol, plant, rest):
    """m x_ddot = -k x - k_3 x^3 from rest at a:  x = a cn(w t | a^2 k_3 / (2 m w^2)),   w^2 = (k + k_3 a^2) / m.

    The rest is hanging, or the zero of a linear axis, wherever its metres are counted from.
    """
    run = simulate(Model(plant, (spring,), RK4(substeps=4), 0.01), np.zeros(500), rest + a, 0.0)
    w2 = (3.0 + k_3 * a * a) / 0.75
    cn = ellipj(math.sqrt(w2) * run.t, 0.5 * k_3 * a * a / (0.75 * w2))[1]
    np.testing.assert_allclose(run.theta - rest, a * cn, atol=atol)


@pytest.mark.long
def test_an_oscillator_far_from_any_starting_value_is_found_with_its_springs():
    """A circuit that stands for Duffing's oscillator, in volts: m is 2e5 times smaller than where the fit begins."""
    rng, dt = np.random.default_rng(1), 1e-3
    hidden = (Viscous(b=2e-4), CubicSpring(k=1.0, k_3=4.0))
    truth = Model(LinearAxis(m=5e-6), hidden, RK4(substeps=4), dt)
    sensor, hold = Sensor(theta=5e-4), 2
    u = np.repeat(rng.normal(0.0, 0.04, (4, 800 // hold)), hold, axis=1)
    records = sensor.measure(simulate(truth, u, np.zeros(4), np.zeros(4)), rng)
    answer = diagnose(Model(LinearAxis(), dt=dt), records, sensor)
    assert {s.effect for s in answer.steps} == {"viscous", "cubic_spring"}, answer
    assert answer.error.ratio < 1.1
    for name, value in answer.estimate.values.items():
        assert abs(value - float(truth.parameters[name].value)) < 4.0 * answer.estimate.sd[name], name


def test_a_mass_on_a_spring_that_hardly_swings_is_found_with_its_friction():
    """Without friction a spring predicts worse than none does, and friction says nothing without the spring."""
    model = Model(LinearAxis(m=1.0), (effect("spring", k=9.8), effect("viscous", b=1.6)), RK4(substeps=2), 0.02)
    swing, rng = simulate(model, np.zeros(500), 0.25, 0.0), np.random.default_rng(0)
    record = Record(swing.t, swing.u, swing.theta + 4e-3 * rng.standard_normal(501))
    diagnosis = diagnose(Model(LinearAxis(m=1.0), (), RK4(substeps=2), 0.02), [record])
    assert {step.effect for step in diagnosis.steps} == {"spring", "viscous"}, diagnosis
    assert diagnosis.estimate.values["spring.k"] == pytest.approx(9.8, rel=0.03)
    assert diagnosis.estimate.values["viscous.b"] == pytest.approx(1.6, rel=0.05)


def test_a_ripple_conserves_energy_and_repeats_every_wave():
    ripple = Ripple(a=0.3, b=-0.2, order=7.0)
    joint = GeneralJoint(J=0.2, G=1.5)
    run = simulate(Model(joint, (ripple,), RK4(substeps=8), 0.01), np.zeros(500), 1.0, 0.0)
    potential = 1.5 * np.cos(run.theta) + (0.3 * np.cos(7 * run.theta) + 0.2 * np.sin(7 * run.theta)) / 7
    e = 0.5 * 0.2 * run.theta_dot**2 + potential
    np.testing.assert_allclose(e, e[0], atol=1e-7)
    axis = Model(LinearAxis(m=0.4), (ripple,), dt=0.02)
    one, shifted = (simulate(axis, U, start, 0.3) for start in (1.0, 1.0 + 2.0 * math.pi / 7))
    np.testing.assert_allclose(shifted.theta_dot, one.theta_dot, atol=1e-9)


def test_a_ripple_comes_back_with_every_wave_that_the_motion_meets():
    """However often the same waves are met, and in whatever time."""
    t = np.linspace(0.0, 10.0, 500)
    for turns in (0.25, 1.0, 3.0):
        once = 1.0 + 2.0 * math.pi * turns * t / 10.0
        again = 1.0 + math.pi * turns * (1.0 - np.cos(4.0 * t))
        assert Ripple(order=6.0).recurrences(once, t, t) == pytest.approx(6.0 * turns)
        assert Ripple(order=6.0).recurrences(again, 3.0 * t, t) == pytest.approx(6.0 * turns, rel=1e-3)
    assert Tilt().recurrences(once, t, t) == Spring().recurrences(once, t, t) == math.inf, "neither is a pattern"


DIRECTIONAL = DirectionalLoadFriction(mu=0.3, share=0.2)


@pytest.mark.parametrize(("drive", "gripped"), [(2.0, 0.57), (-2.0, 0.39), (0.0, 0.09)], ids=["held", "with", "off"])
def test_a_gear_between_drive_and_load_is_pressed_where_they_oppose_each_other(drive: float, gripped: float):
    """Against a load of -1.5 N m; LoadFriction takes the same share of both."""
    joint = Joint(0.3, 0.0, 0.0, drive, RodPendulum(), lambda: -1.5)
    assert DIRECTIONAL.limits(joint) == pytest.approx((gripped, gripped))
    assert LoadFriction(mu=0.1).limits(joint)[0] == pytest.approx(0.1 * abs(drive + 1.5))


def test_what_holds_a_weight_at_any_of_many_torques_is_a_friction_that_grows_with_the_load():
    """A weight of 1 N m stays under every torque d with |1 - d| < mu (1 + d): from 1/1.5 to 1.5."""
    weight = Model(GeneralJoint(J=0.5, G=1.0), (LoadFriction(mu=0.2),), dt=0.02)
    for held, moves in ((0.65, True), (0.68, False), (1.0, False), (1.48, False), (1.52, True)):
        run = simulate(weight, np.full(50, -held), 0.5 * math.pi, 0.0)
        assert np.any(run.theta_dot != 0.0) == moves, held


@pytest.mark.long
def test_a_servo_that_sticks_under_its_weight_is_told_its_friction():
    """It raises an arm and lowers it again, and stands most of the time, at any of many errors of its position."""
    dt, rng = 1.0 / 186.0, np.random.default_rng(0)
    goal = 0.8 * (1.0 - np.cos(1.1 * dt * np.arange(1115)))
    servo, sensor = effect("position_servo", k_p=1.0, k_d=0.2), Sensor(theta=4.4e-4)
    arm = Model(GeneralJoint(J=0.029, G=1.8), (servo, LoadFriction(mu=0.27)), RK4(substeps=4), dt)
    (record,) = sensor.measure(simulate(arm, goal[None], np.full(1, math.pi), np.zeros(1)), rng)
    record = replace(record, theta=0.001534 * np.round(record.theta / 0.001534), command="position")
    plain = Model(GeneralJoint(J=1.0, G=1.0), (effect("position_servo"),), RK4(substeps=4), dt)
    diagnosis = diagnose(plain, [record])
    assert [step.effect for step in diagnosis.steps] == ["load_friction"] and diagnosis.error.ratio < 1.1, diagnosis
    for name, value in (("load_friction.mu", 0.27), ("J", 0.029), ("G", 1.8)):
        assert abs(diagnosis.estimate.values[name] - value) < 4.0 * diagnosis.estimate.sd[name] + 1e-3 * value, name


def test_a_worm_gear_carries_a_weight_up_and_cannot_be_driven_back():
    """Up under 3 N m against 1, with a quarter of the one and all of the other as friction; let go, it stays."""
    weight = GeneralJoint(J=0.5, G=1.0)
    gear = Model(weight, (DirectionalLoadFriction(mu=1.25, share=0.8),), dt=0.02)
    up = simulate(gear, np.full(5, -3.0), 0.5 * math.pi, 0.0)
    assert up.theta_dot[1] == pytest.approx(-(3.0 - 1.0 - 0.25 * 3.0 - 1.0) / 0.5 * 0.02, rel=1e-3)
    still = simulate(gear, np.zeros(100), 0.5 * math.pi, 0.0)
    assert np.all(still.theta_dot == 0.0)
    assert simulate(Model(weight, dt=0.02), np.zeros(100), 0.5 * math.pi, 0.0).theta_dot[-1] > 0.5


@pytest.mark.long
def test_load_friction_that_knows_who_drives_is_found_and_named():
    records = logs(truth(DIRECTIONAL))
    assert_recovered(DIRECTIONAL, records)
    assert_named(DIRECTIONAL, records)


@pytest.mark.long
def test_load_friction_that_is_alike_both_ways_keeps_its_name():
    assert_named(LoadFriction(mu=0.12), logs(truth(LoadFriction(mu=0.12))))


@pytest.mark.long
def test_a_spring_that_rests_elsewhere_is_no_heavy_load_behind_a_spring():
    """A sensor counts from where it hangs, so that the spring comes with an offset; a hidden mass of many times the
    plant's, behind a spring, stays where it is and does the same."""
    hidden = (Spring(k=71.3), TorqueBias(tau_0=29.7), Viscous(b=0.022), Drag(c=0.14))
    sensor, plain = Sensor(theta=1e-4), Model(LinearAxis(m=1.0), (), RK4(substeps=2), dt=0.02)
    swings = simulate(replace(plain, effects=hidden), np.zeros((2, 2500)), np.array([0.49, 0.35]), np.zeros(2))
    diagnosis = diagnose(plain, sensor.measure(swings, np.random.default_rng(0)), sensor, parameters=())
    assert diagnosis.verdict == "missing" and {s.effect for s in diagnosis.steps} == {e.name for e in hidden}
    for name, value in (("spring.k", 71.3), ("torque_bias.tau_0", 29.7), ("viscous.b", 0.022), ("drag.c", 0.14)):
        assert abs(diagnosis.estimate.values[name] - value) < 4.0 * diagnosis.estimate.sd[name], name


@pytest.mark.parametrize(("mu", "share", "plausible"), [(0.6, 0.67, True), (1.0, 1.0, False), (2.0, 0.5, False)])
def test_a_gear_that_loses_nothing_when_it_drives_loses_nothing_when_the_load_does(
    mu: float, share: float, plausible: bool
) -> None:
    assert DirectionalLoadFriction(mu=mu, share=share).plausible is plausible
