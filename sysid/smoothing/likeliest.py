"""How large and how slow a residual torque is: what makes the log likeliest."""

from __future__ import annotations

import math

import numpy as np

from sysid.records import Array
from sysid.smoothing.smoother import Chain, Torque

SIGNIFICANT = 4.6
"""Gain in log-likelihood that two free numbers reach by chance in 1 of 100 logs, at most."""
CLEARLY = 10.0
"""By how much a smooth torque must be likelier: its band is narrower, so it must be right."""
_INSTANTS = 2_500
"""From so many instants the numbers are found: more would not change them."""
_MEMORY = 0.5
"""Of a torque that nobody sees [s]."""
_SIZES = (1e-3, 1e-2, 0.1, 1.0)


def likeliest(
    chain: Chain, size: float, shortest: float, first: tuple[Torque, ...] = ()
) -> tuple[tuple[Torque, ...], Torque]:
    """The likeliest torque of each kind, rough and smooth, and the one of the two to believe in.

    The search begins at `first`, one of each kind, or on a grid below `size` [N m]; no memory is below `shortest` [s].
    """
    part, stride = chain.thinned(_INSTANTS), 0.3 if first else 0.7
    if not first:
        coarse = chain.thinned(_INSTANTS // 2)
        grid = [(f * size, max(T, shortest)) for T in (0.1, 0.4, 1.6) for f in _SIZES]
        first = tuple(max((Torque(s, T, k) for s, T in grid), key=coarse.log_likelihood) for k in (False, True))
    both = tuple(_climbed(part, torque, shortest, stride) for torque in first)
    rough, smooth = both
    torque = smooth if part.log_likelihood(smooth) > part.log_likelihood(rough) + CLEARLY else rough
    if part is not chain:  # a rare event may lie outside of the part
        rare = max((Torque(f * size, max(0.4, shortest)) for f in _SIZES), key=chain.log_likelihood)
        if chain.log_likelihood(rare) > chain.log_likelihood(torque) + CLEARLY:
            torque = _climbed(chain, rare, shortest)
    return both, torque


def largest(chain: Chain, size: float) -> Torque:
    """The largest torque that the log does not rule out, one-sided at 95 %; `size` [N m] to begin with."""
    from scipy.optimize import brentq

    none = chain.log_likelihood(Torque(0.0, _MEMORY))

    def excess(log_s: float) -> float:
        return chain.log_likelihood(Torque(math.exp(log_s), _MEMORY)) - none + 0.5 * 1.645**2

    low = high = math.log(1e-6 * size)
    while excess(high) > 0.0 and high < low + 60.0:
        high += 1.0
    return Torque(
        math.exp(brentq(excess, high - 1.0, high, xtol=0.02) if excess(high) < 0.0 < high - low else high), _MEMORY
    )


def _climbed(chain: Chain, torque: Torque, shortest: float, stride: float = 0.7) -> Torque:
    """The torque of largest likelihood near another of its kind."""
    from scipy.optimize import minimize

    longest = max(20.0, len(chain.r) * chain.dt)

    def at(h: Array) -> Torque:
        s, T = torque.s * math.exp(h[0]), torque.T * math.exp(h[1])
        return Torque(s, min(max(T, shortest), longest), torque.smooth)

    simplex = stride * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"xatol": 1.0, "fatol": 0.1, "initial_simplex": simplex, "maxfev": 40}
    found = minimize(lambda h: -chain.log_likelihood(at(h)), simplex[0], method="Nelder-Mead", options=options)
    return at(found.x)
