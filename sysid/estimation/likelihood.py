"""Likelihood: the sizes and correlation times of the disturbances under which a log is likeliest."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.linearisation import LinearisedModel
from sysid.physics.ops import Array


def likelihood_ascent(
    linearised: LinearisedModel, disturbances: Disturbances, floor: Array, angle_error: bool = True
) -> Disturbances:
    """Disturbances of larger likelihood about the same motion: one Newton step of v = (log s, log sigma_o), or of the
    first alone.

    Slope and curvature are differences over a factor of 1.35, which is less than a log can tell; where the curvature is
    negative the step follows the slope, by a factor of e at most.
    """
    system, h, now = linearised.system, 0.3, log_sizes(disturbances)
    free = [i for i in range(1 + angle_error) if now[i] > floor[i]]
    if not free:
        return disturbances

    def deviance(move: Array) -> float:
        return system.filter(disturbances.moved(move)).deviance

    here, unit = deviance(np.zeros(2)), h * np.eye(2)[free]
    up, down = np.array([deviance(v) for v in unit]), np.array([deviance(-v) for v in unit])
    slope, curvature = (up - down) / (2.0 * h), np.diag(up - 2.0 * here + down) / h**2
    if len(free) == 2:
        both = (deviance(unit[0] + unit[1]) - up[0] - up[1] + here) / h**2
        curvature[0, 1] = curvature[1, 0] = both
    size, axes = np.linalg.eigh(curvature)
    along = -(axes.T @ slope) / np.maximum(np.abs(size), 1e-3)
    move = np.zeros(2)
    move[free] = axes @ np.clip(along, -1.0, 1.0)
    trials = [(here, np.zeros(2)), *zip(up, unit, strict=True), *zip(down, -unit, strict=True)]
    for share in (1.0, 0.3):
        own = np.maximum(share * move, np.minimum(floor - now, 0.0))
        trials.append((deviance(own), own))
        if trials[-1][0] < here:
            break
    return disturbances.moved(min(trials, key=lambda own: own[0])[1])


def maximum_likelihood(
    linearised: LinearisedModel, begins: Iterable[Disturbances], angle_error: bool = True
) -> Disturbances:
    """The likeliest of disturbances about the same motion, each first moved to likelier sizes."""
    floor, deviances = np.array([-40.0, -40.0]), dict[Disturbances, float]()
    for begun in begins:
        trial = begun
        for _ in range(3):
            trial = likelihood_ascent(linearised, trial, floor, angle_error)
        deviances[trial] = linearised.system.filter(trial).deviance
    return min(deviances, key=lambda own: deviances[own])


def log_sizes(disturbances: Disturbances) -> Array:
    """(log s, log sigma_o), far below any floor where they are 0."""
    return np.log(np.maximum([disturbances.s, disturbances.sigma_o], 1e-300))
