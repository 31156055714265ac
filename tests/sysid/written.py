"""Logs as a rig writes them: rollouts of a damped rod, their tables, and files of these."""

import math
from pathlib import Path

import numpy as np
import pytest

from sysid import RK4, Model, RodPendulum, Sensor, Viscous, read, simulate
from sysid.data.record import COLUMNS
from sysid.planning.excitation import multisine

MODEL = Model(RodPendulum(m=1.0, l=1.0), (Viscous(b=0.05),), RK4(substeps=4), dt=0.02)
SENSOR = Sensor(theta=0.003, theta_dot=0.05)
REAL = Path(__file__).parents[3] / "shared" / "data" / "logs"
"""Logs of real machines, beside the project."""


def rollouts(n=1, seconds=6.0, seed=0, sensor=SENSOR, model=MODEL):
    rng = np.random.default_rng(seed)
    u = np.stack([multisine(rng, round(seconds / model.dt), model.dt, 3.0, 3.0) for _ in range(n)])
    return sensor.measure(simulate(model, u, math.pi + rng.uniform(-1.5, 1.5, n), np.zeros(n)), rng)


def table(record):
    """The record's columns as a rig would log them."""
    return {"t": record.t, "theta": record.theta, "theta_dot": record.theta_dot, "torque": np.append(record.u, 0.0)}


def write(path, columns):
    names = list(columns)
    rows = zip(*(columns[name] for name in names), strict=True)
    lines = [",".join(c if isinstance(c, str) else repr(float(c)) for c in row) for row in rows]
    path.write_text("\n".join([",".join(names), *lines]) + "\n")
    return path


def of_real_machine(name, torque="torque_meas_Nm", **options):
    """The log of that name, in which 0 is hanging; skips the test where the real logs are not here."""
    if not (REAL / f"{name}.csv").exists():
        pytest.skip("the real logs are not here: expected ../shared/data/logs beside the project")
    columns = f"t=time_s,theta=angle_rad,theta_dot=velocity_rad_s,torque={torque}"
    return read(REAL / f"{name}.csv", **{"columns": columns, "zero": "hanging", **options})


def same(a, b, rtol=0.0):
    for column in COLUMNS:
        mine, yours = getattr(a, column), getattr(b, column)
        assert (mine is None) == (yours is None), column
        if mine is not None:
            np.testing.assert_allclose(mine, yours, rtol=rtol, atol=1e-9 if rtol else 0.0, err_msg=column)
