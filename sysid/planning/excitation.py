"""Excitation: the torque signals with which a system is asked."""

from __future__ import annotations

import math

import numpy as np

from sysid.physics.ops import Array


def multisine(rng: np.random.Generator, n: int, dt: float, u_max: float, f_max: float, tones: int = 12) -> Array:
    """n torques [N m]: a sum of `tones` sines up to f_max [Hz], random phases, scaled to a peak of u_max."""
    t = dt * np.arange(n)
    f = np.linspace(f_max / tones, f_max, tones)
    phase = rng.uniform(0.0, 2.0 * math.pi, tones)
    signal = np.sum(np.sin(2.0 * math.pi * f * t[:, None] + phase), axis=1)
    scaled: Array = u_max * signal / np.max(np.abs(signal))
    return scaled


def chirp(n: int, dt: float, u_max: float, f_0: float, f_1: float) -> Array:
    """n torques [N m]: a sine of amplitude u_max whose frequency rises linearly from f_0 to f_1 [Hz]."""
    t = dt * np.arange(n)
    rate = (f_1 - f_0) / (n * dt)
    signal: Array = u_max * np.sin(2.0 * math.pi * (f_0 * t + 0.5 * rate * t * t))
    return signal


def steps(rng: np.random.Generator, n: int, dt: float, u_max: float, hold: float) -> Array:
    """n torques [N m]: a new level, uniform in [-u_max, u_max], every `hold` [s]."""
    every = max(1, round(hold / dt))
    return np.repeat(rng.uniform(-u_max, u_max, math.ceil(n / every)), every)[:n]
