"""Whiteness: whether what a model leaves of the readings is noise without memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc

from sysid.comparison.held_out import Refit
from sysid.records import Array
from sysid.response import CHANNELS

_VAGUE = 1e8
"""Prior variance of a window's start [rad^2], [rad^2/s^2]: nothing is known of it."""
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

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        numbers = {name: getattr(self, name).tolist() for name in ("lags", "correlation", "band")}
        return {**numbers, "p_value": self.p_value}


def whiteness(fit: Refit) -> dict[str, Whiteness]:
    """By channel that has at least 20 innovations."""
    w = innovations(fit).reshape(len(fit.starts), 2, -1)
    return {
        channel: _autocorrelation(w[:, row])
        for row, channel in enumerate(CHANNELS)
        if np.isfinite(w[:, row]).sum() >= 20
    }


def innovations(fit: Refit) -> Array:
    """Each reading less its prediction from those before it in its window, in units of the prediction's sd (K, R).

    Independent and of variance 1 for a perfect model, while residuals about a fitted state are not (recursive
    residuals: Brown, Durbin and Evans, J. R. Stat. Soc. B 37 (1975) 149). nan where nothing before tells.
    """
    K, R = fit.lin.e.shape
    instants = R // 2
    e, S, scored = np.where(np.isfinite(fit.lin.e), fit.lin.e, 0.0), fit.lin.S_x, fit.scored > 0.0
    w = np.full((K, R), np.nan)
    x, P = np.zeros((K, 2)), np.tile(_VAGUE * np.eye(2), (K, 1, 1))
    for i in (row * instants + k for k in range(instants) for row in range(2)):
        h = S[:, i]
        Ph = np.einsum("kij,kj->ki", P, h)
        variance = np.einsum("ki,ki->k", h, Ph)
        surprise = e[:, i] - np.einsum("ki,ki->k", h, x)
        gain = Ph / (1.0 + variance)[:, None]
        known = scored[:, i] & (variance < _UNKNOWN)
        w[known, i] = (surprise / np.sqrt(1.0 + variance))[known]
        x = x + gain * surprise[:, None]
        P = P - gain[:, :, None] * Ph[:, None, :]
    return w


def _autocorrelation(w: Array) -> Whiteness:
    """Of sequences w (K, n), nan where there is none; pairs lie within one sequence."""
    lags = np.arange(1, max(2, min(_MOST_LAGS + 1, w.shape[1] // 2)))
    power = float(np.nanmean(w**2))
    products = [w[:, :-i] * w[:, i:] for i in lags]
    pairs = np.array([np.isfinite(p).sum() for p in products], dtype=float)
    used = pairs > 0.0
    lags, pairs = lags[used], pairs[used]
    r = np.array([np.nanmean(p) for p, u in zip(products, used, strict=True) if u]) / (power or 1.0)
    return Whiteness(lags.astype(float), r, 2.5758 / np.sqrt(pairs), float(chdtrc(len(lags), np.sum(pairs * r**2))))
