"""What the tests of sysid share: plants x effects x back ends. A new one is one more line."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
import torch

import sysid
from sysid import (
    RK4,
    Coulomb,
    Delay,
    GeneralJoint,
    Lag,
    Model,
    PointMassPendulum,
    QuadraticDrag,
    RodPendulum,
    SemiImplicitEuler,
    State,
    TorqueBias,
    Viscous,
    simulate,
)
from sysid.excitation import multisine

PLANTS = {
    "rod": RodPendulum(m=1.3, l=0.9, g=9.7),
    "point mass": PointMassPendulum(m=0.7, l=0.6, g=9.81),
    "joint": GeneralJoint(J=0.3, G=2.1),
}
EFFECTS = {
    "viscous": Viscous(b=0.07),
    "coulomb": Coulomb(tau_c=0.11),
    "quadratic_drag": QuadraticDrag(c=0.03),
    "torque_bias": TorqueBias(tau_0=0.2),
    "delay": Delay(T=0.0337, longest=0.04),
    "lag": Lag(T=0.061),
}
INTEGRATORS = {
    "euler": SemiImplicitEuler(theta_dot_max=8.0),
    "rk4": RK4(substeps=2),
}
STEPS = 300

Rolled = tuple[np.ndarray, dict[str, float]]
"""States (2, N+1) and, by parameter, the derivative of the sum of all of them."""


def roll_numpy(model: Model, u: np.ndarray) -> Rolled:
    """Central differences, Richardson-extrapolated, all in one simulation."""
    names = list(model.parameters)
    values = np.array([p.value for p in model.parameters.values()])
    h = 1e-4 * np.maximum(1.0, np.abs(values))
    moves = np.concatenate([np.zeros((1, len(h)))] + [s * np.diag(h) for s in (1, -1, 2, -2)])
    run = simulate(model.with_parameters(dict(zip(names, (values + moves).T, strict=True))), u, math.pi, 0.0)
    total = np.sum(run.theta + run.theta_dot, axis=1)
    up, down, up_2, down_2 = total[1:].reshape(4, -1)
    slopes = (8.0 * (up - down) - (up_2 - down_2)) / (12.0 * h)
    return np.stack([run.theta[0], run.theta_dot[0]]), dict(zip(names, slopes.tolist(), strict=True))


def roll_casadi(model: Model, u: np.ndarray) -> Rolled:
    """One Function per control interval, mapaccum over time."""
    names = list(model.parameters)
    p, command, t = ca.SX.sym("p", len(names)), ca.SX.sym("u"), ca.SX.sym("t")
    symbolic = model.with_parameters(dict(zip(names, ca.vertsplit(p), strict=True)))
    lengths = [len(own) for own in model.rest()]
    x = ca.SX.sym("x", 2 + sum(lengths))
    entries = ca.vertsplit(x)
    memory, rest = [], entries[2:]
    for length in lengths:
        memory.append(tuple(rest[:length]))
        rest = rest[length:]
    after = symbolic.advance(State(entries[0], entries[1], tuple(memory)), command, t)
    x_after = ca.vertcat(after.theta, after.theta_dot, *(v for own in after.memory for v in own))
    step = ca.Function("step", [x, command, t, p], [x_after])
    n, P = len(u), ca.MX.sym("P", len(names))
    start = ca.DM([math.pi, 0.0, *(v for own in model.rest() for v in own)])
    path = step.mapaccum("path", n)(start, u.reshape(1, -1), model.dt * np.arange(n).reshape(1, -1), ca.repmat(P, 1, n))
    states = ca.horzcat(start[:2], path[:2, :])
    run = ca.Function("run", [P], [states, ca.gradient(ca.sum1(ca.vec(states)), P)])
    values, slopes = run([q.value for q in model.parameters.values()])
    return np.array(values), dict(zip(names, np.array(slopes).ravel().tolist(), strict=True))


def roll_torch(model: Model, u: np.ndarray) -> Rolled:
    """Reverse mode through the loop."""
    numbers = {k: torch.tensor(p.value, dtype=torch.float64, requires_grad=True) for k, p in model.parameters.items()}
    tensors = model.with_parameters(numbers)
    state = tensors.initial_state(torch.tensor(math.pi, dtype=torch.float64), torch.zeros((), dtype=torch.float64))
    states = [torch.stack([state.theta, state.theta_dot])]
    for k, command in enumerate(u.tolist()):
        state = tensors.advance(state, command, k * model.dt)
        states.append(torch.stack([state.theta, state.theta_dot]))
    path = torch.stack(states, dim=1)
    slopes = torch.autograd.grad(path.sum(), list(numbers.values()))
    return path.detach().numpy(), {k: float(s) for k, s in zip(numbers, slopes, strict=True)}


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
        assert np.ptp(states[0]) > 0.2, "the torque does not excite the pendulum"
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
    """All effects at once."""
    return tuple(EFFECTS.values())


@pytest.fixture
def catalogue() -> object:
    """The catalogue, put back as it was after the test."""
    before = dict(sysid.CATALOGUE)
    yield sysid.CATALOGUE
    sysid.CATALOGUE.clear()
    sysid.CATALOGUE.update(before)
