"""The missing torque: what has to act beside a model for a log to have come about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.prediction_error import QUICK, Fit, fit, likelier
from sysid.records import Array
from sysid.smoothing.touched import slow

MEMORY = 0.1
"""Correlation time [s] under which the torque is smoothed: shorter than what is shown of it."""


def missing_torque(found: Fit, base: Fit) -> Array:
    """The torque (M,) [N m] that the log needs beside a fitted model, averaged over 0.4 s; nan at a record's ends.

    Whatever the readings show is taken for a motion here, none of it for an error that neighbouring readings share. The
    prior is what `base` needs, so that several models compare.
    """
    prior = Disturbances(max(base.disturbances.s, 1e-3 * float(np.std(base.chain.smoothed[:, 1]))), MEMORY)
    for _ in range(6):
        prior = likelier(base.linearised, prior, np.array([-40.0, -40.0]), angle_error=False)
    held = replace(QUICK, sizes=False)
    smoothed = fit(found.chain, found.model, (), replace(found, names=(), prior=found.prior.of_nothing()), prior, held)
    return slow(found.inertia * smoothed.motion.d, found.chain.number, found.chain.dt)
