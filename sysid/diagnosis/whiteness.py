"""Whiteness: whether what a filter's predictions leave of the readings is noise without memory."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sysid.estimation.likelihood import SIGMA_99, p_value
from sysid.estimation.output_error import CHANNELS
from sysid.estimation.prediction_error import Fit
from sysid.physics.ops import Array

_UNKNOWN = 1e4
"""Variance of a prediction, in units of the noise's, above which the readings before say nothing of a reading."""
_MOST_LAGS = 20


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation r (M,) of one channel's innovations at lags 1 ... M [samples], whose 99 % band is +- band (M,).

    r_i = (mean of w_k w_(k+i)) / (mean of w_k^2),   Q = sum n_i r_i^2 ~ chi2_M    with n_i pairs of readings

    p_value is that of Q (Ljung and Box, Biometrika 65 (1978) 297, with the pairs that there are).
    """

    lags: Array
    correlation: Array
    band: Array
    p_value: float

    @property
    def white(self) -> bool:
        """Whether Q lies within what 99 of 100 white sequences show."""
        return self.p_value >= 0.01


def whiteness(found: Fit) -> dict[str, Whiteness]:
    """Of the filter's innovations, by channel that has at least 20 of them."""
    filter, follows = found.filter, found.samples.follows
    known = np.any(found.linearised.system.H != 0.0, axis=2) & (filter.log_variances < math.log(_UNKNOWN))
    w = np.where(known, filter.innovations, np.nan)
    ends = np.flatnonzero(~follows)[:-1] + 1
    return {
        channel: _autocorrelation(np.split(w[:, row], ends))
        for row, channel in enumerate(CHANNELS)
        if np.count_nonzero(known[:, row]) >= 20
    }


def _autocorrelation(sequences: list[Array]) -> Whiteness:
    """Of sequences, nan where there is no innovation; pairs lie within one sequence."""
    power = float(np.nanmean(np.concatenate(sequences) ** 2))
    lags, correlation, pairs = list[int](), list[float](), list[int]()
    for i in range(1, _MOST_LAGS + 1):
        products = np.concatenate([w[:-i] * w[i:] for w in sequences])
        count = int(np.isfinite(products).sum())
        if count >= 10:
            lags.append(i)
            correlation.append(float(np.nanmean(products)) / power)
            pairs.append(count)
    r, n = np.array(correlation), np.array(pairs, dtype=float)
    return Whiteness(np.array(lags, dtype=float), r, SIGMA_99 / np.sqrt(n), p_value(float(np.sum(n * r**2)), len(r)))
