"""Whiteness: a test of whether a filter's innovations are white noise, as those of a right model are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sysid.estimation.likelihood import SIGMA_99, p_value
from sysid.estimation.output_error import CHANNELS
from sysid.estimation.prediction_error import Fit
from sysid.physics.ops import Array

_UNKNOWN = 1e4
"""Variance of an innovation, in units of the noise's, above which it was not predicted from earlier readings at all."""
_MOST_LAGS = 20


@dataclass(frozen=True, eq=False)
class Whiteness:
    """The autocorrelation r (M,) of one channel's innovations w at lags 1 ... M [samples], with its 99 % band (M,).

    r_i = (mean of w_k w_(k+i)) / (mean of w_k^2),   Q = sum n_i r_i^2 ~ chi2_M    with n_i pairs of readings

    p_value belongs to Q (Ljung and Box, Biometrika 65 (1978) 297, with the number of pairs that there are).
    """

    lags: Array
    correlation: Array
    band: Array
    p_value: float

    @property
    def white(self) -> bool:
        """Whether Q is no larger than for 99 of 100 white sequences."""
        return self.p_value >= 0.01


def whiteness(fit: Fit) -> dict[str, Whiteness]:
    """The whiteness of the filter's innovations, for each channel with at least 20 of them."""
    filter, follows = fit.filter, fit.samples.follows
    known = np.any(fit.linearised.system.H != 0.0, axis=2) & (filter.log_variances < math.log(_UNKNOWN))
    w = np.where(known, filter.innovations, np.nan)
    ends = np.flatnonzero(~follows)[:-1] + 1
    return {
        channel: _autocorrelation(np.split(w[:, row], ends))
        for row, channel in enumerate(CHANNELS)
        if np.count_nonzero(known[:, row]) >= 20
    }


def _autocorrelation(sequences: list[Array]) -> Whiteness:
    """The whiteness of sequences of innovations, nan where there is none; no pair reaches from one into another."""
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
