"""What the tests of sysid share: plants x effects x back ends. A new one is one more line."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import pytest
import torch

import sysid
from sysid import (
    RK4,
    GeneralJoint,
    LinearAxis,
    Model,
    PointMassPendulum,
    RodPendulum,
    SemiImplicitEuler,
    simulate,
)
from sysid.planning.excitation import multisine

if TYPE_CHECKING:
    from sysid.web.bench import Workbench

PENDULUMS = {
    "rod": RodPendulum(m=1.3, l=0.9, g=9.7),
    "point mass": PointMassPendulum(m=0.7, l=0.6, g=9.81),
    "joint": GeneralJoint(J=0.3, G=2.1),
}
PLANTS = {**PENDULUMS, "axis": LinearAxis(m=0.4)}
EFFECTS = {
    e.name: e
    for e in (
        sysid.Viscous(b=0.07),
        sysid.Coulomb(tau_c=0.11),
        sysid.Stribeck(tau_c=0.04, excess=0.06, v_s=0.3),
        sysid.Drag(c=0.03),
        sysid.AsymmetricViscous(b_plus=0.06, b_minus=0.02),
        sysid.AsymmetricCoulomb(tau_plus=0.09, tau_minus=0.04),
        sysid.WarmingFriction(tau_c=0.01, excess=0.02, T=2.5),
        sysid.Dahl(tau_c=0.05, z_s=0.08),
        sysid.LuGre(tau_c=0.03, z_s=0.1, ratio=1.7, v_s=0.4),
        sysid.LoadFriction(mu=0.05),
        sysid.DirectionalLoadFriction(mu=0.03, share=0.3),
        sysid.Tilt(alpha=0.08),
        sysid.Spring(k=0.3),
        sysid.CubicSpring(k=0.2, k_3=0.1),
        sysid.Ripple(a=0.1, b=0.07, order=5.0),
        sysid.RotorInertia(J_r=0.04),
        sysid.FlexibleTransmission(J=0.06, f=5.0, zeta=0.07),
        sysid.TorqueBias(tau_0=0.2),
        sysid.Periodic(a=0.1, b=-0.06, f=1.7),
        sysid.Drift(r=0.05),
        sysid.Delay(T=0.0337, longest=0.04),
        sysid.Lag(T=0.061),
        sysid.TorqueGain(c=0.9),
        sysid.DeadZone(d=0.13),
        sysid.Saturation(limit=1.1),
        sysid.TorqueSpeedLimit(limit=1.3, k=0.2),
        sysid.BackEmf(k=0.05),
        sysid.CoastingDrive(k=0.05),
        sysid.Stamp(s=-0.37),
        sysid.AngleOffset(offset=0.03),
        sysid.VelocityBias(bias=0.04),
        sysid.VelocityGain(c=1.06),
        sysid.SensorDelay(T=0.027, longest=0.04),
        sysid.FilteredSpeed(T=0.031),
        sysid.Backlash(width=0.09),
        sysid.Eccentricity(a=0.04, b=-0.03),
    )
}
INTEGRATORS = {
    "euler": SemiImplicitEuler(theta_dot_max=8.0),
    "rk4": RK4(substeps=2),
}
STEPS = 120

Rolled = tuple[np.ndarray, dict[str, float]]
"""States and readings (4, N+1) and, by parameter, the derivative of the sum of all of them."""


def roll_numpy(model: Model, u: np.ndarray) -> Rolled:
    """Central differences, Richardson-extrapolated, all in one simulation."""
    names = list(model.parameters)
    values = np.array([p.value for p in model.parameters.values()])
    h = 1e-6 * np.maximum(1.0, np.abs(values))
    moves = np.concatenate([np.zeros((1, len(h)))] + [s * np.diag(h) for s in (1, -1, 2, -2)])
    run = simulate(model.with_parameters(dict(zip(names, (values + moves).T, strict=True))), u, math.pi, 0.0)
    path = np.stack([run.theta, run.theta_dot, run.theta_read, run.theta_dot_read])
    up, down, up_2, down_2 = path.sum(axis=(0, 2))[1:].reshape(4, -1)
    slopes = (8.0 * (up - down) - (up_2 - down_2)) / (12.0 * h)
    return path[:, 0], dict(zip(names, slopes.tolist(), strict=True))


def nested(flat: ca.SX, like: tuple[tuple[object, ...], ...]) -> tuple[tuple[ca.SX, ...], ...]:
    """A flat vector of memories, effect by effect."""
    values = iter(ca.vertsplit(flat)) if flat.numel() else iter(())
    return tuple(tuple(next(values) for _ in part) for part in like)


def roll_casadi(model: Model, u: np.ndarray) -> Rolled:
    """The input path, then motion and reading: one Function per control interval each, mapaccum over time."""
    names = list(model.parameters)
    rest, watching = model.rest(), model.sensing(math.pi, 0.0)
    p, command, t = ca.SX.sym("p", len(names)), ca.SX.sym("u"), ca.SX.sym("t")
    symbolic = model.with_parameters(dict(zip(names, ca.vertsplit(p), strict=True)))
    memory = ca.SX.sym("memory", sum(map(len, rest)))
    torques, after = symbolic.drive(command, nested(memory, rest))
    drive = ca.Function(
        "drive", [memory, command, p], [ca.vertcat(*(v for part in after for v in part)), ca.vertcat(*torques)]
    )
    inner, watches = model.inner_rest(), sum(map(len, watching))
    x, held = ca.SX.sym("x", 2 + watches + sum(map(len, inner))), ca.SX.sym("held", len(torques))
    reading, watched = symbolic.read(x[0], x[1], nested(x[2 : 2 + watches], watching), t)
    *moved, inner_then = symbolic.move_with_inner(
        x[0], x[1], nested(x[2 + watches :], inner), tuple(ca.vertsplit(held)), t
    )
    x_after = ca.vertcat(*moved, *(v for part in (*watched, *inner_then) for v in part))
    step = ca.Function("step", [x, held, t, p], [x_after, ca.vertcat(x[:2], *reading)])
    n, P, ahead = len(u), ca.MX.sym("P", len(names)), model.ahead
    fed = np.concatenate([u, np.full(ahead, u[-1])]).reshape(1, -1)
    start = ca.DM([v for part in rest for v in part])
    drives = drive.mapaccum("drives", n + ahead)(start, fed, ca.repmat(P, 1, n + ahead))[1][:, ahead:]
    seen = (v for part in symbolic.sensing(ca.SX(math.pi), ca.SX(0.0)) for v in part)
    start = ca.Function("start", [p], [ca.vertcat(math.pi, 0.0, *seen, *(v for part in inner for v in part))])(P)
    times = model.dt * np.arange(n + 1).reshape(1, -1)
    drives = ca.horzcat(drives, drives[:, -1])
    path = step.mapaccum("path", n + 1)(start, drives, times, ca.repmat(P, 1, n + 1))[1]
    run = ca.Function("run", [P], [path, ca.gradient(ca.sum1(ca.vec(path)), P)])
    values, slopes = run([q.value for q in model.parameters.values()])
    return np.array(values), dict(zip(names, np.array(slopes).ravel().tolist(), strict=True))


def roll_torch(model: Model, u: np.ndarray) -> Rolled:
    """Reverse mode through the loop."""
    numbers = {k: torch.tensor(p.value, dtype=torch.float64, requires_grad=True) for k, p in model.parameters.items()}
    tensors = model.with_parameters(numbers)
    theta, theta_dot = torch.tensor(math.pi, dtype=torch.float64), torch.zeros((), dtype=torch.float64)
    sensing, drives, path = tensors.sensing(theta, theta_dot), tensors.drives(u.tolist(), theta), []
    inner = tensors.inner_rest(theta)
    for k in range(len(u) + 1):
        reading, sensing = tensors.read(theta, theta_dot, sensing, k * model.dt)
        path.append(torch.stack([theta, theta_dot, *reading]))
        if k < len(u):
            theta, theta_dot, inner = tensors.move_with_inner(theta, theta_dot, inner, next(drives), k * model.dt)
    whole = torch.stack(path, dim=1)
    slopes = torch.autograd.grad(whole.sum(), list(numbers.values()), materialize_grads=True)
    return whole.detach().numpy(), {k: float(s) for k, s in zip(numbers, slopes, strict=True)}


BACK_ENDS = {"numpy": roll_numpy, "casadi": roll_casadi, "torch": roll_torch}


def relative(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference in units of the largest number."""
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


@pytest.fixture(scope="session")
def agree() -> Callable[..., None]:
    """Asserts that a model moves alike in all back ends, derivatives with respect to every parameter included."""

    def check(model: Model, steps: int = STEPS) -> None:
        u = multisine(np.random.default_rng(5), steps, model.dt, 2.0, 3.0)
        rolled = {name: roll(model, u) for name, roll in BACK_ENDS.items()}
        states, slopes = rolled["numpy"]
        assert np.ptp(states[0]) > 0.1, "the torque does not excite the pendulum"
        for name in ("casadi", "torch"):
            assert relative(rolled[name][0], states) < 1e-9, name
        exact = {name: np.array([rolled[name][1][k] for k in slopes]) for name in ("casadi", "torch")}
        np.testing.assert_allclose(exact["casadi"], exact["torch"], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(exact["casadi"], list(slopes.values()), rtol=1e-4, atol=1e-4)

    return check


@pytest.fixture(params=PLANTS.values(), ids=PLANTS.keys())
def plant(request: pytest.FixtureRequest) -> sysid.Plant:
    """Every plant, at numbers off its bounds."""
    return request.param


@pytest.fixture(params=PENDULUMS.values(), ids=PENDULUMS.keys())
def pendulum(request: pytest.FixtureRequest) -> sysid.Plant:
    """Every plant that gravity pulls."""
    return request.param


@pytest.fixture(params=EFFECTS.values(), ids=EFFECTS.keys())
def effect(request: pytest.FixtureRequest) -> sysid.Effect:
    """Every effect alone, at numbers off its kinks and off neutral."""
    return request.param


@pytest.fixture(params=INTEGRATORS.values(), ids=INTEGRATORS.keys())
def integrator(request: pytest.FixtureRequest) -> sysid.Integrator:
    """Every integrator."""
    return request.param


@pytest.fixture
def all_effects() -> tuple[sysid.Effect, ...]:
    """All effects at once; those that exclude each other: the first."""
    chosen: list[sysid.Effect] = []
    for e in EFFECTS.values():
        if not any(e.name in other.excludes for other in chosen):
            chosen.append(e)
    return tuple(chosen)


@pytest.fixture
def catalogue() -> object:
    """The catalogue, put back as it was after the test."""
    before = dict(sysid.CATALOGUE)
    yield sysid.CATALOGUE
    sysid.CATALOGUE.clear()
    sysid.CATALOGUE.update(before)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Workbench]:
    """A workbench without sessions that takes a megabyte."""
    from sysid.web.bench import Workbench
    from sysid.web.jobs import Jobs
    from sysid.web.session import Sessions

    made = Workbench(Sessions(tmp_path / "sessions"), Jobs(), most=1 << 20)
    yield made
    made.end()
