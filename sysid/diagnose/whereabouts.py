"""Where an unknown torque lives: over the quantity that it depends on."""

from __future__ import annotations

import numpy as np

from sysid.diagnose.flexible import Dependence
from sysid.identify.gauss_newton import Fit
from sysid.records import Array

_BINS = 24


def whereabouts(fit: Fit, dependence: Dependence) -> str:
    """The stretch of the quantity over which most of the unexplained torque acts, in words."""
    on = dependence.depends_on[0]
    response, L = fit.response, fit.response.length
    scored = response.scored
    torque = dependence.torque[scored]
    if not torque.size:
        return ""
    if on == "time":
        return _times(fit, np.where(scored, dependence.torque, 0.0))
    if on == "history":
        return "on what happened up to 16 samples before"
    x, unit = {
        "theta": (fit.model.plant.place(fit.solution.lin.states[:, :L, 0])[scored], "rad"),
        "theta_dot": (fit.solution.lin.states[:, :L, 1][scored], "rad/s"),
        "torque": (fit.solution.lin.drives[response.interval].mean(axis=-1)[scored], "N m"),
    }[on]
    edges = np.linspace(float(np.min(x)), float(np.max(x)), _BINS + 1)
    place = np.clip(np.digitize(x, edges) - 1, 0, _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    mean = np.bincount(place, torque, minlength=_BINS) / np.maximum(count, 1)
    met = count >= max(5, x.size // (4 * _BINS))  # where the joint hardly was, splines extrapolate
    size = np.where(met, np.abs(mean - np.median(mean[met])), 0.0)
    first, last = _around(size)
    peak = mean[int(np.argmax(size))]
    return f"strongest for {on} from {edges[first]:.2f} to {edges[last + 1]:.2f} {unit} ({peak:+.2g} N m)"


def _around(size: Array) -> tuple[int, int]:
    """The bins about the largest that are above half of it."""
    peak = int(np.argmax(size))
    first = last = peak
    while first > 0 and size[first - 1] > 0.5 * size[peak]:
        first -= 1
    while last < len(size) - 1 and size[last + 1] > 0.5 * size[peak]:
        last += 1
    return first, last


def _times(fit: Fit, torque: Array) -> str:
    response = fit.response
    i, k = np.unravel_index(int(np.argmax(np.abs(torque))), torque.shape)
    record = response.records[response.windows[int(i)].record]
    return f"strongest in {record.name} at {response.time[i, k]:.2f} s ({torque[i, k]:+.2g} N m)"
