"""The kinds of effect: between command and torque, at the joint, and between joint and reading."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from sysid.physics.ops import Array, Value
from sysid.physics.parameters import NEVER, Extent, Parametric
from sysid.physics.plants import Plant

Memory = tuple[Value, ...]


@dataclass(eq=False)
class Joint:
    """What an effect at the joint gets: the joint's state, the time, the torques and the plant.

    Attributes
    ----------
    theta : Value
        Angle [rad].
    theta_dot : Value
        Speed [rad/s].
    t : Value
        Time [s].
    drive : Value
        The drive torque [N m].
    plant : Plant
        What swings or slides.
    summed : function
        It computes `load`, for those effects only that ask for it.
    command : Value
        What the actuator was told, in its own unit; the drive torque itself where there is none.
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
        """Gravity + all effects that are not friction [N m]: what acts beside the drive; 0 while these are summed."""
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
    """What a sensor shows.

    Attributes
    ----------
    theta : Value
        Angle [rad].
    theta_dot : Value
        Speed [rad/s].
    """

    theta: Value
    theta_dot: Value


@dataclass(frozen=True, eq=False)
class Effect(Parametric):
    """A physical effect that a model may or may not have: at the input, at the joint, or at the output.

    Parameters
    ----------
    bounds : mapping of str to (float, float), optional
        Other bounds than the declared ones, by field name.

    Attributes
    ----------
    name : str
        The name by which a model knows it; by default that of its class in small letters: "dead_zone" of DeadZone.
    label : str
        What it is, for a sentence; by default its name in words.
    formula : str
        Its equation in the fields' letters, one line.
    confused : tuple of str
        Names of effects that many logs cannot tell from it.
    excludes : tuple of str
        Names of effects that cannot stand in a model beside it.
    of_log : bool
        Whether it belongs to the log (how rows were stamped) and not to the machine.
    rarity : float
        -log of its prior odds, against friction, which is in every joint.
    imitates : str
        The quantity ("theta", ...) of which alone it is a function, and so a part of any other function of it.
    moves_rest : bool
        Whether it is a zero: all it does to a swing of small angles is to move where that comes to rest.
    is_dry : bool
        Whether it is a dry friction: a joint at rest moves only under a torque of some size.
    refines : tuple of tuples of str
        Simpler effects, alone or together, that explain most of what it does: it has to beat each.
    contains : tuple of str
        Effects that it is for some of its numbers: beside it their numbers would mean nothing.
    precedence : int
        Its rank among effects that a log cannot tell apart: the highest stands for all of them, the log's own
        convention before any machine's; at 0 it stands for itself only.
    begins : mapping of str to float
        The numbers from which a fit begins if none are known, as shares of `Parameter.large`.
    inertial : bool
        Whether it looks like another inertia in the motion: a payload shows it, a torque does not.
    brakes : bool
        Whether it is a torque against the speed and proportional to it, like an actuator's damping.
    ratios : mapping of str to (str, str, str)
        Ratios of its numbers that a log may show better than either: name -> (numerator, denominator, unit).

    Raises
    ------
    InvalidInput
        For numbers that are not finite or are out of bounds, and for bounds of an unknown name or not low < high.
    """

    label: ClassVar[str] = ""
    formula: ClassVar[str] = ""
    confused: ClassVar[tuple[str, ...]] = ()
    excludes: ClassVar[tuple[str, ...]] = ()
    of_log: ClassVar[bool] = False
    rarity: ClassVar[float] = 2.0
    imitates: ClassVar[str] = ""
    moves_rest: ClassVar[bool] = False
    is_dry: ClassVar[bool] = False
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
        if "label" not in cls.__dict__:
            cls.label = cls.name.replace("_", " ")

    name: ClassVar[str] = "effect"

    def recurrences(self, theta: Array, t: Array, u: Array) -> float:
        """How often its pattern repeats along a motion.

        Parameters
        ----------
        theta : array (N,)
            The motion [rad].
        t : array (N,)
            The instants [s].
        u : array (N,)
            The commands.

        Returns
        -------
        float
            The count; inf: it has no pattern; -inf: the motion repeats with it, so that it may as well be a function of
            the motion.
        """
        return math.inf

    @property
    def plausible(self) -> bool:
        """Whether a machine may have these numbers, apart from their bounds."""
        return True

    def resolved(self, sd: float, reach: float, joint: Joint) -> bool:
        """Whether angle readings can show it in a motion.

        Parameters
        ----------
        sd : float
            The standard deviation of the angle readings [rad].
        reach : float
            The reach of the motion [rad].
        joint : Joint
            The joint at those instants at which it moves and its drive is given a torque (and not a position).

        Returns
        -------
        bool
            True, unless the effect says otherwise.
        """
        return True

    @property
    def idle(self) -> bool:
        """Whether it changes nothing, as all its numbers that have a neutral value are at it."""
        sized = [p for p in self.parameters.values() if p.neutral is not None]
        return bool(sized) and all(
            float(p.value) == p.neutral or (p.never and abs(float(p.value)) >= NEVER) for p in sized
        )

    def at_beginning(self, extent: Extent) -> Self:
        """The same effect with the numbers from which a fit to a log of that extent begins, if none are known.

        Parameters
        ----------
        extent : Extent
            The sizes of the log and its model.

        Returns
        -------
        Effect
            An effect of the same class.
        """
        shown = extent._replace(u_max=extent.u_max or extent.inertia)
        return self.with_parameters({k: share * self.parameters[k].large(shown) for k, share in self.begins.items()})

    def with_room(self) -> tuple[Self, ...]:
        """The same effect with a wider bound, where a number has come near to one that is there for the sake of speed.

        Returns
        -------
        tuple of Effect
            It begins at several numbers.
        """
        return ()

    def at_neutral(self) -> Self:
        """The same effect with its parameters at the values at which it changes nothing.

        Returns
        -------
        Effect
            An effect of the same class; parameters without a neutral value keep their numbers.
        """
        return self.with_parameters({k: p.neutral for k, p in self.parameters.items() if p.neutral is not None})


@dataclass(frozen=True, eq=False)
class InputEffect(Effect):
    """An effect that maps the command to the drive torque; it depends on the command alone, not on the joint's state.

    A signal over one control interval is a tuple of means over its substeps. Effects act in the order of `stage`,
    within a stage as they are listed.

    Attributes
    ----------
    stage : int
        What belongs to the log has -1, static effects have 0, a delay has 1 and a lag has 2.
    ahead : int
        An effect with ahead = 1 gets each command one interval early, which is possible in a log but not in a running
        machine.
    """

    stage: ClassVar[int] = 0
    ahead: ClassVar[int] = 0

    def rest(self, dt: float) -> Memory:
        """The memory after a long time without command.

        Parameters
        ----------
        dt : float
            The control interval [s].

        Returns
        -------
        tuple of Value
            The memory; () for a static effect.
        """
        return ()

    @abstractmethod
    def advance(self, signal: Sequence[Value], memory: Memory, dt: float) -> tuple[tuple[Value, ...], Memory]:
        """The signal after this effect over one control interval, and the memory for the next interval.

        Parameters
        ----------
        signal : sequence of Value
            The signal before this effect: its means over the substeps.
        memory : tuple of Value
            The memory that the interval before has left, or that of `rest`.
        dt : float
            The control interval [s].

        Returns
        -------
        signal : tuple of Value
            The signal after this effect, as many means.
        memory : tuple of Value
            The memory for the next interval.
        """

    def whole(self, signal: Array, dt: float) -> Array:
        """The signal of whole records after this effect, from rest; its parameters must be plain numbers.

        Parameters
        ----------
        signal : array (..., N, S)
            The signal before this effect: N intervals of S substeps.
        dt : float
            The control interval [s].

        Returns
        -------
        array (..., N, S)
            The signal after this effect.
        """
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
    """An effect that turns the command into the torque at the joint, if the log's command is not a torque.

    A model has at most one; without one its command is the torque. The input effects come before it and act on the
    command in its own unit.

    Attributes
    ----------
    command : str
        The kind of command: "torque", "current", "voltage" or "position".
    unit : str
        The command's unit, for a plant that turns.
    scale : str
        The parameter that sets the scale of all torques: motion alone cannot show it.
    damping : str
        The parameter by which it brakes the joint.
    at_angle : bool
        Whether the command is an angle of the joint: it is converted as one, and rests at the joint's own.
    """

    command: ClassVar[str] = "torque"
    unit: ClassVar[str] = "N m"
    scale: ClassVar[str] = ""
    damping: ClassVar[str] = ""
    at_angle: ClassVar[bool] = False

    @abstractmethod
    def torque(self, u: Value, theta: Value, theta_dot: Value) -> Value:
        """The torque on the joint under a command.

        Parameters
        ----------
        u : Value
            The command, in the actuator's unit.
        theta : Value
            Angle [rad].
        theta_dot : Value
            Speed [rad/s].

        Returns
        -------
        Value
            The torque [N m].
        """


@dataclass(frozen=True, eq=False)
class JointEffect(Effect):
    """An effect that adds a torque, and perhaps an inertia, at the joint.

    Attributes
    ----------
    friction : bool
        Whether it is a friction; effects that are one are summed last.
    """

    friction: ClassVar[bool] = False

    def inertia(self) -> Value:
        """The inertia that it adds.

        Returns
        -------
        Value
            The inertia [kg m^2], 0 by default.
        """
        return 0.0

    @abstractmethod
    def torque(self, joint: Joint) -> Value:
        """The torque on the joint; positive raises theta.

        Parameters
        ----------
        joint : Joint
            The joint's state, the time, the torques and the plant.

        Returns
        -------
        Value
            The torque [N m].
        """


@dataclass(frozen=True, eq=False)
class DryFriction(Effect):
    """An effect that opposes motion with a torque of its own size, and holds a joint at rest with up to that torque.

    Notes
    -----
    The integrator (`sysid.physics.integrators`) resolves it such that the joint really sticks, in every back end.
    """

    is_dry = True

    @abstractmethod
    def limits(self, joint: Joint) -> tuple[Value, Value]:
        """The largest torques against positive and against negative motion.

        Parameters
        ----------
        joint : Joint
            The joint's state, the time, the torques and the plant.

        Returns
        -------
        positive : Value
            The largest torque [N m] against positive motion, >= 0.
        negative : Value
            The largest torque [N m] against negative motion, >= 0.
        """


@dataclass(frozen=True, eq=False)
class DynamicEffect(Effect):
    """An effect at the joint whose torque depends on states of its own, which the joint's motion drives.

    Attributes
    ----------
    start_sd : tuple of float
        The standard deviation of each of its states about 0 when a record begins.
    """

    start_sd: ClassVar[tuple[float, ...]] = ()

    @abstractmethod
    def follow(self, states: Memory, stretch: Stretch) -> tuple[Value, Value, Memory]:
        """Follow the joint over a stretch of its motion.

        Parameters
        ----------
        states : tuple of Value
            The effect's states at the begin of the stretch.
        stretch : Stretch
            Its length h [s], the speed at its begin and its end [rad/s], and the travel [rad].

        Returns
        -------
        torque : Value
            The mean torque on the joint [N m].
        slope : Value
            Its derivative with respect to the speed at the end [N m s/rad], never positive.
        states : tuple of Value
            The states afterwards.
        """


@dataclass(frozen=True, eq=False)
class OutputEffect(Effect):
    """An effect that maps the joint's state to what the sensors show.

    Attributes
    ----------
    stage : int
        Its place in the order in which effects act: mechanics, timing, electronics.
    """

    stage: ClassVar[int] = 2

    def rest(self, theta: Value, theta_dot: Value, dt: float) -> Memory:
        """The memory of a sensor that has watched the joint arrive at this state at constant speed.

        Parameters
        ----------
        theta : Value
            Angle [rad].
        theta_dot : Value
            Speed [rad/s].
        dt : float
            The control interval [s].

        Returns
        -------
        tuple of Value
            The memory; () by default.
        """
        return ()

    @abstractmethod
    def read(self, reading: Reading, memory: Memory, t: Value, dt: float) -> tuple[Reading, Memory]:
        """The reading after this effect, and the memory for the next instant.

        Parameters
        ----------
        reading : Reading
            The angle [rad] and the speed [rad/s] before this effect.
        memory : tuple of Value
            The memory that the instant before has left, or that of `rest`.
        t : Value
            The instant [s].
        dt : float
            The control interval [s].

        Returns
        -------
        reading : Reading
            The angle [rad] and the speed [rad/s] after this effect.
        memory : tuple of Value
            The memory for the next instant.
        """

    def whole(self, reading: Reading, t: Array, dt: float) -> Reading:
        """The readings of a whole record after this effect; its parameters must be plain numbers.

        Parameters
        ----------
        reading : Reading
            The angles (..., N+1) [rad] and the speeds (..., N+1) [rad/s] before this effect.
        t : array (..., N+1)
            The instants [s].
        dt : float
            The control interval [s].

        Returns
        -------
        Reading
            The angles (..., N+1) [rad] and the speeds (..., N+1) [rad/s] after this effect.
        """
        memory = self.rest(reading.theta[..., 0], reading.theta_dot[..., 0], dt)
        if not memory:
            return self.read(reading, memory, t, dt)[0]
        seen = []
        for k in range(reading.theta.shape[-1]):
            now, memory = self.read(Reading(reading.theta[..., k], reading.theta_dot[..., k]), memory, t[..., k], dt)
            seen.append(now)
        return Reading(np.stack([r.theta for r in seen], axis=-1), np.stack([r.theta_dot for r in seen], axis=-1))
