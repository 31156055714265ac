"""A coarse simulator as the machine: semi-implicit Euler in steps of 1 ms, as game engines and quick scripts use it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from tests.benchmarks.truth import Array, Feedback, Motion, known_numbers, stepped

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
    p = known_numbers(numbers, EFFECTS, "the coarse simulator")
    J, G = p["m"] * p["l"] ** 2 / 3.0, 0.5 * p["m"] * p["g"] * p["l"]
    per_sample = round(dt / step)
    h = dt / per_sample

    def sample(k: int, u: Array, x: Array, v: Array) -> tuple[Array, Array]:
        for _ in range(per_sample):
            v = v + h * (G * np.sin(x) + u[:, k] - p["viscous.b"] * v) / J
            v = np.sign(v) * np.maximum(np.abs(v) - h * p["coulomb.tau_c"] / J, 0.0)
            x = x + h * v
        return x, v

    return stepped(sample, u, theta, theta_dot, dt, feedback)
