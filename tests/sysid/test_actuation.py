"""What happens to a command: delay, lag and stamp are exact, static effects follow their formula."""

import casadi as ca
import numpy as np
import pytest
import torch

from sysid import (
    RK4,
    DeadZone,
    Delay,
    GeneralJoint,
    Joint,
    Lag,
    Model,
    RodPendulum,
    RotorInertia,
    Saturation,
    Stamp,
    TorqueGain,
    TorqueSpeedLimit,
    simulate,
)
from tests.sysid.planted import assert_named, assert_recovered, drives, logs, truth

ROD = RodPendulum(m=1.3, l=0.9)


@pytest.mark.parametrize("substeps", [1, 2, 3])
def test_a_stamp_shifts_the_rows_either_way(substeps):
    u = np.random.default_rng(3).uniform(-2.0, 2.0, 40)
    held = np.repeat(u[:, None], substeps, axis=1)

    def shifted(s):
        return drives(Model(ROD, (Stamp(s=s),), RK4(substeps=substeps), 0.02), u)

    np.testing.assert_allclose(shifted(0.0), held, rtol=1e-15)
    np.testing.assert_allclose(shifted(-1.0)[:-1], held[1:], atol=1e-15)
    np.testing.assert_allclose(shifted(1.0)[1:], held[:-1], atol=1e-15)
    np.testing.assert_allclose(shifted(-0.5).mean(axis=1)[:-1], 0.5 * (u[1:] + u[:-1]), atol=1e-15)


@pytest.mark.parametrize("s", [0.2, 0.5, 0.87])
def test_a_late_stamp_is_a_delay(s):
    u = np.random.default_rng(3).uniform(-2.0, 2.0, 40)
    stamped, delayed = (drives(Model(ROD, (e,), dt=0.02), u) for e in (Stamp(s=s), Delay(T=0.02 * s)))
    np.testing.assert_allclose(stamped, delayed, atol=1e-14)


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


def test_static_input_effects_do_what_their_formula_says():
    u = np.array([-1.5, -0.4, -0.1, 0.0, 0.1, 0.4, 1.5])
    expected = {
        TorqueGain(c=0.8): 0.8 * u,
        DeadZone(d=0.3): np.sign(u) * np.maximum(np.abs(u) - 0.3, 0.0),
        Saturation(limit=0.7): np.clip(u, -0.7, 0.7),
    }
    for e, drive in expected.items():
        np.testing.assert_allclose(drives(Model(ROD, (e,), dt=0.02), u), np.stack([drive, drive], axis=1), atol=1e-15)


def test_gain_inertia_and_gravity_show_in_two_combinations_only():
    """(J + J_r) theta_ddot = G sin(theta) + c u moves as J + J_r, G and c all divided by c."""
    u = np.random.default_rng(6).uniform(-1.0, 1.0, 200)
    c, J_r = 1.25, 0.05
    full = Model(GeneralJoint(J=0.2, G=1.5), (TorqueGain(c=c), RotorInertia(J_r=J_r)), dt=0.02)
    plain = Model(GeneralJoint(J=(0.2 + J_r) / c, G=1.5 / c), dt=0.02)
    np.testing.assert_allclose(simulate(full, u, 2.0, 0.0).theta, simulate(plain, u, 2.0, 0.0).theta, rtol=1e-9)


CURVE = TorqueSpeedLimit(limit=1.5, k=0.3)


@pytest.mark.parametrize(
    ("drive", "theta_dot", "given"),
    [
        (1.0, 1.0, 1.0),
        (2.0, 0.0, 1.5),
        (2.0, 2.0, 0.9),
        (-2.0, -2.0, -0.9),
        (2.0, -2.0, 1.5),
        (-2.0, 2.0, -1.5),
        (2.0, 7.0, 0.0),
        (-2.0, -7.0, 0.0),
    ],
)
def test_a_motor_gives_what_its_curve_leaves(drive, theta_dot, given):
    """1.5 N m at rest, 0.3 less for each rad/s along the drive, nothing beyond the no-load speed of 5 rad/s."""
    assert drive + CURVE.torque(Joint(0.3, theta_dot, 0.0, drive, 0.0, ROD)) == pytest.approx(given)


@pytest.mark.long
def test_a_torque_that_falls_with_speed_is_found_and_named():
    records = logs(truth(CURVE))
    assert_recovered(CURVE, records)
    assert_named(CURVE, records)
