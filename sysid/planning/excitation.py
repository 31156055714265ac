"""Excitation: torque signals within a user's limits, drawn at random and varied."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from sysid.errors import InvalidInput
from sysid.limits import MAGNITUDE
from sysid.physics.model import Model
from sysid.physics.ops import Array
from sysid.physics.plants import Plant

KINDS = ("steps", "bang-bang", "chirp", "multisine", "free swing")
_FREE_SWINGS = 8
"""Free swings among the signals that are drawn, at most."""
TONES = 12
"""Sines of a multisine."""


def multisine(rng: np.random.Generator, n: int, dt: float, u_max: float, f_max: float) -> Array:
    """n torques [N m]: a sum of TONES sines up to f_max [Hz], random phases, scaled to a peak of u_max."""
    t = dt * np.arange(n)
    f = np.linspace(f_max / TONES, f_max, TONES)
    phase = rng.uniform(0.0, 2.0 * math.pi, TONES)
    signal = np.sum(np.sin(2.0 * math.pi * f * t[:, None] + phase), axis=1)
    return u_max * signal / np.max(np.abs(signal))


def chirp(n: int, dt: float, u_max: float, f_0: float, f_1: float) -> Array:
    """n torques [N m]: a sine of amplitude u_max whose frequency rises linearly from f_0 to f_1 [Hz]."""
    t = dt * np.arange(n)
    rate = (f_1 - f_0) / (n * dt)
    return u_max * np.sin(2.0 * math.pi * (f_0 * t + 0.5 * rate * t * t))


def steps(rng: np.random.Generator, n: int, dt: float, u_max: float, hold: float) -> Array:
    """n torques [N m]: a new level, uniform in [-u_max, u_max], every `hold` [s]."""
    every = max(1, round(hold / dt))
    return np.repeat(rng.uniform(-u_max, u_max, math.ceil(n / every)), every)[:n]


@dataclass(frozen=True)
class Limits:
    """What a rig may be asked to do.

    Attributes
    ----------
    u_max : float
        The largest torque [N m].
    duration : float
        The length of a rollout [s].
    rollouts : int
        How many rollouts to play.
    start : float
        How far from rest a rollout may be released, at most [rad]; at 0 there are no free swings.
    theta_max, theta_dot_max : float or None
        How far from rest [rad], and how fast [rad/s], the predicted motion may go, at most; None for no limit.

    Raises
    ------
    InvalidInput
        For numbers that are not positive.
    """

    u_max: float
    duration: float = 8.0
    rollouts: int = 1
    start: float = 1.5
    theta_max: float | None = None
    theta_dot_max: float | None = None

    def __post_init__(self) -> None:
        for name in ("u_max", "duration", "theta_max", "theta_dot_max"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= MAGNITUDE:
                raise InvalidInput(f"limits: {name} = {value}: expected a positive number, at most {MAGNITUDE:g}")
        if not 0.0 <= self.start <= math.pi:
            raise InvalidInput(f"limits: start = {self.start}: expected 0 ... pi rad from rest")
        if self.rollouts < 1:
            raise InvalidInput(f"limits: rollouts = {self.rollouts}: expected at least 1")

    @property
    def release(self) -> float:
        """The farthest release that the motion's own limit allows [rad]."""
        return self.start if self.theta_max is None else min(self.start, self.theta_max)


@dataclass(frozen=True)
class Signal:
    """One rollout's torque, made of a few numbers.

    kind       one of KINDS
    amplitude  [N m]  largest torque
    hold       [s]    length of a step
    low, high  [Hz]   band of a chirp, and the highest tone of a multisine
    until             share of the rollout after which there is no torque: the joint coasts
    release    [rad]  where it is let go, from rest
    seed              of the levels and phases
    """

    kind: str
    amplitude: float
    hold: float
    low: float
    high: float
    until: float
    release: float
    seed: int

    def torque(self, n: int, dt: float) -> Array:
        """The command (n,) [N m], each held over dt [s]."""
        rng = np.random.default_rng(self.seed)
        on = n if self.until >= 1.0 else max(1, round(self.until * n))
        u = np.zeros(n)
        if self.kind == "steps":
            u[:on] = steps(rng, on, dt, self.amplitude, self.hold)
        elif self.kind == "bang-bang":
            every = max(1, round(self.hold / dt))
            signs = rng.choice((-1.0, 1.0), math.ceil(on / every))
            u[:on] = self.amplitude * np.repeat(signs, every)[:on]
        elif self.kind == "chirp":
            u[:on] = chirp(on, dt, self.amplitude, self.low, self.high)
        elif self.kind == "multisine":
            u[:on] = multisine(rng, on, dt, self.amplitude, self.high)
        return u

    def smaller(self, share: float) -> Signal:
        """The same with a share of the torque, and released at a share of the way from rest."""
        return dataclasses.replace(self, amplitude=share * self.amplitude, release=share * self.release)

    def sentence(self, plant: Plant) -> str:
        """What to do, as an order, in the plant's units."""
        peak = f"{self.amplitude:.3g} {plant.unit('N m')}"
        order = {
            "steps": f"play held steps of {self.hold:.2g} s, up to +-{peak}",
            "bang-bang": f"switch between +-{peak} at multiples of {self.hold:.2g} s",
            "chirp": f"play a chirp of {peak} from {self.low:.2g} to {self.high:.2g} Hz",
            "multisine": f"play a multisine of up to {peak} and {self.high:.2g} Hz",
            "free swing": f"let it go {abs(self.release):.2g} {plant.unit('rad')} from rest and swing freely",
        }[self.kind]
        return order + (f", torque off after {self.until:.0%} of the time" if self.until < 1.0 else "")


def _longest(limits: Limits, dt: float) -> tuple[float, float, float, float]:
    """Shortest and longest hold [s], lowest and highest frequency [Hz] that are of use in a rollout."""
    highest = min(0.25 / dt, 10.0)
    return 2.0 * dt, max(0.25 * limits.duration, 4.0 * dt), 1.0 / limits.duration, highest


def random_signals(rng: np.random.Generator, limits: Limits, dt: float, count: int, swings: bool) -> list[Signal]:
    """Random signals of all kinds; free swings only where the joint has a place to come back to (`swings`)."""
    swings = swings and limits.release > 0.0
    driven = [k for k in KINDS if k != "free swing"]
    shortest, longest, lowest, highest = _longest(limits, dt)
    signals = []
    for i in range(count):
        free = swings and i < min(_FREE_SWINGS, count // 4)
        low, high = np.sort(np.exp(rng.uniform(math.log(lowest), math.log(highest), 2)))
        signals.append(
            Signal(
                kind="free swing" if free else driven[i % len(driven)],
                amplitude=limits.u_max * math.exp(rng.uniform(math.log(0.2), 0.0)),
                hold=math.exp(rng.uniform(math.log(shortest), math.log(longest))),
                low=float(low),
                high=float(high),
                until=1.0 if free or rng.uniform() < 0.6 else float(rng.uniform(0.3, 0.8)),
                release=float(limits.release * (rng.uniform(0.2, 1.0) if i else 1.0)) if free else 0.0,
                seed=int(rng.integers(2**31)),
            )
        )
    return signals


def vary(signal: Signal, rng: np.random.Generator, limits: Limits, dt: float) -> Signal:
    """A signal of the same kind nearby, or with other levels and phases."""
    shortest, longest, lowest, highest = _longest(limits, dt)
    stretch = np.exp(rng.normal(0.0, 0.3, 5))
    low, high = np.sort(np.clip([signal.low * stretch[0], signal.high * stretch[1]], lowest, highest))
    return dataclasses.replace(
        signal,
        amplitude=min(limits.u_max, signal.amplitude * float(stretch[2])),
        hold=float(np.clip(signal.hold * stretch[3], shortest, longest)),
        low=float(low),
        high=float(high),
        until=signal.until if signal.until >= 1.0 else float(np.clip(signal.until * stretch[4], 0.2, 0.95)),
        release=min(limits.release, signal.release * float(stretch[2])),
        seed=signal.seed if rng.uniform() < 0.5 else int(rng.integers(2**31)),
    )


def rest_angle(model: Model) -> float:
    """Where the joint rests without torque [rad]: hanging; 0 where no gravity pulls it anywhere."""
    return math.pi if abs(float(model.plant.largest_gravity_torque)) > 0.0 else 0.0
