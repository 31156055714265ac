"""Model = plant + effects + integrator."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from sysid.errors import InvalidInput, check_kind, is_real, items_of
from sysid.limits import LOG_SUBSTEPS, check_range
from sysid.physics.effects.effect import (
    Actuator,
    DryFriction,
    DynamicEffect,
    Effect,
    InputEffect,
    Joint,
    JointEffect,
    Memory,
    OutputEffect,
    Reading,
    Stretch,
)
from sysid.physics.integrators import RK4, Integrator
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Parameter
from sysid.physics.plants import Plant

Drives = tuple[Value, ...]
LONGEST_STEP = 0.025
"""Longest step [s] of the integrator if none is asked for."""
NEWTON_STEPS = 4
"""Newton steps for the speed at the end of a substep; one is exact if the dynamic effects are linear."""


def _integrator_of(dt: float) -> Integrator:
    """The integrator of a control interval dt [s] if none is asked for."""
    return RK4(substeps=max(2, math.ceil(min(dt / LONGEST_STEP, LOG_SUBSTEPS))) if dt > 0.0 else 2)


class State(NamedTuple):
    """The state of a model at one instant.

    Attributes
    ----------
    theta : Value
        Angle [rad], unwrapped, 0 upright.
    theta_dot : Value
        Speed [rad/s].
    memory : tuple of tuples of Value
        The memory of each input effect and of each dynamic effect.
    """

    theta: Value
    theta_dot: Value
    memory: tuple[Memory, ...] = ()


@dataclass(frozen=True, eq=False)
class Model:
    """A plant with effects, stepped by an integrator: the one description that is simulated, fitted and trained on.

        (J + sum J_e) theta_ddot = gravity_torque(theta) + actuator(drive(u)) + sum torque_e - dry friction + push

    The command u is a torque if no effect is an actuator; push is a torque from outside. Parameters of the plant have
    their own names ("m", "l"), those of effects "effect.field" ("viscous.b").

    Parameters
    ----------
    plant : Plant
        What swings or slides.
    effects : tuple of Effect
        What else acts: between command and drive torque, at the joint, and between joint and readings.
    integrator : Integrator, optional
        The scheme that steps a control interval; by default RK4 in two steps or more, none longer than 25 ms.
    dt : float
        The control interval [s].
    u_max : float
        The largest command, in its own unit (N m without an actuator).

    Raises
    ------
    InvalidInput
        For dt or u_max that are not positive, an effect given twice, two that exclude each other, or two actuators.
    """

    plant: Plant
    effects: tuple[Effect, ...] = ()
    integrator: Integrator = None  # type: ignore[assignment]
    dt: float = 0.05
    u_max: float = math.inf

    def __post_init__(self) -> None:
        if not (is_real(self.dt) and math.isfinite(self.dt)):
            raise InvalidInput(f"dt = {self.dt!r}: expected a positive number of seconds")
        for name in ("dt", "u_max"):
            value = getattr(self, name)
            if not (is_real(value) and value > 0.0):
                raise InvalidInput(f"{name} = {value!r}: expected a positive number")
        check_range("u_max =", self.u_max)
        if not isinstance(self.plant, Plant):
            raise InvalidInput(f"plant is {self.plant!r}: expected a plant, such as RodPendulum()")
        object.__setattr__(self, "integrator", self.integrator or _integrator_of(self.dt))
        if not isinstance(self.integrator, Integrator):
            raise InvalidInput(f"integrator is {self.integrator!r}: expected one, such as RK4(substeps=2)")
        object.__setattr__(self, "effects", items_of(self.effects))
        for e in self.effects:
            if not isinstance(e, InputEffect | Actuator | JointEffect | DryFriction | DynamicEffect | OutputEffect):
                raise InvalidInput(f"effects holds {e!r}: expected effects, such as effect('viscous')")
        names = self.effect_names
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise InvalidInput(f"effect {twice[0]!r} was given {names.count(twice[0])} times: expected once")
        for e in self.effects:
            for other in e.excludes:
                if other in names:
                    raise InvalidInput(f"effects {e.name!r} and {other!r} contain each other: expected one of them")
        actuators = [e.name for e in self.effects if isinstance(e, Actuator)]
        if len(actuators) > 1:
            raise InvalidInput(f"the model has actuators {' and '.join(actuators)}: expected one of them")

    def __getstate__(self) -> dict[str, object]:
        """What is pickled: the fields, without what was derived from them."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    @property
    def effect_names(self) -> tuple[str, ...]:
        """The names of the effects."""
        return tuple(e.name for e in self.effects)

    def effect_named(self, name: str) -> Effect:
        """The effect of that name; raises InvalidInput where it has none."""
        for e in self.effects:
            if e.name == name:
                return e
        raise InvalidInput(f"the model has no effect {name!r}: it has {', '.join(self.effect_names) or 'none'}")

    @cached_property
    def input_effects(self) -> tuple[InputEffect, ...]:
        """The effects between command and drive torque, in the order in which they act."""
        return tuple(sorted((e for e in self.effects if isinstance(e, InputEffect)), key=lambda e: e.stage))

    @cached_property
    def actuator(self) -> Actuator | None:
        """What turns the command into torque; None if the command is the torque."""
        return next((e for e in self.effects if isinstance(e, Actuator)), None)

    @property
    def damping(self) -> str:
        """The full name of the parameter by which the actuator brakes the joint; empty if there is none."""
        actuator = self.actuator
        return f"{actuator.name}.{actuator.damping}" if actuator is not None and actuator.damping else ""

    @property
    def command(self) -> str:
        """What kind of command drives the joint: "torque" without an actuator, else that of the actuator."""
        return "torque" if self.actuator is None else self.actuator.command

    @property
    def at_angle(self) -> bool:
        """Whether the command is an angle of the joint, as that of a servo is."""
        return self.actuator is not None and self.actuator.at_angle

    @property
    def command_unit(self) -> str:
        """The unit of the command."""
        return self.plant.unit("N m" if self.actuator is None else self.actuator.unit)

    @cached_property
    def joint_effects(self) -> tuple[JointEffect, ...]:
        """The effects that act at the joint."""
        return tuple(e for e in self.effects if isinstance(e, JointEffect))

    @cached_property
    def dry_frictions(self) -> tuple[DryFriction, ...]:
        """The effects that can hold the joint at rest."""
        return tuple(e for e in self.effects if isinstance(e, DryFriction))

    @cached_property
    def dynamic_effects(self) -> tuple[DynamicEffect, ...]:
        """The effects that act at the joint and have states of their own."""
        return tuple(e for e in self.effects if isinstance(e, DynamicEffect))

    @cached_property
    def inner_sd(self) -> tuple[float, ...]:
        """Standard deviations of the dynamic effects' states about 0 when a record begins."""
        return tuple(sd for e in self.dynamic_effects for sd in e.start_sd)

    @cached_property
    def output_effects(self) -> tuple[OutputEffect, ...]:
        """The effects between joint and reading, in the order in which they act."""
        return tuple(sorted((e for e in self.effects if isinstance(e, OutputEffect)), key=lambda e: e.stage))

    @property
    def machine(self) -> Model:
        """The same model without effects that belong to the log it was fitted to: what a controller will meet."""
        return dataclasses.replace(self, effects=tuple(e for e in self.effects if not e.of_log))

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its full name, in the plant's units: N for N m, where it does not turn."""
        named = dict(self.plant.parameters)
        for e in self.effects:
            for key, p in e.parameters.items():
                name = f"{e.name}.{key}"
                of_command = isinstance(e, InputEffect) and p.unit == "N m"
                unit = self.command_unit if of_command else self.plant.unit(p.unit)
                named[name] = dataclasses.replace(p, name=name, unit=unit, owner=e.name)
        return named

    def names_of(self, owner: str) -> tuple[str, ...]:
        """The full names of an effect's parameters; "" has those of the plant."""
        return tuple(name for name, p in self.parameters.items() if p.owner == owner)

    def check_names(self, names: Collection[str]) -> None:
        """Raise InvalidInput for a name that is no parameter of this model or comes twice, and for what is no list."""
        known = self.parameters
        if isinstance(names, str) or not isinstance(names, Collection):
            raise InvalidInput(f"parameters = {names!r}: expected a list of names, such as {list(known)[:1]}")
        for name in names:
            if not isinstance(name, str) or name not in known:
                raise InvalidInput(f"unknown parameter {name!r}: this model has {', '.join(known)}")
        if len(set(names)) < len(names):
            raise InvalidInput(f"a parameter is named twice in {', '.join(names)}")

    def with_parameters(self, values: Mapping[str, Value]) -> Model:
        """The same model holding other numbers: floats, arrays, CasADi symbols or torch tensors."""
        self.check_names(values)
        by_owner: dict[str, dict[str, Value]] = {}
        for name, p in self.parameters.items():
            if name in values:
                by_owner.setdefault(p.owner, {})[p.field] = values[name]
        effects = tuple(e.with_parameters(by_owner.get(e.name, {})) for e in self.effects)
        return dataclasses.replace(self, plant=self.plant.with_parameters(by_owner.get("", {})), effects=effects)

    def numbers(self, names: Sequence[str]) -> Array:
        """The numbers (P,) that it has for these parameters."""
        self.check_names(names)
        return np.array([float(self.parameters[name].value) for name in names])

    def with_numbers(self, names: Sequence[str], values: Sequence[Value] | Array) -> Model:
        """The same model holding these values (P,) for these parameters, in their order (see `with_parameters`)."""
        if len(names) != len(values):
            raise InvalidInput(f"{len(values)} values for {len(names)} parameters: expected one for each")
        return self.with_parameters(dict(zip(names, values, strict=True)))

    def with_effect(self, effect: Effect) -> Model:
        """The same model with one more effect."""
        return dataclasses.replace(self, effects=(*self.effects, effect))

    def without_effect(self, name: str) -> Model:
        """The same model without the effect of that name; raises InvalidInput where it has none."""
        left_out = self.effect_named(name)
        return dataclasses.replace(self, effects=tuple(e for e in self.effects if e is not left_out))

    def rest(self, like: Value = 0.0) -> tuple[Memory, ...]:
        """The memory of the input effects after a long time without command, in the shape and back end of `like`.

        A servo is taken to have held the angle `like` for that time.
        """
        held = like if self.at_angle else like * 0.0
        return tuple(tuple(held + v for v in e.rest(self.dt)) for e in self.input_effects)

    def inner_rest(self, like: Value = 0.0) -> tuple[Memory, ...]:
        """The states of the dynamic effects of a joint at rest, in the shape and back end of `like`."""
        return tuple((like * 0.0,) * len(e.start_sd) for e in self.dynamic_effects)

    def initial_state(self, theta: Value, theta_dot: Value) -> State:
        """The state at theta [rad], theta_dot [rad/s] after a long time without command."""
        return State(theta, theta_dot, (*self.rest(theta), *self.inner_rest(theta)))

    def drive(self, u: Value, memory: tuple[Memory, ...]) -> tuple[Drives, tuple[Memory, ...]]:
        """The drive torques [N m] of the substeps under the command u [N m] held over dt, and the memory afterwards."""
        signal: Drives = (u,) * self.integrator.substeps
        after: list[Memory] = []
        for e, own_memory in zip(self.input_effects, memory, strict=True):
            signal, own_after = e.advance(signal, own_memory, self.dt)
            after.append(own_after)
        return signal, tuple(after)

    @property
    def ahead(self) -> int:
        """By how many intervals the input effects get the commands of a log early (see `Stamp`)."""
        return sum(e.ahead for e in self.input_effects)

    def drives(self, u: Sequence[Value], like: Value = 0.0) -> Iterator[Drives]:
        """Yield the drive torques of each interval of a whole record u (N,) [N m], from rest.

        N + ahead commands are passed on, the last one repeated, and the first `ahead` results are dropped. Until the
        record begins a servo has held its first command.
        """
        memory = self.rest(like * 0.0 + u[0])
        for k, command in enumerate((*u, *(u[-1],) * self.ahead)):
            drives, memory = self.drive(command, memory)
            if k >= self.ahead:
                yield drives

    def drive_record(self, u: Array) -> Array:
        """What `drives` yields, as (..., N, S) for records (..., N) at once: plain numbers only, many times faster."""
        fed = np.concatenate([u, np.repeat(u[..., -1:], self.ahead, axis=-1)], axis=-1)
        # effects with a memory begin at rest, which is a servo's first command
        held = u[..., :1, None] if self.at_angle else 0.0
        signal = np.repeat(fed[..., None], self.integrator.substeps, axis=-1) - held
        for e in self.input_effects:
            signal = e.whole(signal, self.dt)
        return signal[..., self.ahead :, :] + held

    def torque(self, theta: Value, theta_dot: Value, drive: Value) -> Value:
        """The actuator's torque [N m] under a command that has passed through the input effects."""
        return drive if self.actuator is None else self.actuator.torque(drive, theta, theta_dot)

    def joint(self, theta: Value, theta_dot: Value, t: Value, drive: Value, push: Value = 0.0) -> Joint:
        """The state, the torques and the plant, as the effects at the joint get them."""
        torque = self.torque(theta, theta_dot, drive)

        def summed() -> Value:
            unloaded = Joint(theta, theta_dot, t, torque, self.plant, float, drive)
            load = unloaded.gravity + push
            for e in self.joint_effects:
                if not e.friction:
                    load = load + e.torque(unloaded)
            return load

        return Joint(theta, theta_dot, t, torque, self.plant, summed, drive)

    def inertia(self) -> Value:
        """J of the plant plus what the effects add [kg m^2]."""
        J = self.plant.inertia()
        for e in self.joint_effects:
            J = J + e.inertia()
        return J

    def acceleration(self, theta: Value, theta_dot: Value, t: Value, drive: Value, push: Value = 0.0) -> Value:
        """theta_ddot [rad/s^2] under a drive torque [N m], without dry friction."""
        joint = self.joint(theta, theta_dot, t, drive, push)
        torque = joint.drive + joint.load
        for e in self.joint_effects:
            if e.friction:
                torque = torque + e.torque(joint)
        return torque / self.inertia()

    def deceleration(
        self, theta: Value, theta_dot: Value, t: Value, drive: Value, push: Value = 0.0
    ) -> tuple[Value, Value]:
        """The largest deceleration by dry friction [rad/s^2], from positive and from negative speed."""
        joint, J = self.joint(theta, theta_dot, t, drive, push), self.inertia()
        plus: Value = 0.0
        minus: Value = 0.0
        for e in self.dry_frictions:
            against_positive, against_negative = e.limits(joint)
            plus, minus = plus + against_positive, minus + against_negative
        return plus / J, minus / J

    def move(
        self, theta: Value, theta_dot: Value, drives: Drives, t: Value = 0.0, push: Value = 0.0
    ) -> tuple[Value, Value]:
        """(theta, theta_dot) after dt under known drive torques and a constant push [N m], without the input effects.
        Raises InvalidInput for a model with dynamic effects: their states need `move_with_inner`."""
        if self.dynamic_effects:
            name = self.dynamic_effects[0].name
            raise InvalidInput(
                f"effect {name!r} has states of its own, which this method does not carry: expected a model without it"
            )
        return self._moved(theta, theta_dot, drives, t, push, self.integrator, self.dt)

    def _moved(
        self, theta: Value, theta_dot: Value, drives: Drives, t: Value, push: Value, integrator: Integrator, dt: float
    ) -> tuple[Value, Value]:
        """(theta, theta_dot) after dt [s], without the dynamic effects."""
        accelerated, slowed = partial(self.acceleration, push=push), partial(self.deceleration, push=push)
        dry = slowed if self.dry_frictions else None
        return integrator.advance(accelerated, theta, theta_dot, t, drives, dt, dry)

    def move_with_inner(
        self,
        theta: Value,
        theta_dot: Value,
        inner: tuple[Memory, ...],
        drives: Drives,
        t: Value = 0.0,
        push: Value = 0.0,
    ) -> tuple[Value, Value, tuple[Memory, ...]]:
        """What `move` gives, and the states of the dynamic effects afterwards.

        Each substep is taken twice: under the torque that these effects have at its begin, then under their mean torque
        on the way to the end speed that agrees with it, which Newton's method finds.
        """
        if not self.dynamic_effects:
            return (*self._moved(theta, theta_dot, drives, t, push, self.integrator, self.dt), ())
        h, J = self.dt / self.integrator.substeps, self.inertia()
        one = dataclasses.replace(self.integrator, substeps=1)
        for k, drive in enumerate(drives):
            step = partial(self._moved, theta, theta_dot, (drive,), t + k * h, integrator=one, dt=h)
            torque, _, _ = self._followed(inner, Stretch(h, theta_dot, theta_dot, h * theta_dot))
            speed = step(push=push + torque)[1]
            free = speed - h * torque / J
            for _ in range(NEWTON_STEPS):
                torque, slope, _ = self._followed(inner, Stretch(h, theta_dot, speed, 0.5 * h * (theta_dot + speed)))
                speed = speed - (speed - free - h * torque / J) / (1.0 - h * slope / J)
            torque, _, _ = self._followed(inner, Stretch(h, theta_dot, speed, 0.5 * h * (theta_dot + speed)))
            angle, speed = step(push=push + torque)
            _, _, inner = self._followed(inner, Stretch(h, theta_dot, speed, angle - theta))
            theta, theta_dot = angle, speed
        return theta, theta_dot, inner

    def _followed(self, inner: tuple[Memory, ...], stretch: Stretch) -> tuple[Value, Value, tuple[Memory, ...]]:
        """What `follow` gives for all dynamic effects: their torques and slopes summed, and the states of each."""
        followed = [e.follow(states, stretch) for e, states in zip(self.dynamic_effects, inner, strict=True)]
        torque: Value = sum((o[0] for o in followed[1:]), followed[0][0])
        slope: Value = sum((o[1] for o in followed[1:]), followed[0][1])
        return torque, slope, tuple(o[2] for o in followed)

    def sensing(self, theta: Value, theta_dot: Value) -> tuple[Memory, ...]:
        """The memory of each output effect for a joint that has come to this state at constant speed."""
        reading, memories = Reading(theta, theta_dot), list[Memory]()
        for e in self.output_effects:
            memories.append(e.rest(*reading, self.dt))
            reading, _ = e.read(reading, memories[-1], 0.0, self.dt)
        return tuple(memories)

    def read(
        self, theta: Value, theta_dot: Value, sensing: tuple[Memory, ...] = (), t: Value = 0.0
    ) -> tuple[Reading, tuple[Memory, ...]]:
        """What the sensors show at theta, theta_dot, and their memory for the next instant, dt later."""
        reading, after = Reading(theta, theta_dot), list[Memory]()
        for e, own_memory in zip(self.output_effects, sensing, strict=True):
            reading, own_after = e.read(reading, own_memory, t, self.dt)
            after.append(own_after)
        return reading, tuple(after)

    def read_record(self, theta: Array, theta_dot: Array, t: Array) -> Reading:
        """What `read` gives instant by instant along whole records (..., N+1), for plain numbers."""
        reading = Reading(theta, theta_dot)
        for e in self.output_effects:
            reading = e.whole(reading, t, self.dt)
        return reading

    def advance(self, state: State, u: Value, t: Value = 0.0) -> State:
        """The state an interval dt later under command u [N m]; shapes broadcast, u is not clipped."""
        inputs = len(self.input_effects)
        drives, memory = self.drive(u, state.memory[:inputs])
        theta, theta_dot, inner = self.move_with_inner(state.theta, state.theta_dot, state.memory[inputs:], drives, t)
        return State(theta, theta_dot, (*memory, *inner))


def check_model(model: Model) -> None:
    """Raise InvalidInput for what is no Model, such as a plant, a path or the estimate of a model."""
    some = "estimate.model, load_model(path) or Model(RodPendulum(), dt=records.dt)"
    check_kind("model", model, Model, f"a Model, such as {some}")
