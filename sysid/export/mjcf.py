"""MJCF: a model as MuJoCo simulates it, in a file of its own or put into a user's."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from os import PathLike
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from sysid.data.files import path_of
from sysid.errors import InvalidInput, check_kind, excerpt
from sysid.export.exported import Exported, attribute_numbers, parsed_xml, text_of, unsaid_effects
from sysid.export.mechanism import TERMS, Mechanism, mechanism
from sysid.physics.effects.actuation import Lag
from sysid.physics.effects.disturbance import TorqueBias
from sysid.physics.effects.load import Tilt
from sysid.physics.model import Model

SMOOTH_STEP = 1e-3
"""The longest step [s] of a file of our own without dry friction."""
FRICTION_STEP = 2.5e-4
"""The longest step [s] of one with dry friction."""
OPTION = {"integrator": "RK4", "iterations": "50", "tolerance": "1e-12"}
SHAPE = {"type": "capsule", "contype": "0", "conaffinity": "0"}
"""What is seen of a link; it touches nothing and weighs nothing."""
DEFAULT_STEP = 2e-3
"""MuJoCo's step [s], where a file names none."""


def to_mjcf(model: Model, joint: str = "hinge", into: str | PathLike[str] | None = None) -> Exported:
    """A model as MJCF, MuJoCo's language: damping, friction, inertia, springs, and the actuator with its delay.

    In a file of its own the joint's qpos is theta, so that 0 is upright, and ctrl is the model's command.

    Parameters
    ----------
    model : Model
        A model of one machine, as `Estimate.model` is.
    joint : str
        The joint's name, in a file of the user's the one that is changed.
    into : path, optional
        A user's MJCF file: what is returned is that file, in which only the attributes of the joint and of its actuator
        are others.

    Returns
    -------
    Exported
        The text, and a sentence on each thing that it cannot say.

    Raises
    ------
    InvalidInput
        For a model of many machines, a name that is no text, and a file that is not MJCF or has no such joint.
    """
    check_kind("joint", joint, str, "its name, such as 'hinge'")
    machine = mechanism(model)
    if into is None:
        step, said = _step(machine, model.dt), list[str]()
        if 0.0 < machine.lag <= step:
            said.append(
                f"The lag of {attribute_numbers(machine.lag)} s is not in the file: "
                f"a step takes {attribute_numbers(step)} s."
            )
        text = text_of(_document(machine, joint, step))
        said += unsaid_effects(model, TERMS, "MJCF")
    else:
        text, step, said = _changed(machine, joint, path_of(into))
        said += unsaid_effects(model, TERMS.keys() - {Tilt, TorqueBias, Lag}, "a joint of MJCF")
    if machine.friction:
        said.append(
            f"MuJoCo's dry friction is soft, and a joint at rest creeps: solreffriction is as stiff as steps of "
            f"{attribute_numbers(step)} s allow; set it to two steps where you take others, the smaller the better."
        )
    if machine.delay:
        said.append("The actuator's attribute delay needs a recent MuJoCo (4.0 has it): older ones refuse the file.")
    return Exported("MJCF", text, tuple(said))


def _step(machine: Mechanism, dt: float) -> float:
    return dt / math.ceil(dt / (FRICTION_STEP if machine.friction else SMOOTH_STEP) - 1e-9)


# ---- a file of our own -----------------------------------------------------------------------------------------------


def _document(machine: Mechanism, joint: str, step: float) -> Element:
    link, size = machine.body, max(2.0 * machine.body.center, 0.1)
    gravity = attribute_numbers(link.gravity * math.sin(machine.tilt), 0.0, -link.gravity * math.cos(machine.tilt))
    turning = {"type": "hinge", "axis": "0 1 0"} if machine.turns else {"type": "slide", "axis": "1 0 0"}
    inertia, ends = attribute_numbers(*[link.inertia] * 3), attribute_numbers(0.0, 0.0, 0.0, 0.0, 0.0, size)
    root = Element("mujoco", model="gapfinder")
    SubElement(root, "compiler", angle="radian")
    SubElement(root, "option", OPTION, timestep=attribute_numbers(step), gravity=gravity)
    arm = SubElement(SubElement(root, "worldbody"), "body", name="link")
    SubElement(arm, "joint", {"name": joint} | turning | _of_joint(machine, step, 1.0))
    SubElement(
        arm,
        "inertial",
        pos=attribute_numbers(0.0, 0.0, link.center),
        mass=attribute_numbers(link.mass),
        diaginertia=inertia,
    )
    SubElement(arm, "geom", SHAPE, fromto=ends, size=attribute_numbers(0.03 * size))
    SubElement(SubElement(root, "actuator"), "general", {"name": "drive", "joint": joint} | _of_general(machine, step))
    return root


def _of_joint(machine: Mechanism, step: float, per_radian: float) -> dict[str, str]:
    """The attributes of the joint; angles in units of which there are so many to a radian."""
    attributes = {"damping": attribute_numbers(machine.damping), "frictionloss": attribute_numbers(machine.friction)}
    if machine.armature:
        attributes["armature"] = attribute_numbers(machine.armature)
    if machine.friction:
        attributes |= {"solreffriction": attribute_numbers(2.0 * step, 1.0), "solimpfriction": "0.9999 0.9999 0.001"}
    if machine.stiffness:
        attributes |= {
            "stiffness": attribute_numbers(machine.stiffness),
            "springref": attribute_numbers(per_radian * machine.rest),
        }
    return attributes


def _of_general(machine: Mechanism, step: float) -> dict[str, str]:
    """The attributes of a general actuator whose control is the model's command."""
    attributes = {"gainprm": attribute_numbers(machine.gain * machine.scale)}
    if machine.bias or machine.position_gain or machine.speed_gain:
        bias = attribute_numbers(machine.bias, -machine.position_gain, -machine.speed_gain)
        attributes |= {"biastype": "affine", "biasprm": bias}
    force, control = machine.force_limit, machine.u_max
    if machine.lag or machine.speed_gain:  # what is limited is not the force
        control = min(control, machine.limit / machine.scale)
    else:
        force = min(force, machine.gain * machine.limit)
    if math.isfinite(control):
        attributes |= {"ctrllimited": "true", "ctrlrange": attribute_numbers(-control, control)}
    if math.isfinite(force):
        attributes |= {
            "forcelimited": "true",
            "forcerange": attribute_numbers(machine.bias - force, machine.bias + force),
        }
    if machine.lag > step:
        attributes |= {"dyntype": "filter", "dynprm": attribute_numbers(machine.lag)}
    return attributes | _of_delay(machine, step, 0.5)


def _of_delay(machine: Mechanism, step: float, early: float) -> dict[str, str]:
    """The delay, longer by as many steps as MuJoCo answers early: between samples it interpolates, and RK4 sees that.

    Where a step holds its first control, that makes up for it.
    """
    if not machine.delay:
        return {}
    return {
        "delay": attribute_numbers(machine.delay + early * step),
        "nsample": str(math.ceil(machine.delay / step) + 2),
        "interp": "linear",
    }


# ---- a user's file ---------------------------------------------------------------------------------------------------


def _changed(machine: Mechanism, joint: str, path: Path) -> tuple[str, float, list[str]]:
    """The user's file with the joint's and its actuator's numbers, its step [s], and what that leaves out."""
    before, root = parsed_xml(path)
    if root.tag != "mujoco":
        raise InvalidInput(f"{path.name} is a file of <{root.tag}>: expected MJCF, whose root is <mujoco>")
    named = {e.get("name", ""): e for e in root.iter("joint") if e.get("name") and e.get("joint") is None}
    if joint not in named:
        listed = ", ".join(name for name in named) or "none"
        raise InvalidInput(f"{path.name} has no joint {excerpt(joint)}: found {listed} (included files are not read)")
    try:
        step = float(next((e.get("timestep", "") for e in root.iter("option") if e.get("timestep")), DEFAULT_STEP))
    except ValueError:
        raise InvalidInput(f"{path.name}: the timestep of <option> is no number") from None
    degrees = all(e.get("angle", "degree") == "degree" for e in root.iter("compiler"))
    turns = named[joint].get("type", "hinge") == "hinge"
    if turns != machine.turns:
        raise InvalidInput(f"{path.name}: joint {joint!r} {'turns' if turns else 'slides'}, and the model does not")
    per_radian = math.degrees(1.0) if degrees and turns else 1.0
    for name, value in _of_joint(machine, step, per_radian).items():
        named[joint].set(name, value)
    inherited = any(e.get("gear") for group in root.iter("default") for e in group)  # which gear, MuJoCo knows alone
    drives = [e for group in root.iter("actuator") for e in group if e.get("joint") == joint]
    early = 0.5 * any(e.get("integrator") == "RK4" for e in root.iter("option"))
    said = [*_kept(machine), *_driven(machine, drives, step, early, inherited)]
    try:
        return f"{before}{tostring(root, encoding='unicode')}\n", step, said
    except RecursionError:
        raise InvalidInput(f"{path.name} has too many elements within each other") from None


def _kept(machine: Mechanism) -> Iterator[str]:
    link = machine.body
    yield (
        f"The body is as it was: the model's has {link.mass:.4g} kg, its center {link.center:.4g} from the axis, "
        f"and an inertia of {link.inertia:.4g} about that (SI units)."
    )
    if machine.stiffness:
        yield "springref is the angle at which the spring is slack, from upright: shift it where 0 is elsewhere."


def _driven(machine: Mechanism, drives: Sequence[Element], step: float, early: float, inherited: bool) -> Iterator[str]:
    """Change a user's actuator; yields what it cannot be made to do."""
    if len(drives) != 1:
        yield f"{len(drives) or 'No'} actuators of this joint: expected one; none was changed."
        return
    (drive,) = drives
    if inherited and drive.get("gear") is None:
        yield "The gear may come from a default: only the actuator's delay was changed; give it a gear of its own."
    elif _takes_command(machine, drive):
        _set_drive(machine, drive)
    else:
        yield f"The actuator <{drive.tag}> takes another command than the model's: only its delay was changed."
    for name, value in _of_delay(machine, step, early).items():
        drive.set(name, value)


def _takes_command(machine: Mechanism, drive: Element) -> bool:
    """Whether a user's actuator is told what the model is."""
    if machine.position_gain:
        return drive.tag == "position"
    plain = drive.get("gainprm", "1").split()[:1] == ["1"] and drive.get("biastype", "none") == "none"
    return not machine.speed_gain and (drive.tag == "motor" or (drive.tag == "general" and plain))


def _set_drive(machine: Mechanism, drive: Element) -> None:
    """Gains and limits, which MuJoCo counts before the gear."""
    try:
        gear = float(drive.get("gear", "1").split()[0])
        if not 0.0 < abs(gear) < math.inf:
            raise ValueError
    except (ValueError, IndexError):
        raise InvalidInput(
            f"the gear of actuator <{drive.tag}> is {excerpt(drive.get('gear'))}: expected a number"
        ) from None
    if drive.tag == "position":
        drive.set("kp", attribute_numbers(machine.gain / gear**2))
        drive.set("kv", attribute_numbers(machine.speed_gain / gear**2))
    elif machine.gain * machine.scale != 1.0:
        gear *= machine.gain * machine.scale
        drive.set("gear", attribute_numbers(gear))
    force = min(machine.force_limit, machine.gain * machine.limit) / abs(gear)
    if math.isfinite(force):
        drive.set("forcelimited", "true")
        drive.set("forcerange", attribute_numbers(-force, force))
