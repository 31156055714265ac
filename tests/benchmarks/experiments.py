"""Experiments on the hidden machine, three with given torques and two with a servo, and the logs that a rig would
write of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sysid import Record
from tests.benchmarks.truth import NEUTRAL, Array, Motion, simulate

EXPERIMENTS = ("multisine", "steps", "mixed")
SERVOS = ("servo multisine", "servo steps")
PEAKS = np.array([4.0, 3.2, 2.5, 2.0, 1.6, 1.2, 0.8, 0.5])  # [N m]
TURN = 2.5  # [rad] from hanging: how far the machine without hidden effects may swing
REACH = 1.2  # [rad] from hanging: how far a servo's aim goes
KP, KD = 10.0, 2.0  # [N m/rad], [N m s/rad]
ENCODER = 2.0 * np.pi / 4096.0  # [rad]


@dataclass(frozen=True)
class Log:
    """How a rig writes its log.

    rate [Hz], seconds a rollout, number of rollouts, sensor noise theta [rad] and theta_dot [rad/s] (None: no such
    column), angle_step [rad] of the encoder (0: none), differenced: the speed column is worked out from the angle's
    readings, stamp: what a row's torque is ("held" from this row to the
    next, "late" by a row, "early" by a row, or "averaged" over the interval that ends at the row), claimed: the noise
    (theta, theta_dot) that the user claims, None where nothing is claimed.
    """

    rate: float = 50.0
    seconds: float = 8.0
    rollouts: int = 8
    theta: float = 0.003
    theta_dot: float | None = 0.05
    angle_step: float = 0.0
    differenced: bool = False
    stamp: str = "held"
    claimed: tuple[float, float] | None = None

    @property
    def dt(self) -> float:
        """[s]"""
        return 1.0 / self.rate

    @property
    def samples(self) -> int:
        """Control intervals a rollout."""
        return round(self.rate * self.seconds)

    @property
    def noise(self) -> tuple[float, float | None]:
        """Standard deviation of a reading's error, the encoder's step included: [rad], [rad/s]."""
        return float(np.hypot(self.theta, self.angle_step / np.sqrt(12.0))), self.theta_dot

    def errors(self, shape: tuple[int, int], rng: np.random.Generator) -> tuple[Array, Array | float]:
        """What the sensors add to theta and theta_dot (n, N+1) before anything is rounded."""
        theta = self.theta * rng.standard_normal(shape)
        return theta, 0.0 if self.theta_dot is None else self.theta_dot * rng.standard_normal(shape)

    def rounded(self, theta: Array) -> Array:
        """An angle in whole steps of the encoder."""
        return self.angle_step * np.round(theta / self.angle_step) if self.angle_step > 0.0 else theta

    def speed(self, theta: Array, theta_dot: Array) -> Array | None:
        """The speed column (n, N+1) beside the angle column, from what a tachometer would show."""
        if not self.differenced:
            return None if self.theta_dot is None else theta_dot
        return np.diff(theta, axis=1, prepend=theta[:, :1]) / self.dt


LOGS: dict[str, Log] = {
    "clean": Log(),
    "loud": Log(theta=0.02, theta_dot=0.4),
    "slow": Log(rate=20.0),
    "speedless": Log(theta_dot=None),
    "coarse": Log(theta=0.0005, angle_step=0.003),
    "short": Log(seconds=3.0, rollouts=3),
    "told 1/3": Log(claimed=(0.001, 0.0167)),
    "told x3": Log(claimed=(0.009, 0.15)),
    "late": Log(stamp="late"),
    "early": Log(stamp="early"),
    "averaged": Log(stamp="averaged"),
    "200 Hz": Log(rate=200.0, seconds=4.0),
    "1 kHz": Log(rate=1000.0, seconds=4.0),
    "encoder": Log(theta=0.0, angle_step=ENCODER),
    "differences 200 Hz": Log(200.0, 4.0, theta=0.0, theta_dot=None, angle_step=ENCODER, differenced=True),
    "differences 1 kHz": Log(1000.0, 4.0, theta=0.0, theta_dot=None, angle_step=ENCODER, differenced=True),
    "servo": Log(theta=0.001, angle_step=ENCODER),
    "servo 200 Hz": Log(200.0, 4.0, theta=0.001, angle_step=ENCODER),
    "arm": Log(100.0, 4.0, theta=0.0, theta_dot=None, angle_step=ENCODER, differenced=True),
}


@dataclass(frozen=True, eq=False)
class Plan:
    """Commands u (n, N) [N m], start angles theta (n,) [rad] (at rest), the wind's shape (n, N+1) in [0, 1], and the
    angle (n, N) [rad] at which a servo aims; its commands are not known before it has run."""

    u: Array
    theta: Array
    wind: Array
    aim: Array | None = None


def plan(experiment: str, log: Log, rng: np.random.Generator) -> Plan:
    """Commands and start angles of one experiment, as an engineer would choose them.

    Each rollout takes the largest of PEAKS with which the machine without hidden effects stays within TURN of hanging.
    """
    n, N, dt = log.rollouts, log.samples, log.dt
    shapes = np.array([_shape(experiment.removeprefix("servo "), N, dt, rng) for _ in range(n)])
    theta = np.pi + rng.uniform(-0.8, 0.8, n)
    wind = np.array([_gusts(N, dt, rng) for _ in range(n)])
    if experiment in SERVOS:
        return Plan(np.zeros((n, N)), theta, wind, np.pi + REACH * shapes)
    u = (PEAKS[:, None, None] * shapes).reshape(-1, N)
    motion = simulate({}, u, np.tile(theta, len(PEAKS)), 0.0, dt, step=1e-3)
    far = np.max(np.abs(motion.theta - np.pi), axis=1).reshape(len(PEAKS), n)
    first = np.where((far < TURN).any(axis=0), np.argmax(far < TURN, axis=0), len(PEAKS) - 1)
    return Plan(PEAKS[first, None] * shapes, theta, wind)


class Servo:
    """A loop on the readings that the log shows:  u[k] = KP (aim[k] - theta[k]) - KD theta_dot[k].

    `rng` draws the errors of the readings, as `write` draws them.
    """

    def __init__(self, aim: Array, log: Log, rng: np.random.Generator, kp: float = KP, kd: float = KD) -> None:
        self.aim, self.log, self.kp, self.kd = aim, log, kp, kd
        self.theta_error, self.speed_error = log.errors((len(aim), aim.shape[1] + 1), rng)
        self.seen = np.zeros((len(aim), 0))

    def __call__(self, k: int, theta: Array, theta_dot: Array) -> Array:
        """The command (n,) [N m] of instant k."""
        error = np.broadcast_to(self.speed_error, self.theta_error.shape)[:, k]
        now = self.log.rounded(theta + self.theta_error[:, k])
        self.seen = np.column_stack([self.seen, now])[:, -2:]
        speed = self.log.speed(self.seen, (theta_dot + error)[:, None])
        u = self.kp * (self.aim[:, k] - now)
        return u if speed is None else u - self.kd * speed[:, -1]


def _shape(experiment: str, N: int, dt: float, rng: np.random.Generator) -> Array:
    """A command (N,) with peak 1."""
    if experiment == "multisine":
        t = dt * np.arange(N)
        tones = rng.uniform(0.1, 2.5, 10)
        signal = np.sin(2.0 * np.pi * (tones * t[:, None] + rng.uniform(0.0, 1.0, 10))).sum(axis=1)
        return signal / np.max(np.abs(signal))
    if experiment == "steps":
        return _steps(N, dt, rng)
    if experiment == "mixed":
        a, b = int(0.4 * N), int(0.75 * N)
        t = dt * np.arange(a)
        rate = 2.8 / t[-1]
        sweep = np.sin(2.0 * np.pi * ((0.2 + 0.5 * rate * t) * t + rng.uniform()))
        return np.concatenate([sweep, _steps(b - a, dt, rng), np.zeros(N - b)])
    raise KeyError(f"unknown experiment {experiment!r}: expected one of {', '.join(EXPERIMENTS)}")


def _steps(N: int, dt: float, rng: np.random.Generator) -> Array:
    """Random levels in [-1, 1], each held for 0.2 to 0.6 s."""
    signal: list[float] = []
    while len(signal) < N:
        signal += [rng.uniform(-1.0, 1.0)] * round(rng.uniform(0.2, 0.6) / dt)
    return np.array(signal[:N])


def _gusts(N: int, dt: float, rng: np.random.Generator) -> Array:
    """Two gusts a rollout, each rising and falling smoothly within 0.6 to 1.5 s, at random instants."""
    t = dt * np.arange(N + 1)
    wind = np.zeros(N + 1)
    for _ in range(2):
        length = rng.uniform(0.6, 1.5)
        begin = rng.uniform(0.0, max(N * dt - length, 0.1))
        x = np.clip((t - begin) / length, 0.0, 1.0)
        wind = np.maximum(wind, np.sin(np.pi * x) ** 2 * rng.uniform(0.7, 1.0))
    return wind


@dataclass(frozen=True, eq=False)
class World:
    """One machine in one experiment: its plan, hidden numbers (see truth.NEUTRAL), gust [N m] and the log's form."""

    plan: Plan
    numbers: Mapping[str, float]
    gust: float
    log: Log


def move(worlds: Sequence[World]) -> list[Motion]:
    """The motions of several worlds of one log form (same rate and length), run together, lane by lane."""
    keys = sorted({k for w in worlds for k in w.numbers})
    counts = [len(w.plan.theta) for w in worlds]
    numbers: dict[str, ArrayLike] = {
        k: np.repeat([float(w.numbers.get(k, NEUTRAL[k])) for w in worlds], counts) for k in keys
    }
    wind = np.vstack([w.gust * w.plan.wind for w in worlds]) if any(w.gust for w in worlds) else None
    u, theta = (np.concatenate([getattr(w.plan, name) for w in worlds]) for name in ("u", "theta"))
    motion = simulate(numbers, u, theta, 0.0, worlds[0].log.dt, wind)
    cuts = np.cumsum(counts)[:-1]
    fields = ("theta", "theta_dot", "reading_theta", "reading_theta_dot", "u")
    parts = [np.split(getattr(motion, f), cuts) for f in fields]
    return [Motion(motion.t, *series) for series in zip(*parts, strict=True)]


Engine = Callable[..., Motion]
"""A simulator with the arguments of truth.simulate."""


def played(world: World, rng: np.random.Generator, engine: Engine = simulate) -> World:
    """The world with the commands that its servo gives there, reading with the errors that rng draws; played again
    without the servo they give the same motion."""
    planned = world.plan
    if planned.aim is None:
        return world
    servo = Servo(planned.aim, world.log, rng)
    motion = engine(world.numbers, planned.u, planned.theta, 0.0, world.log.dt, feedback=servo)
    return replace(world, plan=replace(planned, u=motion.u, aim=None))


def write(motion: Motion, plan: Plan, log: Log, rng: np.random.Generator) -> list[Record]:
    """The records of a motion: readings with noise and steps, torque stamped as this logger stamps it."""
    theta_error, speed_error = log.errors(motion.theta.shape, rng)
    theta = log.rounded(motion.reading_theta + theta_error)
    speed = log.speed(theta, motion.reading_theta_dot + speed_error)
    u = stamped(plan.u, log.stamp)
    return [
        Record(motion.t, u[i], theta[i], None if speed is None else speed[i], name=f"rollout {i}")
        for i in range(len(theta))
    ]


def stamped(u: Array, stamp: str) -> Array:
    """The torque column (n, N) of a logger, from the torque that acted in each interval."""
    before = np.concatenate([np.zeros_like(u[:, :1]), u[:, :-1]], axis=1)
    after = np.concatenate([u[:, 1:], u[:, -1:]], axis=1)
    columns = {"held": u, "late": before, "early": after, "averaged": 0.5 * (before + u)}
    return columns[stamp]
