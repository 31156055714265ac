"""Past torque: whether what a model leaves of the readings still knows of the commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.comparison.held_out import finite
from sysid.comparison.residuals import Residuals
from sysid.records import Array

LONGEST = 0.25
"""How long ago [s]."""


@dataclass(frozen=True, eq=False)
class PastTorque:
    """Correlation r (M,) of the residual with the command of `lags` (M,) samples ago, as it would show in the readings.

        r_i = z_i'e / (|z_i| |e|),   z_i how the readings would move if u(k - i) acted beyond the model

    Residuals that know nothing of the command stay within +- band (99 %). p_value: of the F test that none of these
    commands acts beyond the model. Negative lags are rows to come.
    """

    lags: NDArray[np.intp]
    correlation: Array
    band: float
    p_value: float

    @property
    def independent(self) -> bool:
        """Whether the residual knows no more of the commands than in 99 of 100 logs of a perfect model."""
        return self.p_value >= 0.01

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        numbers = {"lags": self.lags.tolist(), "correlation": self.correlation.tolist()}
        return {**numbers, "band": self.band, "p_value": finite(self.p_value)}


def lags_of(dt: float) -> NDArray[np.intp]:
    """-2 ... 8 samples one by one, then further apart up to a quarter of a second."""
    longest = max(8, round(LONGEST / dt))
    return np.unique(np.concatenate([np.arange(-2, 9), np.linspace(8, longest, 13).round().astype(int)]))


def past_torque(residuals: Residuals, late: Array, lags: NDArray[np.intp]) -> PastTorque:
    """From the directions `late` (rows, M) of the commands at `lags` (M,)."""
    size = np.linalg.norm(late, axis=0) * np.linalg.norm(residuals.e)
    correlation = np.divide(late.T @ residuals.e, size, out=np.zeros(len(lags)), where=size > 0.0)
    return PastTorque(lags, correlation, 2.5758 / residuals.degrees**0.5, residuals.explain(late).p_value)
