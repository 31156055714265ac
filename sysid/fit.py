"""fit: the short way from a log to a model with honest numbers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from sysid.diagnosis.candidates import extent_of
from sysid.errors import InvalidInput
from sysid.estimate import Estimate
from sysid.identify.gauss_newton import Fit, fit_longest
from sysid.identify.identifier import free_parameters
from sysid.identify.start import parameter_starts
from sysid.model import Model
from sysid.parameters import NEVER
from sysid.records import Array, Record, check_records
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
    records = check_records(model, records)
    p = _begins(model, names, records)
    return fit_longest(model, names, records, sensor, p, near, lead=lead_of(model))


def _begins(model: Model, names: Sequence[str], records: Sequence[Record]) -> list[Array]:
    """The model's own numbers (P,); a limit that stands at "never" has no slope there, and begins at its probes."""
    parameters, extent = free_parameters(model, names), extent_of(records)
    own = next(parameter_starts(parameters)).tolist()
    tried = [
        p.probes(extent) if p.never and abs(float(p.value)) >= NEVER else (number,)
        for p, number in zip(parameters, own, strict=True)
    ]
    return [np.array(numbers) for numbers in itertools.product(*tried)]


def fit(
    model: Model, records: Sequence[Record], sensor: Sensor | None = None, parameters: Sequence[str] | None = None
) -> Estimate:
    """Fit a model to records by output error: whole rollouts where the model can follow them, else shorter windows.

        min_{p, x_0}  sum_windows sum_k |(y_k - yhat_k(x_0, p)) / sd|^2    within the bounds of p

    parameters   the names that are free; by default all but gravity
    sensor       the noise of the readings; by default found from the records without any model

    Raises InvalidInput for unusable records or unknown names.
    """
    records = check_records(model, records)
    if sensor is None:
        from sysid.noise import sensor_noise

        sensor = sensor_noise(records).sensor
    names = free(model) if parameters is None else tuple(parameters)
    if not names:
        raise InvalidInput("nothing is left to fit: every parameter is fixed")
    return fitted(model, names, records, sensor).estimate()
