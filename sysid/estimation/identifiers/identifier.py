"""Identifier: the interface of all identifiers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from sysid.data.record import Record
from sysid.estimation.estimate import Estimate
from sysid.physics.model import Model


class Identifier(Protocol):
    """An estimator of a model's parameters from records; its settings (which parameters, the sensor) are fields."""

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """The estimate, whose status says when it should not be trusted."""
        ...
