"""The one interface of all identifiers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from sysid.data.record import Record
from sysid.errors import InvalidInput
from sysid.estimation.estimate import Estimate
from sysid.physics.model import Model
from sysid.physics.parameters import Parameter


class Identifier(Protocol):
    """Fits parameters of a model to records. Settings (which parameters, the sensor) are its fields."""

    def fit(self, model: Model, records: Sequence[Record]) -> Estimate:
        """The estimate; it says in its status when it should not be trusted."""
        ...


def free_parameters(model: Model, names: Sequence[str]) -> list[Parameter]:
    """The parameters to fit, checked: at least one, known to the model, none twice. Raises InvalidInput."""
    if isinstance(names, str):
        raise InvalidInput(f"parameters = {names!r}: expected a list of names, such as [{names!r}]")
    if len(names) == 0:
        raise InvalidInput(f"no parameters to fit: choose among {', '.join(model.parameters)}")
    if len(set(names)) < len(names):
        raise InvalidInput(f"a parameter is named twice in {', '.join(names)}")
    model.check_names(names)
    known = model.parameters
    return [known[n] for n in names]
