"""add: one named effect is added to a model, with the held-out error before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from sysid.data.json_file import plain_fields
from sysid.data.noise import sensor_noise
from sysid.data.record import Record, check_records
from sysid.data.sensor import UNITS, Sensor
from sysid.data.splitting import split
from sysid.diagnosis.findings import fitted_numbers, with_numbers
from sysid.errors import InvalidInput
from sysid.estimation.channels import relied_on
from sysid.estimation.estimate import Estimate
from sysid.estimation.first_fit import first_fit
from sysid.estimation.fit import free
from sysid.estimation.held_out import HeldOutError, held_out_error
from sysid.estimation.linearisation import Samples
from sysid.estimation.refits import extended, without_free
from sysid.estimation.scores import scores
from sysid.physics.effects import Effect, OutputEffect, effect
from sysid.physics.model import Model


@dataclass(frozen=True, eq=False, repr=False)
class Added:
    """An effect that was added to a model; it takes the place of effects with free numbers that it contains.

    Attributes
    ----------
    effect : str
        Its name.
    base, estimate : Estimate
        The fits without and with it.
    before, after : HeldOutError
        The errors of these fits on data that they have not seen.
    """

    effect: str
    base: Estimate
    estimate: Estimate
    before: HeldOutError
    after: HeldOutError

    @property
    def sentence(self) -> str:
        """How much the effect changes the held-out error."""
        effect = with_numbers(self.effect, fitted_numbers(self.estimate, self.effect))
        gone = [n for n in self.base.model.effect_names if n not in self.estimate.model.effect_names]
        effect += f" in place of {' and '.join(gone)}" if gone else ""
        fell = f"goes from {self.before.ratio:.3g} to {self.after.ratio:.3g} times the sensor noise"
        return f"{effect}: the error on held-out data {fell}"

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        errors = {"error_before": self.before.to_dict(), "error_after": self.after.to_dict()}
        return plain_fields(self, "effect", "estimate") | errors

    def __repr__(self) -> str:
        return f"{self.estimate}\n{self.sentence}"


def add(
    model: Model | Estimate,
    name: str,
    records: Sequence[Record],
    sensor: Sensor | None = None,
    hold_out: float | None = None,
) -> Added:
    """Refit a model without and with one more effect, which begins at the size that its score predicts.

    Parameters
    ----------
    model : Model or Estimate
        The model as it is. If it is an estimate, its free parameters are refitted and the others keep their numbers.
    name : str
        The effect's name in the catalogue.
    records : sequence of Record
        At least one rollout.
    sensor : Sensor, optional
        Noise of the readings; by default the estimate's, else found from the records without any model.
    hold_out : float, optional
        As in `diagnose`, the share or count of the records that no fit sees; the errors are those on them.

    Returns
    -------
    Added
        The refitted model with the effect, and the held-out errors before and after.

    Raises
    ------
    InvalidInput
        For an effect that is unknown, already there, excluded by another, or without any influence on these records.
    """
    added = effect(name)  # raises where it is unknown
    records = check_records(model.model if isinstance(model, Estimate) else model, records)
    names = free(model, records)
    if isinstance(model, Estimate):
        sensor, model = sensor or _sensor_of(model, added, records), model.model
    if name in model.effect_names:
        raise InvalidInput(f"the model has {name} already: expected an effect that it lacks")
    with_it = model.with_effect(added)  # raises where it is excluded
    training, held_out = split(records, hold_out)
    sensor = relied_on(with_it, training, sensor or sensor_noise(records).sensor)
    base = first_fit(Samples(model, training, sensor), model, names)
    begun = without_free(base, added.contains)
    score = scores(begun, (name,)).get(name)
    if score is None or not score.visible:
        raise InvalidInput(f"{name} changes nothing that this log shows: expected an effect that moves its readings")
    better = extended(begun, [score.best.at(score.sizes)])
    return Added(
        effect=name,
        base=base.estimate(),
        estimate=better.estimate(),
        before=held_out_error(base.model, held_out, sensor),
        after=held_out_error(better.model, held_out, sensor),
    )


def _sensor_of(estimate: Estimate, added: Effect, records: Sequence[Record]) -> Sensor | None:
    """The estimate's sensor; for an effect of a sensor with all channels, of which the estimate left out what it could
    not explain."""
    sensor = estimate.sensor
    if sensor is None or not isinstance(added, OutputEffect):
        return sensor
    return replace(sensor_noise(records).sensor, **{c: sd for c in UNITS if (sd := getattr(sensor, c)) is not None})
