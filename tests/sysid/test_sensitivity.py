"""Derivatives are exact, and the information does not depend on where records are cut."""

import casadi
import numpy as np
import pytest

from study.paper.protocol import paper_model
from sysid import (
    RK4,
    Coulomb,
    Delay,
    GeneralJoint,
    Lag,
    Model,
    Sensor,
    TorqueBias,
    Viscous,
    fisher_information,
    simulate,
)
from sysid.estimation.identifiers.sensitivity import Segments
from sysid.planning.excitation import steps

SENSOR = Sensor(theta=0.01, theta_dot=0.1)
RICH = Model(
    GeneralJoint(J=0.05, G=1.2),
    (Viscous(b=0.03), Coulomb(tau_c=0.05), Delay(T=0.033), Lag(T=0.025), TorqueBias(tau_0=0.04)),
    RK4(substeps=2),
    dt=0.02,
    u_max=2.0,
)
MODELS = {
    "paper": (paper_model(2.0, 1.5), ("m", "l")),
    "rich": (RICH, ("J", "G", "viscous.b", "coulomb.tau_c", "delay.T", "lag.T", "torque_bias.tau_0")),
    "one of many": (RICH, ("delay.T",)),
}


def records(model, n=2, length=53, sensor=SENSOR):
    rng = np.random.default_rng(3)
    u = np.stack([steps(rng, length, model.dt, 1.0, 0.3) for _ in range(n)])
    return sensor.measure(simulate(model, u, np.pi + 0.3 * rng.standard_normal(n), rng.standard_normal(n)), rng)


def numbers(model, names):
    return np.array([model.parameters[n].value for n in names])


@pytest.mark.parametrize("case", MODELS)
def test_blocks_equal_finite_differences(case):
    model, names = MODELS[case]
    segments = Segments(model, names, records(model), SENSOR, length=10)
    p = 1.03 * numbers(model, names)
    rng = np.random.default_rng(0)
    nodes = np.array([np.pi, 0.0]) + 0.5 * rng.standard_normal((segments.size, 2))
    blocks = segments.blocks(p, nodes)
    for j in range(2 + len(names)):
        ends, costs = [], []
        h = 1e-6 * (1.0 if j < 2 else p[j - 2])
        for side in (-h, h):
            moved_p, moved_nodes = p.copy(), nodes.copy()
            if j < 2:
                moved_nodes[:, j] += side
            else:
                moved_p[j - 2] += side
            moved = segments.blocks(moved_p, moved_nodes)
            ends.append(moved.end)
            costs.append(moved.cost)
        scale = np.abs(blocks.end_z[:, :, j]).max() + 1.0
        np.testing.assert_allclose(blocks.end_z[:, :, j], (ends[1] - ends[0]) / (2 * h), atol=2e-7 * scale, rtol=2e-6)
        total = blocks.gradient[:, j].sum()
        size = np.abs(blocks.gradient[:, j]).sum()
        assert total == pytest.approx((costs[1] - costs[0]) / (2 * h), abs=1e-6 * size)


def test_hessian_equals_differences_of_the_gradient():
    model, names = paper_model(2.0, 1.5), ("m", "l")
    segments = Segments(model, names, records(model), SENSOR, length=10)
    p, M = numbers(model, names), segments.size
    nodes = np.array([np.pi, 0.0]) + 0.5 * np.random.default_rng(0).standard_normal((M, 2))
    exact = np.asarray(segments.hessian(casadi.DM(p), casadi.DM(nodes.T), casadi.DM(1.0), casadi.DM.zeros(2, M)))
    exact = exact.T.reshape(M, 4, 4)
    for j in range(2):
        h = 1e-5
        sides = [segments.blocks(p + s * np.eye(2)[j], nodes).gradient for s in (-h, h)]
        np.testing.assert_allclose(exact[:, :, 2 + j], (sides[1] - sides[0]) / (2 * h), rtol=1e-5, atol=1e-3)
        sides = [segments.blocks(p, nodes + s * np.eye(2)[j]).gradient for s in (-h, h)]
        np.testing.assert_allclose(exact[:, :, j], (sides[1] - sides[0]) / (2 * h), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("case", MODELS)
def test_information_does_not_depend_on_the_cut(case):
    model, names = MODELS[case]
    data, p = records(model), numbers(model, names)
    starts = np.array([[r.theta[0], r.theta_dot[0]] for r in data])
    found = []
    for length in (1, 7, 53):
        segments = Segments(model, names, data, SENSOR, length)
        found.append(segments.information(segments.blocks(p, segments.roll(p, starts))))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)
    np.testing.assert_allclose(found[2], found[0], rtol=1e-6)
    whole = Segments(model, names, data, SENSOR, 7)
    blocks = whole.blocks(p, whole.roll(p, starts))
    windows = whole.information(blocks, whole=False)
    # free states in every window only take information away
    assert np.all(np.linalg.eigvalsh(found[0] - windows) > -1e-6 * np.trace(found[0]))


def test_information_equals_that_of_the_simulator():
    """An independent road: differences of NumPy rollouts over (x_0, p), then the Schur complement."""
    model, names = MODELS["rich"]
    data, p = records(model, n=1), numbers(model, names)
    start = np.array([data[0].theta[0], data[0].theta_dot[0]])

    def readings(z):
        moved = model.with_parameters(dict(zip(names, z[2:].tolist(), strict=True)))
        run = simulate(moved, data[0].u, z[0], z[1])
        return np.concatenate([run.theta / SENSOR.theta, run.theta_dot / SENSOR.theta_dot])

    z = np.concatenate([start, p])
    h = 1e-6 * np.maximum(np.abs(z), 1e-2)
    S = np.stack([(readings(z + d) - readings(z - d)) / (2 * d.sum()) for d in np.diag(h)], axis=1)
    M = S.T @ S
    expected = M[2:, 2:] - M[2:, :2] @ np.linalg.solve(M[:2, :2], M[:2, 2:])
    found = fisher_information(model, names, data, SENSOR, start[None, :])
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
