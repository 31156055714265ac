"""Likelihood: the sizes and correlation times of the disturbances under which a log is likeliest."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import combinations

import numpy as np

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.kalman import Filter, LinearSystem
from sysid.physics.ops import Array

IDLE = 5.0
"""If s = 0 would lower the deviance by less than this, it is tried at once, and s need not shrink step by step."""
GIVEN_UP_ABOVE = 30.0
"""Disturbances whose deviance is this much above the best are given up: no further move makes up for that."""
NEGLIGIBLE_GAIN = 0.01
"""A step is not worth taking if twice the decrease of the deviance that it promises is below this."""

SIGMA_99 = 2.5758
"""Standard deviations on either side within which 99 % of a Gaussian lie."""


def likelihood_ascent(now: Filter, floor: Array, shared_error: bool = True) -> Filter:
    """One Newton step of log (s, sigma_o, sigma_f) that makes the log likelier about the same motion; `now` if none
    does, or if a deviance next to it is not finite.

    Without `shared_error` only log s moves. Slope and curvature are finite differences over a factor of 1.35, a change
    that a log cannot see; where the curvature is negative, the step follows the slope. A step is at most a factor of e,
    or e^2 if that is better still; then the step of log s is doubled for as long as this helps. Where s hardly matters,
    the deviance grows with s^2, and s = 0 would gain half the slope: if that is little, s = 0 is tried too.
    """
    h, sizes = 0.3, np.log(np.maximum(now.disturbances.sizes, 1e-300))  # below any floor at 0
    free = [i for i in range(3 if shared_error else 1) if sizes[i] > floor[i]]
    if not free or not math.isfinite(now.deviance):
        return now

    def moved(move: Array) -> Filter:
        return now.system.filter(now.disturbances.scaled(np.exp(move)))

    here, unit = now.deviance, h * np.eye(3)[free]
    trials = [now, *map(moved, unit), *map(moved, -unit)]
    up, down = (np.array([f.deviance for f in side]) for side in (trials[1 : 1 + len(free)], trials[-len(free) :]))
    slope, curvature = (up - down) / (2.0 * h), np.diag(up - 2.0 * here + down) / h**2
    if np.all(slope**2 <= NEGLIGIBLE_GAIN * np.diag(curvature)):
        return now
    for i, j in combinations(range(len(free)), 2):
        both = (moved(unit[i] + unit[j]).deviance - up[i] - up[j] + here) / h**2
        curvature[i, j] = curvature[j, i] = both
    if not np.all(np.isfinite(curvature)):
        return now  # beside disturbances next to these the motion runs away
    size, axes = np.linalg.eigh(curvature)
    along = -(axes.T @ slope) / np.maximum(np.abs(size), 1e-3)
    move, lowest = np.zeros(3), np.minimum(floor - sizes, 0.0)
    move[free] = axes @ np.clip(along, -1.0, 1.0)
    trials.append(moved(np.maximum(move, lowest)))
    if not trials[-1].deviance < here:
        trials.append(moved(np.maximum(0.3 * move, lowest)))
    elif np.any(np.abs(along) > 1.0):
        trials.append(moved(np.maximum(2.0 * move, lowest)))
        while trials[-1].deviance < trials[-2].deviance and 2.0 * move[0] > lowest[0]:
            move[0] *= 2.0
            trials.append(moved(np.maximum(2.0 * move, lowest)))
    if free[0] == 0 and 0.0 < slope[0] < 2.0 * IDLE:
        trials.append(moved(np.array([lowest[0], 0.0, 0.0])))
    return min(trials, key=lambda trial: trial.deviance)


def maximum_likelihood(system: LinearSystem, begins: Iterable[Disturbances], shared_error: bool = True) -> Disturbances:
    """The likeliest of several disturbances about the same motion, after up to three Newton steps of the sizes of each;
    those that are hopeless beside others are given up earlier."""
    floor, trials = np.full(3, -40.0), [system.filter(begun) for begun in begins]
    for _ in range(3):
        trials = [likelihood_ascent(trial, floor, shared_error) for trial in trials]
        best = min(trials, key=lambda trial: trial.deviance)
        trials = [trial for trial in trials if trial.deviance <= best.deviance + GIVEN_UP_ABOVE]
    return best.disturbances


def p_value(decrease: float, numbers: int) -> float:
    """The probability that so many superfluous numbers decrease the deviance by more: the tail of chi squared.

    An effect that takes the place of one with as many numbers is tested as one number.
    """
    from scipy.special import chdtrc

    return float(chdtrc(max(numbers, 1), max(decrease, 0.0)))
