"""Excitation: the torque signals with which a system is asked, and the paper's way of asking."""

from __future__ import annotations

import math

import numpy as np

from sysid.data.record import Record
from sysid.errors import InvalidInput
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.simulate import simulate


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


def paper_rollouts(
    model: Model, n: int, rng: np.random.Generator, sigma: float = 1.0, length: int = 200
) -> list[Record]:
    """The paper's measurement (Sec. II-B): rollouts under random torques, the speed read before and after each step.

    The order of draws is the published runs' own, so the same seed gives the same data: for each rollout the start
    state is uniform(-[pi, 1], [pi, 1]) from a generator seeded with rng.integers(0, 2**31 - 1); then for each step the
    torque, uniform, the noise of the speed before it and of the speed after it. Readings go through float32, as
    Gymnasium's observation does; the angle is arctan2 of its sine and cosine, without noise.

    Parameters
    ----------
    model : Model
        The machine; it needs a torque limit.
    n : int
        How many rollouts, 0 or more.
    rng : numpy.random.Generator
        Where all draws come from.
    sigma : float
        Noise of the speed [rad/s].
    length : int
        Steps of a rollout.

    Returns
    -------
    list of Record
        One a rollout.

    Raises
    ------
    InvalidInput
        For n < 0, length < 1, sigma < 0 and a model without a torque limit.
    """
    if n < 0 or length < 1 or not sigma >= 0.0 or not math.isfinite(model.u_max):
        raise InvalidInput(
            f"n = {n}, length = {length}, sigma = {sigma}, u_max = {model.u_max}: expected n >= 0 rollouts of at least "
            "one step, a noise sd >= 0 and a model with a torque limit"
        )
    if n == 0:
        return []
    start, u, noise = np.empty((n, 2)), np.empty((n, length)), np.empty((n, length, 2))
    high = np.array([math.pi, 1.0])
    for i in range(n):
        start[i] = np.random.default_rng(int(rng.integers(0, 2**31 - 1))).uniform(-high, high)
        for k in range(length):
            u[i, k] = rng.uniform(-model.u_max, model.u_max)
            noise[i, k, 0] = rng.normal(0.0, sigma)
            noise[i, k, 1] = rng.normal(0.0, sigma)
    applied = u.astype(np.float32).astype(float)
    run = simulate(model, applied, start[:, 0], start[:, 1])
    speed = run.theta_dot.astype(np.float32).astype(float)
    sine, cosine = np.sin(run.theta).astype(np.float32), np.cos(run.theta).astype(np.float32)
    angle = np.arctan2(sine, cosine).astype(float)
    return [
        Record(
            t=run.t,
            u=applied[i],
            theta=angle[i],
            theta_dot=speed[i, :-1] + noise[i, :, 0],
            theta_dot_after=speed[i, 1:] + noise[i, :, 1],
            name=f"rollout {i}",
        )
        for i in range(n)
    ]
