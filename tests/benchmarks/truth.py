"""The machine behind the benchmark: a rod pendulum with any hidden effect, integrated otherwise than the fit does.

Nothing here is shared with `sysid`: plain NumPy, fixed steps of 0.2 ms, explicit midpoint between events, and Karnopp's
dry friction: a joint at rest stays there while the net torque is within what friction holds, and a step in which the
speed would change its sign is cut at the instant of zero speed. A lane is one rollout of one machine; all lanes of
a call run together, each with its own numbers.

    (J + J_r) theta_ddot = G sin(theta + alpha) + drive + torques - friction,   J = m l^2 / 3,  G = m g l / 2

Source: Karnopp, Computer simulation of stick-slip friction in mechanical dynamic systems, 1985.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Feedback = Callable[[int, Array, Array], Array]
"""A command (L,) [N m] from the number of the instant and its noise-free readings (L,) [rad], [rad/s]."""
STEP = 2e-4  # [s]

# Every number of a machine, at the value at which it changes nothing. Torques [N m], angles [rad], times [s].
NEUTRAL: dict[str, float] = {
    "m": 1.04,
    "l": 0.97,
    "g": 9.81,
    "viscous.b": 0.0,
    "coulomb.tau_c": 0.0,
    "stribeck.tau_c": 0.0,  # -(tau_c + (tau_s - tau_c) exp(-(theta_dot / v_s)^2)) sign(theta_dot)
    "stribeck.tau_s": 0.0,
    "stribeck.v_s": 0.4,
    "drag.c": 0.0,
    "asymmetric_viscous.b_plus": 0.0,
    "asymmetric_viscous.b_minus": 0.0,
    "asymmetric_coulomb.tau_plus": 0.0,
    "asymmetric_coulomb.tau_minus": 0.0,
    "load_friction.mu": 0.0,  # dry, mu |drive - gravity - torques|: what a gear transmits
    "torque_bias.tau_0": 0.0,
    "tilt.alpha": 0.0,
    "spring.k": 0.0,  # -k (theta - pi)
    "ripple.a": 0.0,  # a sin(order theta + phase)
    "ripple.order": 6.0,
    "ripple.phase": 0.0,
    "periodic.a": 0.0,  # a sin(2 pi f t + phase)
    "periodic.f": 1.7,
    "periodic.phase": 0.0,
    "drift.rate": 0.0,  # rate t
    "delay.T": 0.0,
    "lag.T": 0.0,
    "torque_gain.k": 1.0,
    "dead_zone.width": 0.0,
    "saturation.limit": np.inf,
    "back_emf.k": 0.0,
    "rotor_inertia.J": 0.0,
    "backlash.width": 0.0,
    "angle_offset.theta_0": 0.0,
    "velocity_bias.v_0": 0.0,
    "velocity_gain.k": 1.0,
    "sensor_delay.T": 0.0,
    # Outside the catalogue.
    "magnet.a": 0.0,  # pulls towards theta_m: -a x exp((1 - x^2) / 2), x = (theta - theta_m) / width
    "magnet.theta_m": 2.9,
    "magnet.width": 0.15,
    "cable.k": 0.0,  # -k max(theta - theta_c, 0)
    "cable.theta_c": 3.5,
    "eddy.c": 0.0,  # -c theta_dot / (1 + (theta_dot / v_p)^2): a brake that fades with speed
    "eddy.v_p": 1.0,
    "patch.tau": 0.0,  # dry friction within width of theta_p alone
    "patch.theta_p": 3.3,
    "patch.width": 0.15,
    "lopsided.gain": 1.0,  # factor of positive commands alone
    "slosh.J": 0.0,  # a second inertia on a spring of frequency f [Hz] and damping ratio zeta
    "slosh.f": 1.5,
    "slosh.zeta": 0.05,
    # A spring between motor and link: drive, friction and sensors stand at the motor, gravity pulls at the link.
    "flexible.f": np.inf,  # of the resonance [Hz]; inf: rigid
    "flexible.zeta": 0.01,
    "flexible.share": 0.5,  # of the inertia, at the motor
}


@dataclass(frozen=True, eq=False)
class Motion:
    """What happened: t (N+1,) [s]; theta, theta_dot and their noise-free readings (L, N+1) [rad], [rad/s]; u (L, N)
    [N m], the commands."""

    t: Array
    theta: Array
    theta_dot: Array
    reading_theta: Array
    reading_theta_dot: Array
    u: Array


Step = Callable[[int, Array, Array, Array], tuple[Array, Array]]
"""(k, commands u (L, N) so far, theta (L,), theta_dot (L,)) -> theta and theta_dot one sample later."""


def known_numbers(numbers: Mapping[str, float], effects: Collection[str], what: str) -> dict[str, float]:
    """Those of NEUTRAL with `numbers` in their place; raises KeyError for one beyond the rod's own and the effects'."""
    for key in numbers:
        if key not in NEUTRAL or key.split(".")[0] not in (*effects, "m", "l", "g"):
            raise KeyError(f"{what} has no {key!r}")
    return NEUTRAL | dict(numbers)


def stepped(
    step: Step, u: ArrayLike, theta: ArrayLike, theta_dot: ArrayLike, dt: float, feedback: Feedback | None
) -> Motion:
    """The motion of a machine without sensors of its own, sample by sample."""
    u = np.atleast_2d(np.array(u, dtype=float))
    L, N = u.shape
    angles, speeds = np.empty((N + 1, L)), np.empty((N + 1, L))
    angles[0], speeds[0] = theta, theta_dot
    for k in range(N):
        if feedback is not None:
            u[:, k] += feedback(k, angles[k], speeds[k])
        angles[k + 1], speeds[k + 1] = step(k, u, angles[k], speeds[k])
    return Motion(dt * np.arange(N + 1), angles.T, speeds.T, angles.T, speeds.T, u)


def simulate(
    numbers: Mapping[str, ArrayLike],
    u: ArrayLike,
    theta: ArrayLike,
    theta_dot: ArrayLike,
    dt: float,
    wind: Array | None = None,
    step: float = STEP,
    feedback: Feedback | None = None,
) -> Motion:
    """Run L lanes from theta, theta_dot (L,) under the commands u (L, N) [N m], each held over dt [s].

    `numbers` holds those of NEUTRAL that differ from it, floats or (L,); wind (L, N+1) [N m] is a torque in time,
    linear between samples; feedback is added to the commands. Before the start the command is zero and the joint rests
    where it starts. Raises KeyError for a number that NEUTRAL does not have.
    """
    u = np.atleast_2d(np.array(u, dtype=float))
    machine = _Machine(numbers, u, dt, wind, step)
    L, N = u.shape
    begun = (np.broadcast_to(np.asarray(x, dtype=float), (L,)).copy() for x in (theta, theta_dot))
    state = machine.rest(*begun)
    sensors = _Sensors(machine, state, N)
    angles, speeds = np.empty((N + 1, L)), np.empty((N + 1, L))
    angles[0], speeds[0] = state.theta, state.theta_dot
    for k in range(N):
        if feedback is not None:
            u[:, k] += feedback(k, *sensors.readings(k))
            machine.tell(k, u[:, k])
        for j in range(machine.per_sample):
            t = k * dt + j * machine.h
            after = machine.advance(state, t, k, j)
            sensors.watch(state, after, t)
            state = after
        angles[k + 1], speeds[k + 1] = state.theta, state.theta_dot
        sensors.sample(state, k + 1)
    return Motion(dt * np.arange(N + 1), angles.T, speeds.T, *sensors.readings(), u)


@dataclass
class _State:
    theta: Array
    theta_dot: Array
    lagged: Array | float = 0.0
    second: tuple[Array, Array] | None = None  # angle and speed of the second inertia


class _Machine:
    """The numbers of all lanes, and one step of time."""

    def __init__(
        self, numbers: Mapping[str, ArrayLike], u: Array, dt: float, wind: Array | None, step: float = STEP
    ) -> None:
        unknown = [k for k in numbers if k not in NEUTRAL]
        if unknown:
            raise KeyError(f"the truth has no number {unknown[0]!r}")
        self.p = {k: np.asarray(numbers.get(k, v), dtype=float) for k, v in NEUTRAL.items()}
        changed = [k for k in numbers if np.any(self.p[k] != NEUTRAL[k])]
        self.active = {k.split(".")[0] for k in changed if "." in k}
        p = self.p
        self.J = p["m"] * p["l"] ** 2 / 3.0 + p["rotor_inertia.J"]
        self.G = 0.5 * p["m"] * p["g"] * p["l"]
        self.flexible = "flexible" in self.active
        self.second = self.flexible or "slosh" in self.active
        if self.flexible:
            self.J_link = (1.0 - p["flexible.share"]) * self.J
            self.J = p["flexible.share"] * self.J
            both, omega = 1.0 / (1.0 / self.J + 1.0 / self.J_link), 2.0 * np.pi * p["flexible.f"]
            self.stiffness, self.damping = both * omega**2, 2.0 * both * p["flexible.zeta"] * omega
        self.per_sample = round(dt / step)
        self.dt, self.h = dt, dt / self.per_sample
        self.wind = None if wind is None else np.asarray(wind, dtype=float).T
        self.dry = bool(self.active & {"coulomb", "stribeck", "asymmetric_coulomb", "load_friction", "patch"})
        # Two rows of rest before the first command; delays reach further back into the same zeros.
        self.command = np.vstack([np.zeros((2, len(u))), self._static(u).T])

    def tell(self, k: int, u: Array) -> None:
        """Give the command (L,) of the interval that begins at instant k."""
        self.command[k + 2] = self._static(u[:, None])[:, 0]

    def rest(self, theta: Array, theta_dot: Array) -> _State:
        """The state at the start: a second inertia moves along, a link hangs on its spring."""
        if not self.second:
            return _State(theta, theta_dot)
        link = theta
        for _ in range(50 * self.flexible):
            link = theta + self.G * np.sin(link + self.p["tilt.alpha"]) / self.stiffness
        return _State(theta, theta_dot, second=(link, theta_dot))

    def _static(self, u: Array) -> Array:
        """Gain, dead zone and saturation of the command, in this order."""
        p = {k: v[..., None] for k, v in self.p.items()}
        u = u * p["torque_gain.k"] * np.where(u > 0.0, p["lopsided.gain"], 1.0)
        u = u - np.clip(u, -p["dead_zone.width"], p["dead_zone.width"])
        return np.clip(u, -p["saturation.limit"], p["saturation.limit"])

    def _drive(self, state: _State, t: float, k: int) -> tuple[Array, Array | float]:
        """Mean over a step of the delayed, lagged command, and the lag's state after it."""
        if "delay" in self.active:
            lanes = np.arange(self.command.shape[1])
            end = (t + self.h - self.p["delay.T"]) / self.dt + np.zeros(len(lanes))
            row = np.ceil(end - 1e-9).astype(int) - 1
            share = np.minimum((end - row) * self.dt / self.h, 1.0)
            last = len(self.command) - 1
            now, before = (self.command[np.clip(r, 0, last), lanes] for r in (row + 2, row + 1))
            u = share * now + (1.0 - share) * before
        else:
            u = self.command[k + 2]
        if "lag" not in self.active:
            return u, 0.0
        T = np.maximum(self.p["lag.T"], 1e-12)
        decay = np.exp(-self.h / T)
        return u + (state.lagged - u) * T / self.h * (1.0 - decay), u + (state.lagged - u) * decay

    def advance(self, state: _State, t: float, k: int, j: int) -> _State:
        """The state one step h later."""
        h = self.h
        drive, lagged = self._drive(state, t, k)
        wind = 0.0
        if self.wind is not None:
            share = (j + 0.5) / self.per_sample
            wind = (1.0 - share) * self.wind[k] + share * self.wind[k + 1]
        theta, v = state.theta, state.theta_dot
        second = state.second if state.second is not None else (theta, v)
        way = self._way(theta, v, t, drive + wind, second) if self.dry else np.sign(v)
        a, pull = self._acceleration(theta, v, t, drive + wind, way, second)
        middle, v_middle = theta + 0.5 * h * v, v + 0.5 * h * a
        s_middle = (second[0] + 0.5 * h * second[1], second[1] + 0.5 * h * pull)
        a, pull = self._acceleration(middle, v_middle, t + 0.5 * h, drive + wind, way, s_middle)
        after, v_after = theta + h * v_middle, v + h * a
        s_after = (second[0] + h * s_middle[1], second[1] + h * pull) if self.second else None
        if self.dry:
            stuck = way == 0.0
            after, v_after = np.where(stuck, theta, after), np.where(stuck, 0.0, v_after)
            crossed = way * v_after < 0.0
            if crossed.any():
                at, rest = self._past_zero(theta, v, v_after, t, drive + wind, s_after or second)
                after, v_after = np.where(crossed, at, after), np.where(crossed, rest, v_after)
        return _State(after, v_after, lagged, s_after)

    def _way(self, theta: Array, v: Array, t: float, drive: Array, second: tuple[Array, Array]) -> Array:
        """Direction of motion, or of the motion about to begin; 0 where friction holds the joint."""
        way = np.sign(v)
        resting = way == 0.0
        if not resting.any():
            return way
        net, plus, minus = self._torque(theta, 0.0 * v, t, drive, way, second)
        starts = np.where(net > plus, 1.0, np.where(net < -minus, -1.0, 0.0))
        return np.where(resting, starts, way)

    def _past_zero(
        self, theta: Array, v: Array, v_after: Array, t: float, drive: Array, second: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Angle and speed at the end of a step in which the speed passed zero: it stops, and may set off again."""
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(v == v_after, 0.0, v / (v - v_after))
        at = theta + 0.5 * v * share * self.h
        left = (1.0 - share) * self.h
        now = t + self.h
        way = self._way(at, 0.0 * v, now, drive, second)
        a = np.where(way == 0.0, 0.0, self._acceleration(at, 0.0 * v, now, drive, way, second)[0])
        return at + 0.5 * a * left**2, a * left

    def _acceleration(
        self, theta: Array, v: Array, t: float, drive: Array, way: Array, second: tuple[Array, Array]
    ) -> tuple[Array, Array | float]:
        """theta_ddot of the joint and of the second inertia [rad/s^2]."""
        net, plus, minus = self._torque(theta, v, t, drive, way, second)
        dry = np.where(way > 0.0, plus, minus) * way if self.dry else 0.0
        return (net - dry) / self.J, self._pull(theta, v, second) if self.second else 0.0

    def _torque(
        self, theta: Array, v: Array, t: float, drive: Array, way: Array, second: tuple[Array, Array]
    ) -> tuple[Array, Array | float, Array | float]:
        """Net torque without dry friction, and the dry friction against positive and negative motion [N m]."""
        load = -self._shaft(theta, v, second) if self.flexible else self._gravity(theta)
        load = load + self._in_time(t) + self._in_angle(theta)
        if "slosh" in self.active:
            load = load - self.p["slosh.J"] * self._pull(theta, v, second)
        net = drive + load - self._fluid(v)
        if not self.dry:
            return net, 0.0, 0.0
        return net, *self._hold(theta, v, drive - load)

    def _gravity(self, theta: Array) -> Array:
        """[N m]"""
        torque: Array = self.G * np.sin(theta + self.p["tilt.alpha"])
        return torque

    def _shaft(self, theta: Array, v: Array, link: tuple[Array, Array]) -> Array:
        """Torque [N m] of the spring between motor and link, on the link."""
        torque: Array = self.stiffness * (theta - link[0]) + self.damping * (v - link[1])
        return torque

    def _in_time(self, t: float) -> Array:
        """Torques that depend on time alone [N m]."""
        p = self.p
        torque = p["torque_bias.tau_0"] + p["drift.rate"] * t
        if "periodic" in self.active:
            torque = torque + p["periodic.a"] * np.sin(2.0 * np.pi * p["periodic.f"] * t + p["periodic.phase"])
        return torque

    def _in_angle(self, theta: Array) -> Array | float:
        """Torques beside gravity that depend on the angle alone [N m]."""
        p, active = self.p, self.active
        torque: Array | float = 0.0
        if "spring" in active:
            torque = torque - p["spring.k"] * (theta - np.pi)
        if "ripple" in active:
            torque = torque + p["ripple.a"] * np.sin(p["ripple.order"] * theta + p["ripple.phase"])
        if "magnet" in active:
            x = _turn(theta - p["magnet.theta_m"]) / p["magnet.width"]
            torque = torque - p["magnet.a"] * x * np.exp(0.5 * (1.0 - x * x))
        if "cable" in active:
            torque = torque - p["cable.k"] * np.maximum(theta - p["cable.theta_c"], 0.0)
        return torque

    def _pull(self, theta: Array, v: Array, second: tuple[Array, Array]) -> Array:
        """Acceleration of the second inertia [rad/s^2]."""
        if self.flexible:
            return (self._gravity(second[0]) + self._shaft(theta, v, second)) / self.J_link
        omega = 2.0 * np.pi * self.p["slosh.f"]
        return omega**2 * (theta - second[0]) + 2.0 * self.p["slosh.zeta"] * omega * (v - second[1])

    def _fluid(self, v: Array) -> Array:
        """Friction that vanishes with the speed [N m]."""
        p, active = self.p, self.active
        torque = (p["viscous.b"] + p["back_emf.k"]) * v
        if "drag" in active:
            torque = torque + p["drag.c"] * np.abs(v) * v
        if "asymmetric_viscous" in active:
            torque = torque + np.where(v > 0.0, p["asymmetric_viscous.b_plus"], p["asymmetric_viscous.b_minus"]) * v
        if "eddy" in active:
            torque = torque + p["eddy.c"] * v / (1.0 + (v / p["eddy.v_p"]) ** 2)
        return torque

    def _hold(self, theta: Array, v: Array, transmitted: Array) -> tuple[Array, Array]:
        """Dry friction against positive and against negative motion [N m]."""
        p = self.p
        both = p["coulomb.tau_c"] + p["load_friction.mu"] * np.abs(transmitted)
        if "stribeck" in self.active:
            excess = p["stribeck.tau_s"] - p["stribeck.tau_c"]
            both = both + p["stribeck.tau_c"] + excess * np.exp(-((v / p["stribeck.v_s"]) ** 2))
        if "patch" in self.active:
            both = both + p["patch.tau"] * (np.abs(_turn(theta - p["patch.theta_p"])) < p["patch.width"])
        return both + p["asymmetric_coulomb.tau_plus"], both + p["asymmetric_coulomb.tau_minus"]


def _turn(angle: Array) -> Array:
    """The angle within half a turn of zero [rad]."""
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


class _Sensors:
    """Backlash between joint and encoder, then a delay, then the electronics' offset, bias and gain."""

    def __init__(self, machine: _Machine, state: _State, N: int) -> None:
        self.p, self.h, self.dt = machine.p, machine.h, machine.dt
        L = len(state.theta)
        self.delayed = "sensor_delay" in machine.active
        self.play = "backlash" in machine.active
        self.encoder, self.speed = state.theta, state.theta_dot
        self.theta, self.theta_dot = np.empty((N + 1, L)), np.empty((N + 1, L))
        self.theta[:], self.theta_dot[:] = state.theta, state.theta_dot

    def watch(self, before: _State, after: _State, t: float) -> None:
        """Follow the joint over one step."""
        was = (before.theta, before.theta_dot)
        now = (after.theta, after.theta_dot)
        if self.play:
            half = 0.5 * self.p["backlash.width"]
            was = (self.encoder, self.speed)
            y = np.clip(self.encoder, after.theta - half, after.theta + half)
            now = (y, np.where((y != self.encoder) | (half == 0.0), after.theta_dot, 0.0))
            self.encoder, self.speed = now
        if self.delayed:
            T = self.p["sensor_delay.T"] + np.zeros(len(after.theta))
            k = np.ceil((t + T) / self.dt - 1e-9).astype(int)
            share = (k * self.dt - T - t) / self.h
            (lane,) = np.nonzero((share < 1.0 + 1e-9) & (k < len(self.theta)) & (k >= 0))
            s = share[lane]
            for store, x0, x1 in zip((self.theta, self.theta_dot), was, now, strict=True):
                store[k[lane], lane] = (1.0 - s) * x0[lane] + s * x1[lane]

    def sample(self, state: _State, k: int) -> None:
        """Read at instant k."""
        if not self.delayed:
            self.theta[k] = self.encoder if self.play else state.theta
            self.theta_dot[k] = self.speed if self.play else state.theta_dot

    def readings(self, at: int | slice = slice(None)) -> tuple[Array, Array]:
        """What the sensors show without noise, theta and theta_dot (L, N+1), or (L,) of one instant."""
        theta = self.theta[at] + self.p["angle_offset.theta_0"]
        theta_dot = self.theta_dot[at] * self.p["velocity_gain.k"] + self.p["velocity_bias.v_0"]
        return theta.T, theta_dot.T
