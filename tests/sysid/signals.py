"""A torque signal of the tests."""

from __future__ import annotations

import numpy as np


def uniform_noise(rng: np.random.Generator, n: int, u_max: float) -> np.ndarray:
    """n torques, independent and uniform in [-u_max, u_max] [N m]."""
    return rng.uniform(-u_max, u_max, n)
