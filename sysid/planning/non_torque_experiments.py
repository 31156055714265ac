"""Experiments beside torques: a payload, a scale, the driver off, for what no torque ever tells apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.estimation.fit import free
from sysid.physics import ops
from sysid.physics.effects import Joint, JointEffect
from sysid.physics.effects.actuation import BackEmf, TorqueGain
from sysid.physics.effects.friction import Viscous
from sysid.physics.effects.load import RotorInertia
from sysid.physics.model import Model
from sysid.physics.ops import Array, Value
from sysid.planning.design import Conditions, Hypothesis, Pool, precision, search, within_limits, yardsticks
from sysid.planning.planned_experiment import Experiment
from sysid.planning.rival_effects import inertial, without
from sysid.planning.signals import Signal, rest_angle

GRAVITY = 9.81
"""[m/s^2] where the plant has none of its own."""
_HEAVIER = 0.5
"""Share of the joint's own inertia that a payload of our choice adds."""
_ANSWERS = {
    ("angle_offset", "tilt"): "for a fixed axis an encoder offset is a tilted base, also to every controller: "
    "where it matters, compare the encoder's zero with a plumb line",
    ("delay", "sensor_delay"): "only the sum of both delays shows between command and reading, and only the sum "
    "matters to a controller: where each is wanted, move the joint by hand beside a second clock, such as a camera",
} | {
    (late, "stamp"): "log at another rate: what the log's stamps shift changes with the interval, a delay of the "
    f"{part} does not"
    for late, part in (("delay", "machine"), ("sensor_delay", "sensor"))
}


@dataclass(frozen=True, eq=False)
class Payload(JointEffect):
    """A known point mass [kg] at a known distance [m] from the axis; `weighs` where gravity pulls the plant."""

    mass: float = 0.0
    distance: float = 0.0
    weighs: bool = True

    def inertia(self) -> Value:
        return self.mass * self.distance**2

    def torque(self, joint: Joint) -> Value:
        g = getattr(joint.plant, "g", GRAVITY) if self.weighs else 0.0
        return self.mass * g * self.distance * ops.sin(joint.theta)


def never(names: Sequence[str]) -> bool:
    """Whether it is known of these effects that no torque tells them apart, and that no size of theirs matters."""
    return tuple(sorted(names)) in _ANSWERS


def non_torque_experiment(
    model: Model, names: Sequence[str], conditions: Conditions, rng: np.random.Generator, after: float | None = None
) -> Experiment:
    """What tells apart effects ("torque_gain") or parameters ("m", "rotor_inertia.J_r") that no torque does.

    Back-EMF against friction: the driver off. What shows as an inertia or a gravity torque: a payload, a scale,
    a ruler, with the least labour. `after` is the evidence that the best torque would bring, where that is known.
    Raises InvalidInput where no signal keeps to the limits.
    """
    owners = {name: p.owner or name for name, p in model.parameters.items()}
    names = tuple(dict.fromkeys(owners.get(n, n) for n in names))
    if "back_emf" in names:
        return _driver_off(model, names, conditions)
    if inertial(model, names):
        return _weighed(model, names, conditions, rng)
    for pair, answer in _ANSWERS.items():
        if set(pair) <= set(names):
            return Experiment("none", f"no torque tells {' from '.join(pair)}: {answer}.", names)
    apart = f"{names[0]} from {' and '.join(names[1:]) or 'the rest of the model'}"
    if after is not None:
        told = f"no torque within these limits tells {apart} ({after:.2g} units of evidence): widen them."
        return Experiment("none", told, names)
    return Experiment("none", f"no torque tells {apart}: another sensor is needed.", names)


# ---- the driver off --------------------------------------------------------------------------------------------------


def _driver_off(model: Model, names: tuple[str, ...], conditions: Conditions) -> Experiment:
    """A free swing without the motor: what brakes it then is friction, and the rest was back-EMF."""
    others = [n for n in names if n != "back_emf"] or ["viscous"]
    braking = sum(
        float(getattr(e, "b", getattr(e, "k", 0.0))) for e in model.effects if isinstance(e, Viscous | BackEmf)
    )
    bare = without(model, (*names, "viscous"))
    told = f"what brakes it then is {' or '.join(others)}, and what is missing beside a driven log is back_emf"
    if rest_angle(model) == 0.0:
        return Experiment("none", f"switch the driver off, push the joint and let it coast: {told}.", names)
    limits = conditions.limits
    release = limits.release or min(1.0, limits.theta_max or 1.0)
    free_swing = Signal("free swing", 0.0, 1.0, 1.0, 1.0, 1.0, release, 0)
    alone = [Hypothesis("", model, ())]
    swing, after = within_limits(alone, [free_swing], conditions) * limits.rollouts, None
    pool = Pool(alone, swing, conditions)
    if braking > 0.0:
        # a swing without torque shows b / J and G / J: the inertia is known from the log of the driven joint
        own = tuple(n for n in free(model) if n in model.names_of("") and n != model.plant.scale)
        truth = Hypothesis("viscous", bare.with_effect(Viscous(b=braking)), (*own, "viscous.b"))
        told_by = Pool([truth, Hypothesis("nothing", bare, own)], swing, conditions).unlike("viscous", "nothing")
        after = float(told_by.together().unexplained()[0])
    worth = "" if after is None else f", with {after:.3g} units of evidence if all of it is friction"
    return Experiment.played(
        model,
        pool.u,
        pool.states,
        kind="driver off",
        description=f"switch the driver off, {swing[0].sentence(model.plant)} for {limits.duration:g} s"
        f"{f', {limits.rollouts} times' if limits.rollouts > 1 else ''}: {told}{worth}.",
        separates=names,
        measure="evidence",
        before=0.0,
        after=after,
    )


# ---- a payload, a scale, a ruler -------------------------------------------------------------------------------------


def _weighed(model: Model, names: tuple[str, ...], conditions: Conditions, rng: np.random.Generator) -> Experiment:
    """The least labour that makes every parameter of the class show: a payload, the scale, both, a ruler too."""
    fitted = free(model)
    for kind in (TorqueGain, RotorInertia):
        if kind.name in names and kind.name not in {e.name for e in model.effects}:
            model = model.with_effect(kind())
    own = {e.name: model.names_of(e.name)[0] for e in model.effects if e.inertial}
    plant = tuple(n for n in model.plant.parameters if n in fitted or n in names)
    unknown = (*plant, *own.values())
    payload = conditions.limits.payload or _payload(model)
    if not model.plant.turns:
        payload = payload[0], 1.0  # a carriage carries it, wherever it sits
    shown = _shown(model, unknown, None), _shown(model, unknown, payload)
    for known in ((), ("m",), ("m", "l"), ("m", "l", "g")):
        left = [i for i, n in enumerate(unknown) if n not in known]
        if len(left) + len(known) > len(unknown) and not set(known) <= set(unknown):
            continue
        for loaded in (False, True):
            if (loaded or known) and _rank(shown[loaded][:, left]) == len(left):
                rest = tuple(unknown[i] for i in left)
                if not loaded:
                    others = " and ".join(rest) or "the rest"
                    told = f"{_measuring(known)}: then the motion shows {others}, which no torque alone tells apart."
                    return Experiment("none", told, unknown)
                return _with_payload(model, fitted, unknown, known, rest, payload, conditions, rng)
    told = f"no torque and no payload tells {' from '.join(unknown)}: measure one of them by itself."
    return Experiment("none", told, unknown)


def _measuring(known: tuple[str, ...]) -> str:
    orders = {"m": "weigh the moving part (m)", "l": "measure its length (l)", "g": "look up gravity (g)"}
    return " and ".join(orders[k] for k in known)


def _payload(model: Model) -> tuple[float, float]:
    """A weight that adds half the joint's inertia, at the pendulum's own length: (mass, distance), two digits each."""
    J, G = float(model.inertia()), float(model.plant.gravity_torque(0.5 * math.pi))
    length = float(getattr(model.plant, "l", J * GRAVITY / G if G > 0.0 else 1.0))
    distance = float(f"{length:.2g}")
    return float(f"{_HEAVIER * J / distance**2:.2g}"), distance


def _shown(model: Model, unknown: Sequence[str], payload: tuple[float, float] | None) -> Array:
    """Derivatives (shown, P) of what the motion shows, (J / c, G / c) without and with the payload."""
    parameters = model.parameters
    at = np.array([float(parameters[n].value) for n in unknown])
    size = np.array([abs(v) or 0.1 * float(model.inertia()) for v in at])

    def show(values: Array) -> Array:
        """What the motion shows where the unknown numbers have these values."""
        now = model.with_parameters(dict(zip(unknown, values.tolist(), strict=True)))
        numbers = now.parameters
        c = float(numbers["torque_gain.c"].value) if "torque_gain.c" in numbers else 1.0
        J, G = float(now.inertia()), float(now.plant.gravity_torque(0.5 * math.pi))
        seen = [J / c, G / c]
        if payload is not None:
            mass, distance = payload
            g = float(getattr(now.plant, "g", GRAVITY)) if G > 0.0 else 0.0
            seen += [(J + mass * distance**2) / c, (G + mass * g * distance) / c]
        return np.array(seen)

    rows = [(show(at + h) - show(at)) / 1e-5 for h in 1e-5 * np.diag(size)]
    return np.array(rows).T


def _rank(shown: Array) -> int:
    return int(
        np.linalg.matrix_rank(shown / np.maximum(np.max(np.abs(shown), axis=1, keepdims=True), 1e-300), tol=1e-4)
    )


def _with_payload(
    model: Model,
    fitted: tuple[str, ...],
    unknown: tuple[str, ...],
    known: tuple[str, ...],
    rest: tuple[str, ...],
    payload: tuple[float, float],
    conditions: Conditions,
    rng: np.random.Generator,
) -> Experiment:
    weighs = rest_angle(model) != 0.0
    loaded = model.with_effect(Payload(mass=payload[0], distance=payload[1], weighs=weighs))
    names = (*rest, *(n for n in fitted if n not in unknown))
    setups = [Hypothesis("plain", model, names), Hypothesis("loaded", loaded, names)]
    scale = yardsticks(model, names)
    pool = search(precision(scale), setups, conditions, rng)[0]
    sd = pool.precision().together().sd()[0][: len(rest)]
    k = int(np.argmax(sd / scale[: len(rest)]))
    after, unit = 1.96 * float(sd[k]), model.parameters[rest[k]].unit
    first = f"{_measuring(known)}, and " if known else ""
    orders = "; ".join(dict.fromkeys(s.sentence(model.plant) for s in pool.signals))
    place = f"hung on {payload[1]:g} m from the axis" if model.plant.turns else "on it"
    return Experiment.played(
        model,
        np.tile(pool.u, (2, 1)),
        np.concatenate(pool.states)[None],
        kind="payload",
        description=f"{first}{orders}, for {conditions.limits.duration:g} s, once as it is and once with "
        f"{payload[0]:g} kg {place}: that tells {', '.join(rest)} apart, {rest[k]} to +-{after:.2g} {unit}.",
        separates=unknown,
        measure="interval",
        before=None,
        after=after,
        widest=rest[k],
        payload=payload,
    )
