"""Predictions: stretches of a log as they were read, and as models predict them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.estimation.held_out import Refit, error_of, lead_of, refit_windows
from sysid.estimation.linearisation import Samples
from sysid.estimation.output_error import CHANNELS
from sysid.estimation.windows import cut
from sysid.physics.model import Model
from sysid.physics.ops import Array

LONGEST_STRETCH = 10.0
"""Longest stretch [s] that is shown."""


class Prediction(NamedTuple):
    """A stretch of a rollout as it was read, and as a model predicts it.

    t (n,) are instants [s]; readings and model hold an array (n,) for each channel, in the plant's units; command (n,)
    is in `command_unit`. ratio is the error in units of the sensor noise.
    """

    record: str
    t: Array
    readings: dict[str, Array]
    model: dict[str, Array]
    command: Array
    command_unit: str
    ratio: float
    units: Mapping[str, str]


def typical(
    models: Sequence[Model], records: Sequence[Record], sensor: Sensor, ahead: float = math.inf
) -> tuple[Prediction, ...]:
    """A stretch of at most 10 s on which the first model's error is nearest to its median, predicted by each model from
    its first state, or `ahead` [s] at a time."""
    ahead = min(max(ahead, 1.0), LONGEST_STRETCH)
    samples = Samples(models[0], records, sensor)
    fits = [refit_windows(m, samples, cut(records, ahead, lead_of(m))) for m in models]
    errors = [np.array([w.ratio for w in error_of(f, ahead).windows]) for f in fits]
    owner = np.array([w.record for w in fits[0].response.windows])
    most = max(1, round(LONGEST_STRETCH / ahead))
    groups = [g[k : k + most] for g in (np.flatnonzero(owner == r) for r in set(owner)) for k in range(0, len(g), most)]
    mean = [[float(np.sqrt(np.mean(e[g] ** 2))) for g in groups] for e in errors]
    i = int(np.argsort(np.nan_to_num(mean[0], nan=np.inf))[len(groups) // 2])
    return tuple(predicted(f, groups[i].tolist(), m[i]) for f, m in zip(fits, mean, strict=True))


def throughout(model: Model, records: Sequence[Record], sensor: Sensor, ahead: float = 1.0) -> tuple[Prediction, ...]:
    """A model's predictions of each whole record, `ahead` [s] at a time, each window from its refitted state."""
    fit = refit_windows(model, Samples(model, records, sensor), cut(records, ahead, lead_of(model)))
    windows = error_of(fit, ahead).windows
    owner = np.array([w.record for w in fit.response.windows])
    windows_of = (np.flatnonzero(owner == k).tolist() for k in range(len(records)))
    return tuple(predicted(fit, at, float(np.sqrt(np.mean([windows[k].ratio ** 2 for k in at])))) for at in windows_of)


def predicted(fit: Refit, windows: Sequence[int], ratio: float) -> Prediction:
    """The predictions of successive windows of one record; a nan behind each keeps plots from joining them."""
    response, times, commands = fit.response, list[Array](), list[Array]()
    e, read = fit.lin.e.reshape(response.y.shape), response.weight > 0.0
    seen = [c for row, c in enumerate(CHANNELS) if read[:, row].any()]
    readings: dict[str, list[Array]] = {c: [] for c in seen}
    model: dict[str, list[Array]] = {c: [] for c in seen}
    for k in windows:
        at = read[k].any(axis=0)
        times.append(np.append(response.time[k, at], np.nan))
        intervals = response.interval[k, np.flatnonzero(at).clip(max=response.windows[k].count - 1)]
        commands.append(np.append(response.commands[intervals], np.nan))
        for c in seen:
            row = CHANNELS.index(c)
            left = np.divide(e[k, row], response.weight[k, row], out=np.full(len(at), np.nan), where=read[k, row])
            y = np.where(read[k, row], response.y[k, row], np.nan)
            readings[c].append(np.append(y[at], np.nan))
            model[c].append(np.append((y - left)[at], np.nan))
    return Prediction(
        record=response.samples.records[response.windows[windows[0]].record].name,
        t=np.concatenate(times),
        readings={c: np.concatenate(v) for c, v in readings.items()},
        model={c: np.concatenate(v) for c, v in model.items()},
        command=np.concatenate(commands),
        command_unit=response.model.command_unit,
        ratio=ratio,
        units=response.model.plant.quantities,
    )
