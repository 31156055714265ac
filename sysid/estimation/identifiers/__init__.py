"""Identifiers: estimators behind one interface, from records to an Estimate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from sysid.data.record import Record
from sysid.estimation.estimate import Estimate
from sysid.estimation.identifiers.grid import GridSearch
from sysid.estimation.identifiers.least_squares import LeastSquares
from sysid.estimation.identifiers.unscented import UnscentedKalman
from sysid.physics.model import Model


class Identifier(Protocol):
    """An estimator that fits parameters of a model to records.

    Notes
    -----
    Settings (which parameters, the sensor) are its fields.
    """

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """Fit the parameters to the records.

        Parameters
        ----------
        model : Model
            The model whose parameters are fitted.
        records : sequence of Record
            At least one rollout.

        Returns
        -------
        Estimate
            The estimate; it says in its status when it should not be trusted.
        """
        ...
