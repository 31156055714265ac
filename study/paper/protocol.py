"""The paper's pendulum, and its way of measuring it (Sec. II-A and II-B).

The speed is read before and after every step, so two independent readings belong to each instant within a rollout; the
angle is known. A rollout becomes `Record`s of `sysid`, which hold one speed per instant, in two ways:

    transitions   one record a step, with the two readings that belong to it: what the paper's grid search compares
    averaged      one record, with the mean of the readings of each instant: all that they say about the motion
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sysid import InvalidInput, Model, Record, RodPendulum, SemiImplicitEuler, Sensor, simulate
from sysid.physics.ops import Array

ROLLOUT_LENGTH = 200
"""Steps of a rollout (Sec. II-C)."""
FIRST_ANGLE = 0.001
"""sd [rad] of the first angle of a rollout, as identifiers of whole rollouts are told."""
BOUNDS = (0.3, 3.0)
"""Between which m [kg] and l [m] are plausible before anything is measured (Sec. II-B and III)."""


def paper_model(m: float = 1.0, l: float = 1.0) -> Model:  # noqa: E741
    """The paper's pendulum: Gymnasium's equations with m [kg] and l [m] exposed.

    g = 10 m/s^2, dt = 0.05 s, |u| <= 2 N m, |theta_dot| <= 8 rad/s. The defaults are the paper's prior; its hidden
    truth is m = 2.0, l = 1.5.
    """
    plant = RodPendulum(m=m, l=l, g=10.0, bounds={"m": BOUNDS, "l": BOUNDS})
    return Model(plant, integrator=SemiImplicitEuler(theta_dot_max=8.0), dt=0.05, u_max=2.0)


class AveragedSensor(Sensor):
    """The errors of `PaperRollout.averaged`: theta_dot is the sd of a mean of two readings, and the first and the last
    instant of a rollout have one."""

    def readings(self, record: Record) -> tuple[Array, Array]:
        """All readings of a record, and the sd of each."""
        values, sds = super().readings(record)
        sds[[0, -1], 1] *= math.sqrt(2.0)
        return values, sds


def averaged_sensor(sigma: float) -> Sensor:
    """The errors of averaged rollouts whose speeds were read with sd sigma [rad/s]."""
    return AveragedSensor(theta=FIRST_ANGLE, theta_dot=sigma / math.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class PaperRollout:
    """A measured rollout of N steps.

    t (N+1,) [s], u (N,) [N m], theta (N+1,) [rad] unwrapped; before, after (N,) [rad/s]: the speed as it was read on
    both sides of each step.
    """

    t: Array
    u: Array
    theta: Array
    before: Array
    after: Array
    name: str

    @property
    def transitions(self) -> list[Record]:
        """One record a step: its angle, its torque and its two speeds."""
        return [
            Record(self.t[k : k + 2], self.u[k : k + 1], self.theta[k : k + 1], (self.before[k], self.after[k]))
            for k in range(len(self.u))
        ]

    @property
    def averaged(self) -> Record:
        """The whole rollout with the mean reading of each instant, and of its angles the first alone."""
        middle = 0.5 * (self.before[1:] + self.after[:-1])
        speed = np.concatenate([self.before[:1], middle, self.after[-1:]])
        return Record(self.t, self.u, self.theta[:1], speed, name=self.name)


def transitions(rollouts: list[PaperRollout]) -> list[Record]:
    """The steps of all rollouts, as `sysid.GridSearch` takes them."""
    return [step for rollout in rollouts for step in rollout.transitions]


def paper_rollouts(
    model: Model, n: int, rng: np.random.Generator, sigma: float = 1.0, length: int = ROLLOUT_LENGTH
) -> list[PaperRollout]:
    """n rollouts of `length` steps under random torques, the speed read with noise of sd sigma [rad/s].

    The order of draws is the published runs' own, so the same seed gives the same data: for each rollout the start
    state is uniform(-[pi, 1], [pi, 1]) from a generator seeded with rng.integers(0, 2**31 - 1); then for each step the
    torque, uniform, the noise of the speed before it and of the speed after it. Readings go through float32, as
    Gymnasium's observation does; the angle is arctan2 of its sine and cosine, without noise. Raises InvalidInput for
    n < 0, length < 1, sigma < 0 and a model without a torque limit.
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
    applied = _rounded(u)
    run = simulate(model, applied, start[:, 0], start[:, 1])
    speed = _rounded(run.theta_dot)
    sine, cosine = np.sin(run.theta).astype(np.float32), np.cos(run.theta).astype(np.float32)
    angle = np.unwrap(np.arctan2(sine, cosine).astype(float))
    before, after = speed[:, :-1] + noise[..., 0], speed[:, 1:] + noise[..., 1]
    return [PaperRollout(run.t, applied[i], angle[i], before[i], after[i], f"rollout {i}") for i in range(n)]


def _rounded(values: Array) -> Array:
    return values.astype(np.float32).astype(float)
