"""compare: how far a model is off on records that it never saw, and where."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.comparison.causes import Cause, causes
from sysid.comparison.held_out import (
    HeldOutError,
    Refit,
    WindowError,
    error_of,
    held_out_error,
    lead_of,
    multiple,
    refit_windows,
)
from sysid.comparison.past_torque import PastTorque, lags_of, past_torque
from sysid.comparison.residual_map import Curve, ResidualMap, curve_of, map_of, shapes
from sysid.comparison.residuals import Residuals
from sysid.comparison.whiteness import Whiteness, whiteness
from sysid.estimate import Estimate
from sysid.model import Model
from sysid.records import Array, Record, check_records
from sysid.response import CHANNELS
from sysid.sensor import Sensor
from sysid.windows import cut

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNITS = {"theta": "rad", "theta_dot": "rad/s"}


@dataclass(frozen=True, eq=False)
class Trace:
    """One window: its error, and by measured channel the readings and what the model says (n,) at t (n,) [s]."""

    error: WindowError
    t: Array
    readings: dict[str, Array]
    model: dict[str, Array]


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model against records. Errors are those of windows whose state is refitted, leverage out (see HeldOutError).

    one_step, half_second, one_second, whole   the error over windows of that length
    curves      the torque that the readings need beyond the model, over theta, theta_dot, torque and time, each alone
    map         the same over theta and theta_dot together
    past        correlation of the residual with past torque
    whiteness   autocorrelation of the innovations, by channel
    causes      the quantities that together explain the error, the strongest first
    worst       the three worst windows of 1 s
    apart       a window whose error is beyond all others' (a hand, perhaps), which curves, map and causes leave out
    records     their names; sensor: the noise that errors are multiples of
    """

    one_step: HeldOutError
    half_second: HeldOutError
    one_second: HeldOutError
    whole: HeldOutError
    curves: dict[str, Curve]
    map: ResidualMap
    past: PastTorque
    whiteness: dict[str, Whiteness]
    causes: tuple[Cause, ...]
    worst: tuple[Trace, ...]
    apart: WindowError | None
    records: tuple[str, ...]
    sensor: Sensor

    @property
    def errors(self) -> dict[str, HeldOutError]:
        """The errors by the horizon's name."""
        return {
            "one step": self.one_step,
            "0.5 s": self.half_second,
            "1 s": self.one_second,
            "whole rollout": self.whole,
        }

    @property
    def ratio(self) -> float:
        """Error over 1 s in units of the sensor noise."""
        return self.one_second.ratio

    @property
    def off(self) -> bool:
        """Whether the error over 1 s is beyond the noise: by 5 %, and by more than 99 of 100 perfect models show."""
        error = self.one_second
        degrees = max(1, error.n_readings - 2 * error.n_windows)
        return not error.ratio**2 < 1.0 + max(2.33 * math.sqrt(2.0 / degrees), 1.05**2 - 1.0)

    @property
    def surprises(self) -> tuple[str, ...]:
        """What the residuals of a perfect model would show in one of 100 logs: colour, correlation with the torque."""
        p = {f"the residuals of {c} are not white": w.p_value for c, w in self.whiteness.items()}
        p["the residuals are correlated with the torque"] = self.past.p_value
        return tuple(f"{words} (p = {value:.2g})" for words, value in p.items() if value * len(p) < 0.01)

    @property
    def adequate(self) -> bool:
        """Whether these records show nothing that the model lacks."""
        return not (self.off or self.causes or self.surprises)

    @property
    def sentence(self) -> str:
        """Where the model fails, or that it does not."""
        size = f"{multiple(self.ratio)} times the sensor noise over 1 s"
        if self.apart is not None:
            others = [w.ratio**2 for w in self.one_second.windows if w is not self.apart]
            rest = multiple(math.sqrt(sum(others) / len(others)))
            size += f" ({rest} without {place(self.apart)}, which is like no other)"
        if self.adequate:
            return f"The model's error is {size}: nothing is missing that these records show."
        if not math.isfinite(self.ratio):
            return "The model runs away from these records within 1 s: nothing can be said about where it fails."
        if self.causes:
            words = "; ".join(c.words for c in self.causes)
            left = 1.0 - sum(c.share for c in self.causes)
            rest = f"; {left:.0%} of the squared error depends on something else" if left > 0.3 and self.off else ""
            return f"The model's error is {size}: {words}{rest}."
        if self.off and self.apart is None:
            where, looked = self.worst[0].error, ", ".join(self.curves)
            return f"The model's error is {size}, and depends on none of {looked}; it is worst in {place(where)}."
        return f"The model's error is {size}{', but ' * bool(self.surprises)}{' and '.join(self.surprises)}."

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return {
            "records": list(self.records),
            "noise": {c: getattr(self.sensor, c) for c in CHANNELS},
            "errors": {name.replace(" ", "_"): e.to_dict() for name, e in self.errors.items()},
            "sentence": self.sentence,
            "adequate": self.adequate,
            "apart": None if self.apart is None else self.apart.to_dict(),
            "causes": [c.to_dict() for c in self.causes],
            "curves": {name: c.to_dict() for name, c in self.curves.items()},
            "map": self.map.to_dict(),
            "past_torque": self.past.to_dict(),
            "whiteness": {c: w.to_dict() for c, w in self.whiteness.items()},
        }

    def __str__(self) -> str:
        shown = [c for c in CHANNELS if c in self.one_second.ratios]
        noise = ", ".join(f"{c} {getattr(self.sensor, c):.3g} {UNITS[c]}" for c in shown)
        lines = [f"{len(self.records)} rollout{'s' * (len(self.records) != 1)}, sensor noise {noise}"]
        head = "".join(f"{f'{c} [{UNITS[c]}]':>20}{'x noise':>9}" for c in shown)
        lines.append(f"  {'error over':<14}{head}{'all':>9}")
        for name, error in self.errors.items():
            row = "".join(f"{getattr(error, c):>20.3g}{multiple(error.ratios[c]):>9}" for c in shown)
            lines.append(f"  {name:<14}{row}{multiple(error.ratio):>9}")
        white = ", ".join(f"{c} {'yes' if w.white else 'no'} (p = {w.p_value:.2g})" for c, w in self.whiteness.items())
        free = f"{'yes' if self.past.independent else 'no'} (p = {self.past.p_value:.2g})"
        lines.append(f"  residuals white: {white}; independent of the torque: {free}")
        lines.append(
            "  worst windows: " + "; ".join(f"{place(w.error)} ({multiple(w.error.ratio)})" for w in self.worst)
        )
        return "\n".join([*lines, self.sentence])

    def plot(self) -> Figure:
        """All of it in one figure."""
        from sysid.plotting import comparison

        return comparison(self)


def compare(model: Model | Estimate, records: Sequence[Record], sensor: Sensor | None = None) -> Comparison:
    """How far a model is off on records, and where: no parameter is touched, only the windows' states are refitted.

    sensor: the noise of the readings; by default an estimate's own, else found from the records without any model.
    Raises InvalidInput for records that do not fit the model or lack a channel that the sensor measures.
    """
    if isinstance(model, Estimate):
        sensor, model = sensor or getattr(model, "sensor", None), model.model
    records = check_records(model, records)
    if sensor is None:
        from sysid.noise import sensor_noise

        sensor = sensor_noise(records).sensor
    lead = lead_of(model)
    fit = refit_windows(model, records, sensor, cut(records, 1.0, lead))
    near = refit_windows(model, records, sensor, cut(records, 0.5, lead), fit)
    one_second = error_of(fit, 1.0)
    apart = _apart(one_second)
    residuals = Residuals(fit, near, () if apart is None else (one_second.windows.index(apart),))
    found = shapes(residuals)
    seen = {name: residuals.seen(shape.values) for name, shape in found.items()}
    lags = lags_of(model.dt)
    late = residuals.seen(np.stack([residuals.command(int(lag)) for lag in lags], axis=-1))
    return Comparison(
        one_step=held_out_error(model, records, sensor, shortest(sensor) * model.dt, near),
        half_second=error_of(near, 0.5),
        one_second=one_second,
        whole=held_out_error(model, records, sensor, math.inf, fit),
        curves={name: curve_of(residuals, name, shape, seen[name]) for name, shape in found.items()},
        map=map_of(residuals),
        past=past_torque(residuals, late, lags),
        whiteness=whiteness(fit),
        causes=causes(residuals, found, seen, late, lags),
        worst=_worst(fit, one_second),
        apart=apart,
        records=tuple(r.name for r in records),
        sensor=sensor,
    )


def shortest(sensor: Sensor) -> int:
    """Instants of the shortest window that leaves something to judge: two, or three where one channel is measured."""
    return 2 if sensor.theta is not None and sensor.theta_dot is not None else 3


def place(window: WindowError) -> str:
    """Where a window is."""
    return f"{window.record} at {window.begin:.1f}-{window.end:.1f} s"


def _apart(error: HeldOutError) -> WindowError | None:
    """The worst window, where its error is above 4 and above four times that of any but its neighbours."""
    first = error.worst[0]
    at = error.windows.index(first)
    others = [w.ratio for i, w in enumerate(error.windows) if abs(i - at) > 1]
    return first if len(others) >= 3 and first.ratio > 4.0 * max(1.0, *others) else None


def _worst(fit: Refit, error: HeldOutError) -> tuple[Trace, ...]:
    response = fit.response
    e = fit.lin.e.reshape(response.y.shape)
    traces = []
    for window in error.worst:
        i = error.windows.index(window)
        read = response.weight[i] > 0.0
        at = np.flatnonzero(read.any(axis=0))
        readings, model = {}, {}
        for row, channel in enumerate(CHANNELS):
            if read[row].any():
                y = np.where(read[row], response.y[i, row], np.nan)
                left = np.divide(e[i, row], response.weight[i, row], out=np.zeros(len(y)), where=read[row])
                readings[channel], model[channel] = y[at], (y - left)[at]
        traces.append(Trace(window, response.time[i, at], readings, model))
    return tuple(traces)
