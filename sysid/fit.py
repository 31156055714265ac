"""fit: the short way from a log to a model with honest numbers."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.errors import InvalidInput
from sysid.estimate import Estimate
from sysid.identify.gauss_newton import Fit, fit_longest
from sysid.identify.identifier import free_parameters
from sysid.model import Model
from sysid.records import Record, check_records
from sysid.sensor import Sensor


def free(model: Model) -> tuple[str, ...]:
    """What a fit leaves free where nothing is said: every parameter but gravity."""
    return tuple(name for name in model.parameters if name != "g")


def lead_of(model: Model) -> float:
    """Seconds before a window that fill the memory of the model's sensors."""
    memory = [e for e in model.output_effects if e.rest(0.0, 0.0, model.dt)]
    return max((float(getattr(e, "longest", 0.3)) for e in memory), default=0.0)


def fitted(
    model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor, near: Fit | None = None
) -> Fit:
    """The fit at the longest horizon that the model follows, begun at its own numbers."""
    free_parameters(model, names)
    return fit_longest(model, names, check_records(model, records), sensor, near=near, lead=lead_of(model))


def fit(
    model: Model, records: Sequence[Record], sensor: Sensor | None = None, parameters: Sequence[str] | None = None
) -> Estimate:
    """Fit a model to records by output error: whole rollouts where the model can follow them, else shorter windows.

        min_{p, x_0}  sum_windows sum_k |(y_k - yhat_k(x_0, p)) / sd|^2    within the bounds of p

    parameters   the names that are free; by default all but gravity
    sensor       the noise of the readings; by default found from the records without any model

    Raises InvalidInput for unusable records or unknown names.
    """
    if sensor is None:
        from sysid.noise import sensor_noise

        sensor = sensor_noise(records).sensor
    names = free(model) if parameters is None else tuple(parameters)
    if not names:
        raise InvalidInput("nothing is left to fit: every parameter is fixed")
    return fitted(model, names, records, sensor).estimate()
