"""Fisher information: how exactly readings determine a model's parameters, whatever the estimator."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.data.record import Record, check_direct
from sysid.data.sensor import Sensor
from sysid.errors import InvalidInput
from sysid.estimation.disturbances import NO_DISTURBANCE
from sysid.estimation.linearisation import LinearisedModel, Motion, Samples
from sysid.estimation.output_error import Response
from sysid.estimation.windows import cut
from sysid.physics.model import Model, check_model
from sysid.physics.ops import Array


def fisher_information(
    model: Model, names: Sequence[str], records: Sequence[Record], sensor: Sensor, starts: Array
) -> Array:
    """The information that readings carry about parameters, at the model's own numbers.

        F = Z'Z,    Z = d(whitened innovations) / dp

    Z is taken along the motion from the given starts, without disturbances; the initial states count as unknown. The
    inverse of F is the Cramer-Rao bound of every unbiased estimate.

    Parameters
    ----------
    model : Model
        The model with its numbers.
    names : sequence of str
        The P parameters.
    records : sequence of Record
        The R rollouts: their commands and which channels are read when.
    sensor : Sensor
        Noise of the readings.
    starts : array (R, 2)
        The initial states, theta [rad] and theta_dot [rad/s].

    Returns
    -------
    array (P, P)
        In inverse squares of the parameters' units.

    Raises
    ------
    InvalidInput
        For an unknown parameter, and for starts of another shape.
    """
    check_model(model)
    model.check_names(names)
    check_direct(model, "fisher_information")
    samples = Samples(model, records, sensor)
    if np.shape(starts) != (len(samples.records), 2):
        raise InvalidInput(
            f"starts has shape {np.shape(starts)}: expected ({len(samples.records)}, 2), theta and theta_dot a record"
        )
    rolled = Response(model, samples, cut(samples.records)).states(np.asarray(starts, dtype=float))
    x = np.concatenate([states[: len(r) + 1] for states, r in zip(rolled, samples.records, strict=True)])
    along = LinearisedModel(samples, model, Motion(x, np.zeros(len(x)), np.zeros((len(x), 3))))
    Z = along.system.filter(NO_DISTURBANCE).whiten(*along.changes(names))
    return Z.T @ Z
