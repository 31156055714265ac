"""Prior: what is vaguely known of the parameters before any reading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.physics.model import Model
from sysid.physics.ops import Array


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normals of the parameters about `mean` (P,), of `precision` (P,) = 1 / sd^2. Where a parameter is
    `positive` (P,), its logarithm is normal about log mean, so that no inertia vanishes."""

    mean: Array
    precision: Array
    positive: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        model: Model,
        names: Sequence[str],
        vague: float,
        torque: float,
        known: Prior | None,
        known_names: Sequence[str],
    ) -> Prior:
        """The prior of a model's parameters; those among `known_names` keep what is `known` of them.

        A number of the plant has an sd of the share `vague` of it. The torque of an effect has an sd of `torque` [N m]
        about neutral: two that no motion tells apart (friction and an offset of a joint that turns one way) would
        otherwise run away against each other.
        """
        kept = dict(zip(known_names, zip(known.mean, known.precision, strict=True), strict=True)) if known else {}
        mean, precision = model.numbers(names), np.zeros(len(names))
        positive = np.array([model.parameters[n].bounds[0] > 0.0 for n in names], dtype=bool)
        for i, name in enumerate(names):
            if name in kept:
                mean[i], precision[i] = kept[name]
            elif name in model.plant.parameters and mean[i] != 0.0:
                precision[i] = (vague * (1.0 if positive[i] else mean[i])) ** -2.0
            elif model.parameters[name].is_torque and torque > 0.0:
                mean[i], precision[i] = model.parameters[name].neutral, torque**-2.0
        return cls(mean, precision, positive)

    def deviance(self, values: Array) -> float:
        """-2 log density at values (P,), up to a constant."""
        return float(np.sum(self.rows(values)[1] ** 2))

    def rows(self, values: Array) -> tuple[Array, Array]:
        """Sensitivities (P, P) and residuals (P,) to append to those of the readings in a least-squares problem."""
        weight = np.sqrt(self.precision)
        slope = np.where(self.positive, 1.0 / np.maximum(values, 1e-300), 1.0)
        off = np.where(self.positive, np.log(np.maximum(self.mean, 1e-300) * slope), self.mean - values)
        return np.diag(weight * slope), weight * off
