"""fit: from a log to a fitted model with its uncertainty in one call."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.data.checks import check_excitation
from sysid.data.record import Record, check_records
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.estimation.channels import found_sensor
from sysid.estimation.estimate import Estimate
from sysid.estimation.first_fit import first_fit
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended
from sysid.estimation.scores import score
from sysid.estimation.solver import fit_parameters as prediction_error
from sysid.physics.candidates import candidates_for
from sysid.physics.model import Model, check_model
from sysid.physics.parameters import Parameter


def free(model: Model | Estimate, records: Sequence[Record] = ()) -> tuple[str, ...]:
    """The parameters that a fit frees by default: those of an estimate, or all of a model but those that are known,
    such as gravity; in both cases without what free swings do not show (`without_scale`)."""
    if isinstance(model, Estimate):
        return without_scale(model.model, model.names, records)
    return without_scale(model, [name for name, p in model.parameters.items() if not p.known], records)


def without_scale(model: Model, names: Sequence[str], records: Sequence[Record]) -> tuple[str, ...]:
    """The names without the scale of all torques (`Plant.scale`) if the records are free swings, which cannot show it:
    all torques are 0, no servo is told positions, and the weight is not known."""
    plant = model.plant
    swings = bool(records) and not model.at_angle and not any(record.driven for record in records)
    weighed = plant.gravity and plant.gravity not in names and float(plant.largest_gravity_torque) > 0.0
    return tuple(name for name in names if not (swings and not weighed and name == plant.scale))


def free_parameters(model: Model, names: Sequence[str]) -> list[Parameter]:
    """The parameters to fit, checked: at least one, known to the model, none twice. Raises InvalidInput."""
    check_model(model)
    model.check_names(names)
    if len(names) == 0:
        raise InvalidInput(f"no parameters to fit: choose among {', '.join(model.parameters)}")
    known = model.parameters
    return [known[n] for n in names]


def fit(
    model: Model, records: Sequence[Record], sensor: Sensor | None = None, parameters: Sequence[str] | None = None
) -> Estimate:
    """Fit a model to records by the prediction-error method, beside a random torque if the log asks for one.

        min_p  sum_k log det S_k + |e_k|^2,    e_k innovations whitened by their predicted covariance S_k

    Where the model explains the log, this is output error over whole rollouts. Where the model lacks something, a
    random torque stands for that, and the intervals are as wide as what is missing makes them.

    Parameters
    ----------
    model : Model
        The model at whose numbers the fit begins; they may be off by any factor.
    records : sequence of Record
        At least one rollout.
    sensor : Sensor, optional
        Noise of the readings. By default it is found from the records without any model, and the speed is left out
        where it tells little beside the angle or is not the angle's (`sysid.estimation.channels.relied_on`).
    parameters : sequence of str, optional
        The names of the free parameters; the others keep their numbers. By default all are free but what is known, such
        as g, and what sets the scale of all torques in free swings, such as m or J.

    Returns
    -------
    Estimate
        The fitted model with its covariance; `random_torque` says how large a torque acts beside it.

    Raises
    ------
    InvalidInput
        For unusable records and unknown names.
    """
    records = check_records(model, records)
    parameters = free(model, records) if parameters is None else parameters
    model.check_names(parameters)
    if not parameters:
        raise InvalidInput("nothing is left to fit: every parameter that these records can show is fixed")
    sensor = sensor or found_sensor(model, records)
    check_excitation(records, sensor)
    return _from_neutral(Samples(model, records, sensor), model, tuple(parameters)).estimate()


def _from_neutral(samples: Samples, model: Model, names: tuple[str, ...]) -> Fit:
    """The fit of a model of which some effects change nothing yet: each begins at the size that its score predicts.

    At neutral a friction or a delay may have no slope to follow, and a limit that is never reached has none at all.
    """
    idle = [e for e in model.effects if e.idle and set(model.names_of(e.name)) <= set(names)]
    if not idle:
        return first_fit(samples, model, names)
    plain = model
    for effect in idle:
        plain = plain.without_effect(effect.name)
    now = first_fit(samples, plain, [n for n in names if n in plain.parameters])
    for effect in idle:
        scored = score(now, candidates_for(type(effect), samples.extent(plain, type(effect))))
        begun = scored.best.at(scored.sizes) if scored else effect
        sized = effect.with_parameters({k: float(p.value) for k, p in begun.parameters.items()})
        now = extended(now, [sized])
    numbers = {n: float(now.model.parameters[n].value) for n in names}
    return prediction_error(samples, model.with_parameters(numbers), names, now)
