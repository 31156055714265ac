"""A model in the terms that simulators share: a body, a joint with passive torques, an actuator."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from sysid.errors import InvalidInput
from sysid.physics.effects.actuation import BackEmf, Delay, Lag, Saturation, TorqueGain
from sysid.physics.effects.actuators import DCMotor, PositionServo, TorqueConstant
from sysid.physics.effects.disturbance import TorqueBias
from sysid.physics.effects.effect import Effect
from sysid.physics.effects.friction import Coulomb, Viscous
from sysid.physics.effects.load import RotorInertia, Spring, Tilt
from sysid.physics.model import Model, check_model
from sysid.physics.parameters import NEVER
from sysid.physics.plants import GRAVITY, LinearAxis, Plant, PointMassPendulum, RodPendulum


@dataclass(frozen=True)
class Body:
    """A link: its mass [kg], how far its center is from the axis [m], its inertia about that center [kg m^2], and
    gravity [m/s^2]."""

    mass: float
    center: float
    inertia: float
    gravity: float


@dataclass(frozen=True)
class Mechanism:
    """What a joint and its actuator do, in SI units of what turns (or slides).

        J theta_ddot = gravity + bias - damping theta_dot - stiffness (theta - rest) -+ friction + force
        force = clip(gain drive - position_gain theta - speed_gain theta_dot, -force_limit, force_limit)
        drive = clip(scale u, -limit, limit), u clipped at u_max, `delay` [s] late and lagging by `lag` [s]

    Gravity leans by `tilt` [rad], and J has `armature` beside the body's.
    """

    turns: bool
    body: Body
    u_max: float
    rest: float
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    bias: float = 0.0
    tilt: float = 0.0
    scale: float = 1.0
    limit: float = math.inf
    delay: float = 0.0
    lag: float = 0.0
    gain: float = 1.0
    position_gain: float = 0.0
    speed_gain: float = 0.0
    force_limit: float = math.inf


def body(plant: Plant) -> Body:
    """The link of a plant; of an inertia and a gravity torque alone, a rod that moves alike."""
    try:
        numbers = {name: float(p.value) for name, p in plant.parameters.items()}
        J, G = float(plant.inertia()), float(plant.largest_gravity_torque)
    except (TypeError, ValueError):
        raise InvalidInput("the model's numbers are arrays: expected a model of one machine") from None
    if isinstance(plant, LinearAxis):
        return Body(numbers["m"], 0.0, J, 0.0)
    if isinstance(plant, PointMassPendulum | RodPendulum):
        m, g = numbers["m"], numbers["g"]
        center = numbers["l"] * (0.5 if isinstance(plant, RodPendulum) else 1.0)
        return Body(m, center, max(J - m * center**2, 1e-6 * J), g)
    if G <= 0.0:
        return Body(1.0, 0.0, J, GRAVITY)
    center = min(0.75 * J * GRAVITY / G, 1.0)
    return Body(G / (GRAVITY * center), center, J - center * G / GRAVITY, GRAVITY)


def _limited(value: float) -> float:
    """A limit, where it stands for never: infinity."""
    return math.inf if abs(value) >= NEVER else value


TERMS: dict[type[Effect], Callable[[Any, Mechanism], dict[str, float]]] = {
    Viscous: lambda e, m: {"damping": m.damping + e.b},
    BackEmf: lambda e, m: {"damping": m.damping + e.k},
    Coulomb: lambda e, m: {"friction": e.tau_c},
    RotorInertia: lambda e, m: {"armature": e.J_r},
    Spring: lambda e, m: {"stiffness": e.k},
    TorqueBias: lambda e, m: {"bias": e.tau_0},
    Tilt: lambda e, m: {"tilt": e.alpha},
    TorqueGain: lambda e, m: {"scale": e.c * m.scale, "limit": e.c * m.limit},
    Saturation: lambda e, m: {"limit": min(m.limit, _limited(e.limit))},
    Delay: lambda e, m: {"delay": e.T},
    Lag: lambda e, m: {"lag": e.T},
    TorqueConstant: lambda e, m: {"gain": e.k_t},
    DCMotor: lambda e, m: {"gain": e.k, "speed_gain": e.k * e.k_e},
    PositionServo: lambda e, m: {
        "gain": e.k_p,
        "position_gain": e.k_p,
        "speed_gain": e.k_d,
        "force_limit": _limited(e.limit),
    },
}
"""What an effect is in these terms: the fields of the mechanism that it changes."""


def mechanism(model: Model) -> Mechanism:
    """The mechanism of a model of one machine. Raises InvalidInput for one whose numbers are arrays."""
    check_model(model)
    machine = Mechanism(model.plant.turns, body(model.plant), model.u_max, model.plant.rest)
    others = tuple(e for e in model.effects if e not in model.input_effects)
    for effect in (*model.input_effects, *others):
        if type(effect) in TERMS and not effect.idle:
            changes: dict[str, Any] = {k: float(v) for k, v in TERMS[type(effect)](effect, machine).items()}
            machine = dataclasses.replace(machine, **changes)
    return machine
