"""Experiments other than torques (a payload, a scale, the driver off), for what no torque ever tells apart."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.estimation.fit import free
from sysid.physics.effects.actuation import TorqueGain
from sysid.physics.effects.load import RotorInertia
from sysid.physics.model import Model
from sysid.physics.plants import GRAVITY
from sysid.planning.discrimination import inertial
from sysid.planning.excitation import rest_angle
from sysid.planning.planned_experiment import Experiment

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


def never(names: Sequence[str]) -> bool:
    """Whether it is known that no torque tells these effects apart, whatever their sizes."""
    return tuple(sorted(names)) in _ANSWERS


def non_torque_experiment(model: Model, names: Sequence[str], after: float | None = None) -> Experiment:
    """An experiment for effects ("torque_gain") or parameters ("m", "rotor_inertia.J_r") that no torque tells apart.

    Back-EMF shows against friction with the driver off; what shows as an inertia or a gravity torque, with a payload or
    a scale. `after` is the evidence that the best torque would bring, if known.
    """
    owners = {name: p.owner or name for name, p in model.parameters.items()}
    names = tuple(dict.fromkeys(owners.get(n, n) for n in names))
    if "back_emf" in names:
        others = " or ".join(n for n in names if n != "back_emf") or "viscous"
        let_go = "push the joint and let it coast" if rest_angle(model) == 0.0 else "let it go and swing freely"
        sentence = f"what brakes it then is {others}, and what is missing beside a driven log is back_emf"
        return Experiment("none", f"switch the driver off, {let_go}: {sentence}.", names)
    if inertial(model, names):
        return _weighed(model, names)
    for pair, answer in _ANSWERS.items():
        if set(pair) <= set(names):
            return Experiment("none", f"no torque tells {' from '.join(pair)}: {answer}.", names)
    apart = f"{names[0]} from {' and '.join(names[1:]) or 'the rest of the model'}"
    if after is not None:
        sentence = f"no torque within these limits tells {apart} ({after:.2g} units of evidence): widen them."
        return Experiment("none", sentence, names)
    return Experiment("none", f"no torque tells {apart}: another sensor is needed.", names)


def _weighed(model: Model, names: tuple[str, ...]) -> Experiment:
    """The labour by which every parameter of the class shows.

    A payload of known inertia and weight shows the torque gain and gravity; then the motion shows J and G. What else is
    a part of J shows once the moving part was weighed.
    """
    fitted = free(model)
    for kind in (TorqueGain, RotorInertia):
        if kind.name in names and kind.name not in model.effect_names:
            model = model.with_effect(kind())
    added = [e.name for e in model.effects if e.inertial]
    plant = [n for n in model.plant.parameters if n in fitted or n in names]
    unknown = (*plant, *(model.names_of(name)[0] for name in added))
    parts, labour = any(name != TorqueGain.name for name in added), list[str]()
    if parts and "m" not in plant:
        sentence = f"no torque and no payload tells {' from '.join(unknown)}: measure one of them by itself."
        return Experiment("none", sentence, unknown)
    if parts:
        labour.append("weigh the moving part (m)")
    if TorqueGain.name in added or "g" in plant or not parts:
        mass, distance = payload(model)
        hung = f"hang {mass:g} kg on it, {distance:g} m from the axis"
        place = hung if model.plant.turns else f"load it with {mass:g} kg"
        labour.append(f"{place}, and play the same with it and without")
    others = " and ".join(n for n in unknown if not (parts and n == "m")) or "the rest"
    sentence = f"{' and '.join(labour)}: then the motion shows {others}, which no torque alone tells apart."
    return Experiment("none", sentence, unknown)


def payload(model: Model) -> tuple[float, float]:
    """A weight that adds half the joint's inertia, at the pendulum's own length: (mass, distance), two digits each."""
    J, G = float(model.inertia()), float(model.plant.largest_gravity_torque)
    length = float(getattr(model.plant, "l", J * GRAVITY / G if G > 0.0 else 1.0))
    distance = float(f"{length:.2g}") if model.plant.turns else 1.0  # a carriage carries it, wherever it sits
    return float(f"{_HEAVIER * J / distance**2:.2g}"), distance
