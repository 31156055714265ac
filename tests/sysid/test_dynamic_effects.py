"""Effects with states of their own: what they do to a joint, where they are simpler ones, and that logs show them."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sysid import (
    RK4,
    Coulomb,
    Dahl,
    Effect,
    FlexibleTransmission,
    GeneralJoint,
    LinearAxis,
    LuGre,
    Model,
    Record,
    RotorInertia,
    Sensor,
    Stribeck,
    Viscous,
    simulate,
)
from sysid.estimation.held_out import held_out_error
from sysid.estimation.linearisation import LinearisedModel, Motion, Samples
from sysid.estimation.solver import fit_parameters
from sysid.physics.effects.effect import Stretch
from sysid.planning.excitation import multisine
from tests.sysid.planted import assert_named, assert_recovered, logs, truth

DAHL = Dahl(tau_c=0.2, z_s=0.08)
LUGRE = LuGre(tau_c=0.15, z_s=0.08, ratio=1.8, v_s=0.4)
FLEXIBLE = FlexibleTransmission(J=0.1, f=4.0, zeta=0.05)
DYNAMIC = {e.name: e for e in (DAHL, LUGRE, FLEXIBLE)}
JOINT = GeneralJoint(J=0.25, G=2.5)


def derivative(effect: Effect, drive: float, x: np.ndarray) -> list[float]:
    """The defining equations of JOINT with one effect: theta, theta_dot and the effect's states."""
    theta, v, *inner = x
    load = float(JOINT.gravity_torque(theta)) + drive
    if isinstance(effect, FlexibleTransmission):
        delta, delta_dot = inner
        omega = 2.0 * math.pi * effect.f
        pull = 2.0 * effect.zeta * omega * delta_dot + omega**2 * delta
        a = (load + effect.J * pull) / JOINT.J
        return [v, a, delta_dot, -a - pull]
    largest, share = effect.sliding(v)
    return [v, (load - largest * inner[0]) / JOINT.J, (v - abs(v) * inner[0] / share) / effect.z_s]


@pytest.mark.parametrize("effect", DYNAMIC.values(), ids=DYNAMIC.keys())
def test_a_motion_solves_the_equations_to_second_order(effect):
    dt, u = 0.02, multisine(np.random.default_rng(0), 60, 0.02, 2.0, 3.0)
    x, path = np.array([2.0, 0.5, *[0.0] * len(effect.start_sd)]), [2.0]
    for command in u:
        x = solve_ivp(lambda t, x, u=command: derivative(effect, u, x), (0.0, dt), x, rtol=1e-10, atol=1e-12).y[:, -1]
        path.append(x[0])
    runs = {n: simulate(Model(JOINT, (effect,), RK4(substeps=n), dt), u, 2.0, 0.5).theta for n in (2, 16)}
    off = {n: np.max(np.abs(theta - path)) for n, theta in runs.items()}
    assert off[2] < 2e-3
    assert off[16] < off[2] / 20.0  # a kink apart, 64


@pytest.mark.parametrize(
    ("general", "special"),
    [
        (Dahl(tau_c=0.2, z_s=1e-5), Coulomb(tau_c=0.2)),
        (LuGre(tau_c=0.2, ratio=1.0, v_s=0.3, z_s=0.05), Dahl(tau_c=0.2, z_s=0.05)),
        (LuGre(tau_c=0.1, ratio=2.0, v_s=0.5, z_s=1e-5), Stribeck(tau_c=0.1, excess=0.1, v_s=0.5)),
        (FlexibleTransmission(J=0.1, f=100.0, zeta=0.5), RotorInertia(J_r=0.1)),
    ],
    ids=lambda e: e.name,
)
def test_at_its_limit_it_is_the_simpler_effect(general, special):
    u = multisine(np.random.default_rng(0), 150, 0.02, 2.0, 3.0)
    one, other = (simulate(Model(JOINT, (e,), RK4(substeps=8), 0.02), u, 2.0, 0.0) for e in (general, special))
    assert np.max(np.abs(one.theta - other.theta)) < 5e-3
    assert np.max(np.abs(simulate(Model(JOINT, (), RK4(), 0.02), u, 2.0, 0.0).theta - other.theta)) > 0.1


@pytest.mark.parametrize("effect", [DAHL, LUGRE], ids=lambda e: e.name)
def test_before_it_slides_the_contact_is_a_spring(effect):
    """Pushed with little, a carriage rests where the spring holds it; let go, it returns."""
    model = Model(LinearAxis(m=0.4), (effect, Viscous(b=1.0)), RK4(substeps=4), 0.02)
    largest, _ = effect.sliding(0.0)
    push = 0.02 * largest
    u = np.concatenate([np.full(1500, push), np.zeros(1500)])
    run = simulate(model, u, 0.0, 0.0)
    assert run.theta[1500] == pytest.approx(0.02 * effect.z_s, rel=0.05)
    assert abs(run.theta[-1]) < 0.1 * run.theta[1500]


@pytest.mark.parametrize("speed", [0.05, 0.4, 3.0])
def test_sliding_it_is_stribecks_curve(speed):
    for direction in (1.0, -1.0):
        model = Model(LinearAxis(m=1e3), (LUGRE,), RK4(), 0.02)
        run = simulate(model, np.zeros(400), 0.0, direction * speed)
        braked = -1e3 * np.diff(run.theta_dot)[-1] / 0.02 * direction
        limit = 0.15 + 0.12 * math.exp(-((run.theta_dot[-1] / 0.4) ** 2))
        assert braked == pytest.approx(limit, rel=0.02)


@pytest.mark.parametrize("effect", [DAHL, LUGRE], ids=lambda e: e.name)
def test_a_cycle_dissipates(effect):
    """Whatever the way, as long as it comes back to where it was."""
    t = np.linspace(0.0, 4.0 * math.pi, 4001)
    theta = 0.1 * np.sin(t) + 0.04 * np.sin(3.0 * t)
    states, work = (0.0,), 0.0
    for k, travel in enumerate(np.diff(theta)):
        torque, _, states = effect.follow(states, stretch(travel / (t[1] - t[0]), t[1] - t[0]))
        work += torque * travel if k >= 2000 else 0.0
    assert work < -0.01


def stretch(speed: float, h: float) -> Stretch:
    return Stretch(h, speed, speed, h * speed)


def test_slopes_of_a_step_are_the_models_derivatives():
    """With respect to the effects' own states, too, against those that CasADi takes of the same equations."""
    model = Model(JOINT, (DAHL, FLEXIBLE), RK4(), 0.02)
    u = multisine(np.random.default_rng(1), 50, 0.02, 2.0, 3.0)
    run = simulate(model, u, 2.0, 0.5)
    samples = Samples(model, [Record(run.t, u, run.theta, run.theta_dot)], Sensor(0.003, 0.05))
    motion = Motion(samples.smoothed, np.full(len(samples), 0.3), np.zeros((len(samples), 3)))
    motion = motion.of_model(samples, model)
    linearised = LinearisedModel(samples, model, replace(motion, spread=np.zeros((len(samples), 6))))
    z, command = casadi.SX.sym("z", 6), casadi.SX.sym("u")
    *ends, (one, two) = model.move_with_inner(
        z[0], z[1], ((z[3],), (z[4], z[5])), (command,), 0.0, push=float(model.inertia()) * z[2]
    )
    slope = casadi.Function("slope", [z, command], [casadi.jacobian(casadi.vertcat(*ends, *one, *two), z)])
    for k in range(50):
        at = [*motion.x[k], motion.d[k], *motion.inner[k]]
        np.testing.assert_allclose(linearised.system.A[k], np.array(slope(at, u[k])), rtol=2e-3, atol=2e-4)


@pytest.mark.long
@pytest.mark.parametrize("effect", DYNAMIC.values(), ids=DYNAMIC.keys())
def test_its_numbers_are_recovered_within_their_error(effect):
    assert_recovered(effect, logs(truth(effect), n=4, seconds=6.0))


def test_where_a_record_begins_its_states_are_found():
    """A load that swings already when the log begins: the filter finds it, and the fit is no worse for it."""
    effect = FlexibleTransmission(J=0.1, f=1.5, zeta=0.02)
    (long,) = logs(truth(effect), n=1, seconds=12.0)
    late = Record(long.t[200:], long.u[200:], long.theta[200:], long.theta_dot[200:])
    model = truth(effect)
    fit = fit_parameters(Samples(model, [late], Sensor(0.003, 0.05)), model, ("m", "l"))
    assert abs(fit.values[0] - 1.0) < 4.0 * math.sqrt(fit.covariance[0, 0])
    assert held_out_error(model, [late], Sensor(0.003, 0.05)).ratio < 1.25


@pytest.mark.long
@pytest.mark.parametrize("effect", [DAHL, FLEXIBLE], ids=lambda e: e.name)
def test_it_is_named_alone(effect):
    assert_named(effect, logs(truth(effect), n=5, seconds=8.0))


def test_friction_that_does_not_give_is_not_called_a_spring():
    assert_named(Coulomb(tau_c=0.15), logs(truth(Coulomb(tau_c=0.15)), seed=3))


@pytest.mark.parametrize("seconds", [12.0, 40.0])
def test_a_free_swing_shakes_no_spring_within_its_own_lower_harmonics(seconds: float) -> None:
    """Unless it rings beside the swing, so that the motion does not come back, or a drive shakes it."""
    t = np.arange(0.0, seconds, 0.02)
    swing = math.pi + 0.5 * np.exp(-0.02 * t) * np.sin(2.0 * math.pi * 0.7 * t)
    ringing = swing + 0.3 * np.sin(2.0 * math.pi * 1.83 * t)
    for f, shaken in ((1.4, False), (2.0, False), (2.1, False), (2.6, True), (9.0, True)):
        flexible = replace(FLEXIBLE, f=f)
        assert (flexible.recurrences(swing, t, 0.0 * t) == math.inf) is shaken
        assert shaken or flexible.recurrences(swing, t, 0.0 * t) == 0.0
        assert flexible.recurrences(swing, t, np.cos(t)) == flexible.recurrences(ringing, t, 0.0 * t) == math.inf
