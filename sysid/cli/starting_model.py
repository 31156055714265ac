"""The model that a command begins with: the plain plant or a file's, what the user knows put in, and what is free."""

from __future__ import annotations

import dataclasses
import logging
import math

import numpy as np

from sysid.cli.command_options import ModelOptions
from sysid.data.columns import Command
from sysid.data.logs import Log
from sysid.data.needed_rate import needed_rate
from sysid.data.record import Record
from sysid.errors import InvalidInput
from sysid.estimation.fit import free, without_scale
from sysid.estimation.saved_model import load
from sysid.limits import LOG_SUBSTEPS, check_size
from sysid.physics.effects import CATALOGUE, Actuator, effect
from sysid.physics.effects.actuators import DCMotor, PositionServo, TorqueConstant
from sysid.physics.integrators import RK4
from sysid.physics.model import Model
from sysid.physics.plants import GRAVITY, GeneralJoint, LinearAxis, Plant, PointMassPendulum, RodPendulum

logger = logging.getLogger(__name__)

PLANTS: dict[str, Plant] = {
    "rod": RodPendulum(g=GRAVITY),
    "point": PointMassPendulum(),
    "joint": GeneralJoint(),
    "axis": LinearAxis(),
}
INPUTS: dict[Command, type[Actuator] | None] = {
    "torque": None,
    "current": TorqueConstant,
    "voltage": DCMotor,
    "position": PositionServo,
}
"""What turns each kind of command into torque."""
SUBSTEP = 0.01
"""Longest step [s] of the integrator."""
STEP_TOLERANCE = 0.05
"""Share by which a step may be longer all the same: a rate of 99.98 Hz asks for no second one."""
SEVERAL_TURNS = 6.0 * math.pi
"""How far [rad] a joint goes in one direction that turns round, and is no pendulum that swings over."""


def begun(options: ModelOptions, command: Command | None) -> tuple[Model, tuple[str, ...], tuple[str, ...]]:
    """The model of the file or the plain plant, what the user knows put in; its free names; those of --with.

    Where the command is no torque, an actuator is in the model.
    """
    if options.model is None:
        model = Model(PLANTS[options.plant or "rod"])
        names = free(model)
    else:
        saved = load(options.model)
        model, names = saved.model, saved.free
        _check_plant(options, model.plant)
    known = named_numbers("--set", options.set)
    model, added = _with_effects(model, options.effects_from_start)
    model, more = _with_actuator(model, command)
    names += more
    for name in known:
        owner, dot, _ = name.partition(".")
        if dot and owner in CATALOGUE and name not in model.parameters and owner not in model.effect_names:
            raise InvalidInput(f"--set {name}: the model has no {owner} yet; --with {name}={known[name]:g} puts it in")
    model = model.with_parameters(known)
    added = tuple(n for n in added if n not in known)
    names = (*(n for n in names if n not in known), *added)
    if options.model is None:
        names += _scale(model, names, (*known, *options.effects_from_start.split(",")))
    return model, names, added


def _check_plant(options: ModelOptions, plant: Plant) -> None:
    """Raise InvalidInput where --plant says otherwise than --model."""
    if options.plant is None or type(PLANTS[options.plant]) is type(plant):
        return
    plant_name = next((name for name, known in PLANTS.items() if type(known) is type(plant)), type(plant).__name__)
    raise InvalidInput(f"--plant {options.plant}, but the plant of {options.model} is {plant_name}: leave --plant out")


def _with_effects(model: Model, text: str) -> tuple[Model, tuple[str, ...]]:
    """The model with the effects of "coulomb,viscous.b=0.1", and the names of their parameters that have no number."""
    numbers: dict[str, dict[str, float]] = {}
    for part in (part.strip() for part in text.split(",") if part.strip()):
        whole, equals, _ = part.partition("=")
        owner, dot, field = whole.strip().partition(".")
        known = effect(owner).parameters
        if bool(equals) != bool(dot) or (dot and field not in known):
            choices = " or ".join([owner, *(f"{owner}.{name}=NUMBER" for name in known)])
            raise InvalidInput(f"--with {part!r}: expected {choices}")
        numbers.setdefault(owner, {})
        if equals:
            numbers[owner][field] = named_numbers("--with", [part])[whole.strip()]
    for owner, fields in numbers.items():
        if owner in model.effect_names:
            raise InvalidInput(f"--with {owner}: the model has it already; --set {owner}.NAME=NUMBER fixes its numbers")
        model = model.with_effect(effect(owner, **fields))
    return model, tuple(
        n for o, fields in numbers.items() for n in _fitted(model, o) if model.parameters[n].field not in fields
    )


def _fitted(model: Model, owner: str) -> tuple[str, ...]:
    """The names that a fit may move of an effect, or of an actuator: its constant is known, or nothing is."""
    return tuple(n for n in model.names_of(owner) if not model.parameters[n].known)


def _with_actuator(model: Model, command: Command | None) -> tuple[Model, tuple[str, ...]]:
    """The model with what turns that kind of command into torque, and the names that a fit may move of it."""
    actuator, wanted = model.actuator, INPUTS[command or "torque"]
    if command is None or (type(actuator) if actuator else None) is wanted:
        return model, ()
    if actuator is not None or wanted is None:
        has = (
            f"a {actuator.name}, driven by a {actuator.command} command"
            if actuator
            else "no actuator: its command is a torque"
        )
        raise InvalidInput(f"--input {command}, but the model has {has}")
    model = model.with_effect(wanted())
    return model, _fitted(model, wanted.name)


def _scale(model: Model, names: tuple[str, ...], known: tuple[str, ...]) -> tuple[str, ...]:
    """The actuator's constant where the plant's own numbers are known and it is not; else a word on what that means."""
    actuator = model.actuator
    if actuator is None:
        return ()
    scale = f"{actuator.name}.{actuator.scale}"
    if scale in names or any(k.partition("=")[0].strip() == scale for k in known):
        return ()
    if not any(n in names for n in model.plant.parameters):
        return (scale,)
    _cannot_show("motion alone", model, scale, "torque, friction and inertia", ", or what the plant weighs")
    return ()


def _cannot_show(what: str, model: Model, scale: str, relative: str, besides: str = "") -> None:
    p = model.parameters[scale]
    logger.info(
        f"{what} cannot show {scale}: it stays at {p.value:g} {p.unit}, and every {relative} is relative to it; "
        f"give it with --set {scale}=...{besides}"
    )


def sampled(model: Model, names: tuple[str, ...], log: Log, given: bool) -> Model:
    """The model at the log's sample interval; its integrator's steps stay as fine, no longer than SUBSTEP and than the
    log's motion needs, and short enough for a known loop, whose free `names` are neither its inertia nor its damping.

    A `given` model of that interval stays as it is.
    """
    dt = log.dt
    if not isinstance(model.integrator, RK4):
        return dataclasses.replace(model, dt=dt) if abs(model.dt - dt) < 0.01 * dt else model
    if given and abs(model.dt - dt) <= 1e-6 * dt and model.integrator.substeps <= LOG_SUBSTEPS:
        return dataclasses.replace(model, dt=dt)
    longest, why = min(SUBSTEP, 1.0 / needed_rate(log), model.dt / model.integrator.substeps), ""
    if set(names).isdisjoint((*model.plant.parameters, model.damping)) and longest * _fastest_rate(model) > 1.0:
        longest, why = 1.0 / _fastest_rate(model), ", which the stiffness and the damping that are set ask for"
    substeps = math.ceil(dt / longest - STEP_TOLERANCE)
    check_size(f"the integrator's steps of {longest:.3g} s in {dt:g} s{why}:", substeps, LOG_SUBSTEPS)
    return dataclasses.replace(model, dt=dt, integrator=RK4(substeps=substeps))


def _fastest_rate(model: Model) -> float:
    """How fast [1/s] a deflection or a speed of the resting joint dies away, or swings: steps much longer than its
    inverse are unstable."""
    rest, small = model.plant.rest, 1e-3

    def acceleration(theta: float, theta_dot: float) -> float:
        held = rest if model.at_angle else 0.0
        return float(model.acceleration(rest + theta, theta_dot, 0.0, held))

    stiffness = (acceleration(-small, 0.0) - acceleration(small, 0.0)) / (2.0 * small)
    damping = (acceleration(0.0, -small) - acceleration(0.0, small)) / (2.0 * small)
    return max(math.sqrt(max(stiffness, 0.0)), damping, 1e-9)


def identifiable_part(model: Model, names: tuple[str, ...], log: Log, given: bool) -> tuple[Model, tuple[str, ...]]:
    """The model and its free names without those that the log cannot show: what sets the scale of all torques where no
    torque is known, and a gravity that could also be none where no angle says where a joint is that turns round. That
    of a `given` model stays as it is."""
    kept = without_scale(model, names, log)
    if kept != names:
        _cannot_show("a free swing", model, model.plant.scale, "torque" if model.plant.turns else "force")
    names = kept
    gravity = model.plant.gravity
    if gravity in names and any(map(_turns_round, log)):
        model = model if given else model.with_parameters({gravity: 0.0})
        logger.info(
            "speeds alone cannot show where gravity pulls at a joint that turns round: "
            f"{gravity} = {float(model.parameters[gravity].value):g} is taken; give it with --set {gravity}=..."
        )
        names = tuple(n for n in names if n != gravity)
    return model, names


def _turns_round(record: Record) -> bool:
    """Whether a joint of which the speed alone is known goes round several times in one direction."""
    if record.theta is not None or record.theta_dot is None:
        return False
    speed = np.nan_to_num(record.theta_dot)
    turned = np.flatnonzero(np.diff(np.sign(speed), prepend=np.nan) != 0.0)
    return float(np.max(np.abs(np.add.reduceat(speed, turned)))) * record.dt > SEVERAL_TURNS


def named_numbers(option: str, pairs: tuple[str, ...] | list[str]) -> dict[str, float]:
    """{name: number} of "name=number"."""
    values: dict[str, float] = {}
    for pair in pairs:
        name, _, number = (part.strip() for part in pair.partition("="))
        try:
            values[name] = float(number)
        except ValueError:
            raise InvalidInput(f"{option} {pair!r}: expected NAME=NUMBER, as in l=0.45") from None
    return values
