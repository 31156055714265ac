"""Contacts: stretches in which something pushed that no state of the joint explains, such as a hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.estimation.prediction_error import Fit
from sysid.records import Array
from sysid.smoothing.touched import Touched, touched


@dataclass(frozen=True)
class Push:
    """What makes a rare torque a push: it is most of what the model misses, in little of the time.

    most    share of the missing torque's energy that all stretches hold together, at least
    little  share of the time that they take, at most
    """

    most: float = 0.6
    little: float = 0.15


def contacts(fit: Fit, torque: Array, push: Push = Push()) -> tuple[Touched, ...]:
    """Where a missing torque (M,) [N m] is extreme against what acts in the same state at other times.

    A machine that misses something everywhere has extremes too, and nobody touched it: unless they are most of what is
    missing, in a small part of the time, there is none.
    """
    chain = fit.chain
    sd = np.full(len(chain), 0.25 * float(np.nanmedian(np.abs(torque))))
    known = np.where(chain.follows, torque, np.nan)
    names = [r.name for r in chain.records]
    found = touched(names, chain.number, chain.t, fit.motion.x, known, sd, chain.dt)
    inside = np.zeros(len(chain), dtype=bool)
    for stretch in found:
        inside |= (
            (chain.number == names.index(stretch.name)) & (chain.t >= stretch.t_begin) & (chain.t <= stretch.t_end)
        )
    energy = float(np.nansum(known**2))
    held = float(np.nansum(known[inside] ** 2))
    return found if held > push.most * energy > 0.0 and np.mean(inside) < push.little else ()
