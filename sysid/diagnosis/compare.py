"""compare: how far off a model is on records that it never saw, and where."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from sysid.data.json_file import plain, plain_fields
from sysid.data.logs import notes_of
from sysid.data.record import Record, check_records
from sysid.data.sensor import Sensor
from sysid.diagnosis.causes import LARGE_SHARE, Cause, causes
from sysid.diagnosis.contacts import without_contacts
from sysid.diagnosis.findings import chance
from sysid.diagnosis.predictions import Prediction, predicted
from sysid.diagnosis.residual_torque import ResidualTorque, followed, torque_of
from sysid.diagnosis.whiteness import Whiteness, whiteness
from sysid.errors import InvalidInput
from sysid.estimation.channels import found_sensor
from sysid.estimation.estimate import Estimate
from sysid.estimation.held_out import (
    HeldOutError,
    WindowError,
    error_of,
    held_out_error,
    lead_of,
    multiple,
    refit_windows,
)
from sysid.estimation.linearisation import Samples
from sysid.estimation.output_error import CHANNELS
from sysid.estimation.prediction_error import Fit
from sysid.estimation.windows import cut
from sysid.physics.model import Model


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """A model compared to records. Errors are those of windows whose initial state is refitted (see HeldOutError).

    Attributes
    ----------
    errors : dict
        The errors over windows of some lengths, as HeldOutError: "one step", "0.5 s", "1 s" and "whole rollout".
    torque : ResidualTorque or None
        The torque that must act beyond the model, its means over theta, theta_dot, torque, time and over the states,
        and what it depends on; None if the model runs away within a sample.
    whiteness : dict
        The autocorrelation of the innovations of a filter with that torque as process noise, by channel.
    causes : tuple of Cause
        The known effects that explain the error, the strongest first.
    worst : tuple of Prediction
        The three windows of 1 s with the largest errors, as the model predicts them.
    records : tuple of Record
        The records that the model was compared with.
    sensor : Sensor
        The noise in whose units errors are given.
    units : dict
        The units of "theta", "theta_dot", "torque" and "time" for the model's plant.
    notes : tuple of str
        Notes that were made when the records were read.
    """

    errors: dict[str, HeldOutError]
    torque: ResidualTorque | None
    whiteness: dict[str, Whiteness]
    causes: tuple[Cause, ...]
    worst: tuple[Prediction, ...]
    records: tuple[Record, ...]
    sensor: Sensor
    units: dict[str, str]
    notes: tuple[str, ...] = ()

    @property
    def one_second(self) -> HeldOutError:
        """The error over windows of 1 s."""
        return self.errors["1 s"]

    @property
    def ratio(self) -> float:
        """The error over 1 s, in units of the sensor noise."""
        return self.one_second.ratio

    @property
    def off(self) -> bool:
        """Whether the error over 1 s is beyond the noise."""
        return self.one_second.beyond_noise

    @property
    def surprises(self) -> tuple[str, ...]:
        """Sentences on channels whose innovations are not white; a right model has none in 99 of 100 logs."""
        p = {c: w.p_value for c, w in self.whiteness.items()}
        return tuple(f"The innovations of {c} are not white ({chance(v)})." for c, v in p.items() if v * len(p) < 0.01)

    @property
    def adequate(self) -> bool:
        """Whether these records show nothing that the model lacks."""
        needed = self.torque is None or self.torque.present
        return not (self.off or self.causes or self.surprises or needed)

    @property
    def sentence(self) -> str:
        """Where the model fails, or that it does not."""
        if not math.isfinite(self.ratio):
            return "The model runs away from these records within 1 s: nothing can be said about where it fails."
        size = f"The model's error is {multiple(self.ratio)} times the sensor noise over 1 s"
        if self.adequate:
            return f"{size}: nothing is missing that these records show."
        described = [c.description for c in self.causes]
        left = 1.0 - sum(c.share for c in self.causes)
        if described and self.off and left > LARGE_SHARE:
            described.append(f"{left:.0%} of the squared error is something else")
        torque = [str(self.torque)] if self.torque is not None and self.torque.present else []
        said = f"{size}: {'; '.join(described)}" if described else size
        if self.off and not described and not torque:
            said += f"; it is worst in {place_of_window(self.one_second.worst[0])}"
        return " ".join([f"{said}.", *(torque or (() if described else self.surprises))])

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        others = {
            "records": [r.name for r in self.records],
            "noise": plain_fields(self.sensor, *CHANNELS),
            "errors": {name.replace(" ", "_"): e for name, e in self.errors.items()},
            "torque": None if self.torque is None else self.torque.to_dict(series=False),
        }
        return dict(plain(others)) | plain_fields(self, "units", "sentence", "adequate", "causes", "whiteness")

    def __repr__(self) -> str:
        shown, units = [c for c in CHANNELS if c in self.one_second.ratios], self.units
        noise = ", ".join(f"{c} {getattr(self.sensor, c):.3g} {units[c]}" for c in shown)
        lines = [f"{len(self.records)} rollout{'s' * (len(self.records) != 1)}, sensor noise {noise}"]
        head = "".join(f"{f'{c} [{units[c]}]':>20}{'x noise':>9}" for c in shown)
        lines.append(f"  {'error over':<14}{head}{'all':>9}")
        for name, error in self.errors.items():
            row = "".join(f"{getattr(error, c):>20.3g}{multiple(error.ratios[c]):>9}" for c in shown)
            lines.append(f"  {name:<14}{row}{multiple(error.ratio):>9}")
        white = ", ".join(f"{c} {'yes' if w.white else 'no'} ({chance(w.p_value)})" for c, w in self.whiteness.items())
        if white:
            lines.append(f"  innovations white: {white}")
        lines.append(
            "  worst windows: "
            + "; ".join(f"{place_of_window(w)} ({multiple(w.ratio)})" for w in self.one_second.worst)
        )
        return "\n".join([*lines, self.sentence])


def compare(
    model: Model | Estimate,
    records: Sequence[Record],
    sensor: Sensor | None = None,
    parameters: Sequence[str] | None = None,
) -> Comparison:
    """How far is a model off on records, where does it fail, and what would explain that?

    The errors are those of the model as it is; only the initial states of the windows are refitted. The torque that
    must act beyond it is found by the filter and smoother that also fit models. Causes are fitted beside the model.

    Parameters
    ----------
    model : Model or Estimate
        The model as it is.
    records : sequence of Record
        At least one rollout, preferably one that no fit has seen.
    sensor : Sensor, optional
        Noise of the readings; by default the estimate's, else found from the records as `fit` finds it.
    parameters : sequence of str, optional
        Names of parameters that were fitted before; by default the estimate's. They are refitted beside each cause,
        since what they can absorb is no evidence for a missing effect.

    Returns
    -------
    Comparison
        The errors over one step, 0.5 s, 1 s and whole rollouts, the residual torque and the known effects that explain
        it.

    Raises
    ------
    InvalidInput
        For records that do not fit the model or lack a channel that the sensor measures.
    """
    if isinstance(model, Estimate):
        sensor, parameters, model = sensor or model.sensor, parameters or model.names, model.model
    notes = notes_of(records)
    records, names = check_records(model, records), parameters or ()
    model.check_names(names)
    sensor, lead = sensor or found_sensor(model, records), lead_of(model)
    samples = Samples(model, records, sensor)
    fit = refit_windows(model, samples, cut(records, 1.0, lead))
    near = refit_windows(model, samples, cut(records, 0.5, lead), fit)
    one_second = error_of(fit, 1.0)
    followed_fit: Fit | None = None
    with suppress(InvalidInput):  # the model runs away within a sample
        followed_fit = followed(samples, model)
    torque = None if followed_fit is None else torque_of(followed_fit)
    return Comparison(
        errors={
            "one step": held_out_error(model, records, sensor, shortest(sensor) * model.dt, near),
            "0.5 s": error_of(near, 0.5),
            "1 s": one_second,
            "whole rollout": held_out_error(model, records, sensor, math.inf, fit),
        },
        torque=torque,
        whiteness={} if followed_fit is None else whiteness(followed_fit),
        causes=_causes(followed_fit, torque, names, one_second),
        worst=tuple(predicted(fit, [one_second.windows.index(w)], w.ratio) for w in one_second.worst),
        records=samples.records,
        notes=notes,
        sensor=sensor,
        units=model.plant.quantities,
    )


def _causes(
    fit: Fit | None, torque: ResidualTorque | None, names: Sequence[str], error: HeldOutError
) -> tuple[Cause, ...]:
    """The known effects that explain the error, found without the contacts."""
    if fit is None or torque is None or not (torque.present or error.beyond_noise) or not math.isfinite(error.ratio):
        return ()
    if torque.contacts:
        rest = without_contacts(fit.samples.records, torque.contacts)
        if not rest:
            return ()
        fit = followed(Samples(fit.model, rest, fit.samples.sensor), fit.model)
        error = held_out_error(fit.model, rest, fit.samples.sensor)
    return causes(fit, names, error)


def shortest(sensor: Sensor) -> int:
    """The instants of the shortest window that can be judged after its state is refitted: 2, or 3 with one channel."""
    return 2 if sensor.theta is not None and sensor.theta_dot is not None else 3


def place_of_window(window: WindowError) -> str:
    """The place of a window in the log, in words."""
    return f"{window.record} at {window.begin:.1f}-{window.end:.1f} s"
