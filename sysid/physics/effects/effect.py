"""The kinds of effect: between command and torque, at the joint, and between joint and reading."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sysid.physics.ops import Array, Value
from sysid.physics.parameters import NEVER, Extent, Parametric
from sysid.physics.plants import Plant

Memory = tuple[Value, ...]


@dataclass(eq=False)
class Joint:
    """What an effect at the joint gets: theta [rad], theta_dot [rad/s], t [s], the drive torque [N m] and the plant.

    command  what the actuator was told, in its own unit; the drive torque itself where there is none
    summed   computes `load`, for those effects only that ask for it
    """

    theta: Value
    theta_dot: Value
    t: Value
    drive: Value
    plant: Plant
    summed: Callable[[], Value]
    command: Value = 0.0

    @cached_property
    def gravity(self) -> Value:
        """The plant's own torque at this angle [N m]."""
        return self.plant.gravity_torque(self.theta)

    @cached_property
    def load(self) -> Value:
        """Gravity + drive + all effects that are not friction [N m]; 0 while those are being summed."""
        return self.summed()


class Stretch(NamedTuple):
    """A short stretch of the joint's motion: h [s], the speed at its begin and end [rad/s], the angle travelled [rad].

    The travel is h times the mean of both speeds, unless dry friction holds the joint in between.
    """

    h: float
    begin: Value
    end: Value
    travel: Value


class Reading(NamedTuple):
    """What a sensor shows: theta [rad], theta_dot [rad/s]."""

    theta: Value
    theta_dot: Value


@dataclass(frozen=True, eq=False)
class Effect(Parametric):
    """A physical effect that a model may or may not have: at the input, at the joint, or at the output.

    words      what it is, for a sentence
    formula    its equation in the fields' letters, one line
    confused   names of effects that many logs cannot tell from it
    excludes   names of effects that cannot stand in a model beside it
    of_log     whether it belongs to the log (how rows were stamped) and not to the machine
    rarity     -log of its prior odds, against friction, which is in every joint
    imitates   the quantity ("theta", ...) of which alone it is a function, and so a part of any other function of it
    refines    simpler effects, alone or together, that explain most of what it does: it has to beat each
    contains   effects that it is for some of its numbers: beside it their numbers would mean nothing
    precedence its rank among effects that a log cannot tell apart: the highest stands for all of them, the log's own
               convention before any machine's; at 0 it stands for itself only
    begins     the numbers from which a fit begins if none are known, as shares of `Parameter.large`
    inertial   whether it looks like another inertia in the motion: a payload shows it, a torque does not
    brakes     whether it is a torque against the speed and proportional to it, like an actuator's damping
    ratios     ratios of its numbers that a log may show better than either: name -> (numerator, denominator, unit)
    """

    words: ClassVar[str] = ""
    formula: ClassVar[str] = ""
    confused: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[tuple[str, ...]] = ()
    of_log: ClassVar[bool] = False
    rarity: ClassVar[float] = 2.0
    imitates: ClassVar[str] = ""
    refines: ClassVar[tuple[tuple[str, ...], ...]] = ()
    contains: ClassVar[tuple[str, ...]] = ()
    precedence: ClassVar[int] = 0
    begins: ClassVar[Mapping[str, float]] = {}
    inertial: ClassVar[bool] = False
    brakes: ClassVar[bool] = False
    ratios: ClassVar[Mapping[str, tuple[str, str, str]]] = {}

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "name" not in cls.__dict__:
            cls.name = re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    name: ClassVar[str] = "effect"

    def recurrences(self, theta: Array, t: Array, u: Array) -> float:
        """How often its pattern repeats along a motion theta (N,) [rad] at t (N,) [s] under commands u (N,). inf: it
        has no pattern; -inf: the motion repeats with it, so that it may as well be a function of the motion."""
        return math.inf

    @property
    def plausible(self) -> bool:
        """Whether a machine may have these numbers, apart from their bounds."""
        return True

    def resolved(self, sd: float, reach: float, told: Joint) -> bool:
        """Whether angle readings with that sd [rad] can show it in a motion of that reach [rad]. `told` is the joint at
        those instants at which it moves and its drive is given a torque (and not a position)."""
        return True

    @property
    def idle(self) -> bool:
        """Whether it changes nothing, as all its numbers that have a neutral value are at it."""
        sized = [p for p in self.parameters.values() if p.neutral is not None]
        return bool(sized) and all(
            float(p.value) == p.neutral or (p.never and abs(float(p.value)) >= NEVER) for p in sized
        )

    def at_beginning(self, extent: Extent) -> Any:
        """The same effect with the numbers from which a fit to a log of that extent begins, if none are known."""
        shown = extent._replace(u_max=extent.u_max or extent.inertia)
        return self.with_parameters({k: share * self.parameters[k].large(shown) for k, share in self.begins.items()})

    def at_neutral(self) -> Any:
        """The same effect with its parameters at the values at which it changes nothing."""
        return self.with_parameters({k: p.neutral for k, p in self.parameters.items() if p.neutral is not None})


@dataclass(frozen=True, eq=False)
class InputEffect(Effect):
    """Maps the command to the drive torque; depends on the command alone, not on the joint's state.

    A signal over one control interval is a tuple of means over its substeps. Effects act in the order of `stage`,
    within a stage as they are listed: what belongs to the log (-1), static ones (0), delay (1), lag (2). An effect with
    ahead = 1 gets each command one interval early, which is possible in a log but not in a running machine.
    """

    stage: ClassVar[int] = 0
    ahead: ClassVar[int] = 0

    def rest(self, dt: float) -> Memory:
        """The memory after a long time without command; () for a static effect."""
        return ()

    @abstractmethod
    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """The signal after this effect over one interval dt [s], and the memory for the next interval."""

    def whole(self, signal: Array, dt: float) -> Array:
        """The signal (..., N, S) of whole records after this effect, from rest; parameters must be plain numbers."""
        memory = self.rest(dt)
        if not memory:
            columns, _ = self.advance(tuple(np.moveaxis(signal, -1, 0)), memory, dt)
            return np.stack(np.broadcast_arrays(*columns), axis=-1)
        rows = []
        several = np.moveaxis(signal, (-2, -1), (0, 1))
        for row in signal.tolist() if signal.ndim == 2 else several:  # floats are faster than arrays of one
            after, memory = self.advance(tuple(row), memory, dt)
            rows.append(after if signal.ndim == 2 else np.broadcast_arrays(*after))
        return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


@dataclass(frozen=True, eq=False)
class Actuator(Effect):
    """Turns the command into the torque at the joint, if the log's command is something else than a torque.

    A model has at most one; without one its command is the torque. The input effects come before it and act on the
    command in its own unit.

    command      the kind of command: "torque", "current", "voltage" or "position"
    unit         the command's unit, for a plant that turns
    scale        the parameter that sets the scale of all torques: motion alone cannot show it
    damping      the parameter by which it brakes the joint
    at_angle     whether the command is an angle of the joint: it is converted as one, and rests at the joint's own
    """

    command: ClassVar[str] = "torque"
    unit: ClassVar[str] = "N m"
    scale: ClassVar[str] = ""
    damping: ClassVar[str] = ""
    at_angle: ClassVar[bool] = False

    @abstractmethod
    def torque(self, u: Value, theta: Value, theta_dot: Value) -> Value:
        """Torque on the joint [N m] under the command u, at theta [rad] and theta_dot [rad/s]."""


@dataclass(frozen=True, eq=False)
class JointEffect(Effect):
    """Adds a torque, and perhaps an inertia, at the joint. Effects with `friction` are summed last."""

    friction: ClassVar[bool] = False

    def inertia(self) -> Value:
        """Added inertia [kg m^2]."""
        return 0.0

    @abstractmethod
    def torque(self, joint: Joint) -> Value:
        """Torque on the joint [N m]; positive raises theta."""


@dataclass(frozen=True, eq=False)
class DryFriction(Effect):
    """Opposes motion with a torque of its own size, and holds a joint at rest with up to that torque.

    The integrator (`sysid.physics.integrators`) resolves it such that the joint really sticks, in every back end.
    """

    @abstractmethod
    def limits(self, joint: Joint) -> tuple[Value, Value]:
        """Largest torque [N m] against positive and against negative motion, both >= 0."""


@dataclass(frozen=True, eq=False)
class DynamicEffect(Effect):
    """Acts at the joint with a torque that depends on states of its own, which the joint's motion drives.

    start_sd    the standard deviation of each of its states about 0 when a record begins
    """

    start_sd: ClassVar[tuple[float, ...]] = ()

    @abstractmethod
    def follow(self, states: Memory, stretch: Stretch) -> tuple[Value, Value, Memory]:
        """Follow the joint over a stretch of its motion: the mean torque on the joint [N m], its derivative with
        respect to the speed at the end [N m s/rad], never positive, and the states afterwards."""


@dataclass(frozen=True, eq=False)
class OutputEffect(Effect):
    """Maps the joint's state to what the sensors show. In the order of `stage`: mechanics, timing, electronics."""

    stage: ClassVar[int] = 2

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        """The memory of a sensor that has watched the joint arrive at this state at constant speed."""
        return ()

    @abstractmethod
    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """The reading after this effect, and the memory for the next instant."""

    def whole(self, reading: Reading, t: Array, dt: float) -> Reading:
        """The readings (..., N+1) of a whole record after this effect; its parameters must be plain numbers."""
        memory = self.rest(reading.theta[..., 0], reading.theta_dot[..., 0], dt)
        if not memory:
            return self.read(reading, memory, t, dt)[0]
        seen = []
        for k in range(reading.theta.shape[-1]):
            now, memory = self.read(Reading(reading.theta[..., k], reading.theta_dot[..., k]), memory, t[..., k], dt)
            seen.append(now)
        return Reading(np.stack([r.theta for r in seen], axis=-1), np.stack([r.theta_dot for r in seen], axis=-1))
