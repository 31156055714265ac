"""A log beside what a model makes of it, as Parquet: measured, predicted, and the torque that the model lacks."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from os import PathLike

import numpy as np

from sysid.data.files import check_installed, save_file
from sysid.data.record import Record, check_records
from sysid.data.sensor import Sensor
from sysid.diagnosis.predictions import throughout
from sysid.diagnosis.residual_torque import ResidualTorque, residual_torque
from sysid.estimation.output_error import CHANNELS
from sysid.physics.model import Model
from sysid.physics.ops import Array

AHEAD = 1.0
"""How far a model predicts [s], from states that are refitted as often."""


def write_predictions(model: Model, records: Sequence[Record], sensor: Sensor, path: str | PathLike[str]) -> None:
    """Write records as Parquet, beside a model's predictions of their readings over 1 s and the torque that it lacks.

    Columns rollout, t, torque, theta, theta_dot are the log, evenly sampled and in our conventions, which `read` brings
    back exactly. theta_predicted and theta_dot_predicted are what the model says of them, its state refitted every
    second; theta_residual and theta_dot_residual are measured less predicted; residual_torque (with residual_torque_sd)
    must act beyond the model from a row's time to the next. A cell without a value is null.

    Parameters
    ----------
    model : Model
        No number of it is touched.
    records : sequence of Record
        At least one rollout.
    sensor : Sensor
        Noise of the readings.
    path : path
        The file.

    Raises
    ------
    InvalidInput
        For records that do not fit the model, a file that cannot be written, and where pyarrow is not installed.
    """
    check_installed("pyarrow", "files", "writing Parquet")
    import pyarrow
    from pyarrow import parquet

    columns = predictions(model, records, sensor, residual_torque(model, records, sensor))
    content = BytesIO()
    parquet.write_table(pyarrow.table({k: pyarrow.array(v, from_pandas=True) for k, v in columns.items()}), content)
    save_file(path, content.getvalue())


def predictions(model: Model, records: Sequence[Record], sensor: Sensor, torque: ResidualTorque) -> dict[str, Array]:
    """The columns of `write_predictions`, all records one after the other; nan where there is no value."""
    records = check_records(model, records)
    tables = []
    courses = zip(records, throughout(model, records, sensor, AHEAD), torque.records, strict=True)
    for i, (record, said, beyond) in enumerate(courses):
        n = len(record) + 1
        known = np.isfinite(said.t)
        at = np.rint((said.t[known] - record.t[0]) / record.dt).astype(int)
        table = {"rollout": np.full(n, float(i)), "t": record.t, "torque": _filled(record.u, n)}
        for channel in CHANNELS:
            measured = getattr(record, channel)
            if measured is None or len(measured) < n or channel not in said.model:
                continue
            answer = np.full(n, np.nan)
            answer[at] = said.model[channel][known]
            table |= {channel: measured, f"{channel}_predicted": answer, f"{channel}_residual": measured - answer}
        tables.append(table | {"residual_torque": _filled(beyond.d, n), "residual_torque_sd": _filled(beyond.sd, n)})
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _filled(values: Array, n: int) -> Array:
    return np.append(values, np.full(n - len(values), np.nan))
