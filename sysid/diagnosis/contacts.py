"""Contacts: stretches in which something pushed that no state of the joint explains, such as a hand."""

from __future__ import annotations

import numpy as np

from sysid.estimation.prediction_error import Fit
from sysid.smoothing.touched import Touched, slow, touched


def contacts(fit: Fit) -> tuple[Touched, ...]:
    """Where the smoothed random torque is extreme against what acts in the same state at other times."""
    chain = fit.chain
    dt, inertia = chain.dt, fit.inertia
    d, sd = inertia * fit.motion.d, inertia * fit.filter.posterior_sd()[:, 2]
    smooth = np.where(chain.follows, slow(d, chain.number, dt), np.nan)
    return touched([r.name for r in chain.records], chain.number, chain.t, fit.motion.x, smooth, sd, dt)
