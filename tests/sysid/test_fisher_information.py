"""The information is that of the simulator, and no cut of the records adds to it."""

import numpy as np
import pytest

from study.paper.protocol import paper_model
from sysid import (
    Sensor,
    fisher_information,
    simulate,
)
from sysid.planning.excitation import steps
from tests.sysid.planted import RICH

SENSOR = Sensor(theta=0.01, theta_dot=0.1)
MODELS = {
    "paper": (paper_model(2.0, 1.5), ("m", "l")),
    "rich": (RICH, ("J", "G", "viscous.b", "coulomb.tau_c", "delay.T", "lag.T", "torque_bias.tau_0")),
    "one of many": (RICH, ("delay.T",)),
}


def records(model, n=2):
    rng = np.random.default_rng(3)
    u = np.stack([steps(rng, 53, model.dt, 1.0, 0.3) for _ in range(n)])
    return SENSOR.measure(simulate(model, u, np.pi + 0.3 * rng.standard_normal(n), rng.standard_normal(n)), rng)


def starts(records):
    return np.array([[r.theta[0], r.theta_dot[0]] for r in records])


@pytest.mark.parametrize("sensor", [SENSOR, Sensor(theta=0.01), Sensor(theta_dot=0.1)], ids=["both", "angle", "speed"])
@pytest.mark.parametrize("case", MODELS)
def test_information_equals_that_of_the_simulator(case, sensor):
    """An independent road: differences of NumPy rollouts over (x_0, p), then the Schur complement."""
    model, names = MODELS[case]
    (record,) = records(model, n=1)

    def readings(z):
        moved = model.with_parameters(dict(zip(names, z[2:].tolist(), strict=True)))
        run = simulate(moved, record.u, z[0], z[1])
        channels = (run.theta, sensor.theta), (run.theta_dot, sensor.theta_dot)
        return np.concatenate([values / sd for values, sd in channels if sd is not None])

    z = np.concatenate([*starts([record]), [model.parameters[n].value for n in names]])
    h = 1e-6 * np.maximum(np.abs(z), 1e-2)
    S = np.stack([(readings(z + d) - readings(z - d)) / (2 * d.sum()) for d in np.diag(h)], axis=1)
    M = S.T @ S
    expected = M[2:, 2:] - M[2:, :2] @ np.linalg.solve(M[:2, :2], M[:2, 2:])
    information = fisher_information(model, names, [record], sensor, starts([record]))
    np.testing.assert_allclose(information, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("case", MODELS)
def test_information_of_records_adds_up_and_a_cut_takes_some_away(case):
    """Every piece has a start of its own that is not known."""
    model, names = MODELS[case]
    data = records(model)
    whole = fisher_information(model, names, data, SENSOR, starts(data))
    each = [fisher_information(model, names, [r], SENSOR, starts([r])) for r in data]
    np.testing.assert_allclose(whole, sum(each), rtol=1e-9, atol=1e-12 * np.abs(whole).max())
    run = simulate(model, data[0].u, *starts(data)[0])
    pieces = [data[0].part(0, 19), data[0].part(20, 53)]
    at = np.array([[run.theta[k], run.theta_dot[k]] for k in (0, 20)])
    lost = each[0] - fisher_information(model, names, pieces, SENSOR, at)
    assert np.all(np.linalg.eigvalsh(lost) > -1e-6 * np.trace(whole))
