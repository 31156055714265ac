"""A coarse simulator as the machine: semi-implicit Euler in steps of 1 ms, as game engines and quick scripts use it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from tests.benchmarks.truth import NEUTRAL, Feedback, Motion

EFFECTS = ("viscous", "coulomb")


def simulate(
    numbers: Mapping[str, float],
    u: ArrayLike,
    theta: ArrayLike,
    theta_dot: ArrayLike,
    dt: float,
    step: float = 1e-3,
    feedback: Feedback | None = None,
) -> Motion:
    """Run L lanes under the commands u (L, N) [N m], as truth.simulate does.

        v <- v + h (G sin(theta) + u - b v) / J,   theta <- theta + h v

    Dry friction then takes h tau_c / J from |v|, and at most all of it. Raises KeyError for any other number.
    """
    known = {k for k in NEUTRAL if k.split(".")[0] in (*EFFECTS, "m", "l", "g")}
    foreign = [k for k in numbers if k not in known]
    if foreign:
        raise KeyError(f"the coarse simulator has no {foreign[0]!r}")
    p = NEUTRAL | dict(numbers)
    J, G = p["m"] * p["l"] ** 2 / 3.0, 0.5 * p["m"] * p["g"] * p["l"]
    u = np.atleast_2d(np.array(u, dtype=float))
    L, N = u.shape
    angles, speeds = np.empty((N + 1, L)), np.empty((N + 1, L))
    angles[0], speeds[0] = theta, theta_dot
    per_sample = round(dt / step)
    h = dt / per_sample
    for k in range(N):
        if feedback is not None:
            u[:, k] += feedback(k, angles[k], speeds[k])
        x, v = angles[k], speeds[k]
        for _ in range(per_sample):
            v = v + h * (G * np.sin(x) + u[:, k] - p["viscous.b"] * v) / J
            v = np.sign(v) * np.maximum(np.abs(v) - h * p["coulomb.tau_c"] / J, 0.0)
            x = x + h * v
        angles[k + 1], speeds[k + 1] = x, v
    return Motion(dt * np.arange(N + 1), angles.T, speeds.T, angles.T, speeds.T, u)
