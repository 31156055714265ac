"""URDF: a model as robots are described to ROS: a link's inertia, and the joint's damping and friction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element, SubElement

from sysid.export.exported import Exported, left_out, number, text_of
from sysid.export.mechanism import Mechanism, mechanism
from sysid.physics.model import Model


def to_urdf(model: Model, joint: str = "hinge") -> Exported:
    """A model as URDF, the robot description of ROS: inertia, damping, dry friction, a leaning base and the limit.

    The joint's position is theta, so that 0 is upright.

    Parameters
    ----------
    model : Model
        A model of one machine, as `Estimate.model` is.
    joint : str
        The joint's name.

    Returns
    -------
    Exported
        The text, and a sentence on each thing that it cannot say.

    Raises
    ------
    InvalidInput
        For a model of many machines.
    """
    own = mechanism(model)
    said = [*_unsaid(own), *(left_out(effect, "URDF") for effect in own.left_out)]
    return Exported("URDF", text_of(_document(own, joint)), tuple(said))


def _document(own: Mechanism, joint: str) -> Element:
    inertia = number(own.body.inertia + own.armature)
    limit = min(own.force_limit, own.gain * min(own.limit, own.scale * own.u_max))
    root = Element("robot", name="gapfinder")
    SubElement(root, "link", name="base")
    inertial = SubElement(SubElement(root, "link", name="link"), "inertial")
    SubElement(inertial, "origin", xyz=number(0.0, 0.0, own.body.center))
    SubElement(inertial, "mass", value=number(own.body.mass))
    SubElement(inertial, "inertia", ixx=inertia, iyy=inertia, izz=inertia, ixy="0", ixz="0", iyz="0")
    made = SubElement(root, "joint", name=joint, type="continuous" if own.turns else "prismatic")
    SubElement(made, "parent", link="base")
    SubElement(made, "child", link="link")
    SubElement(made, "origin", xyz="0 0 0", rpy=number(0.0, own.tilt, 0.0))
    SubElement(made, "axis", xyz="0 1 0" if own.turns else "1 0 0")
    SubElement(made, "dynamics", damping=number(own.damping), friction=number(own.friction))
    ends = {} if own.turns else {"lower": "-1e6", "upper": "1e6"}
    SubElement(made, "limit", ends, effort=number(limit if math.isfinite(limit) else 1e6), velocity="1e6")
    return root


WORDS = {
    "armature": "a rotor's inertia: it is part of the link's",
    "stiffness": "a spring",
    "bias": "a constant torque",
    "delay": "a delay of the torque",
    "lag": "a lag of the torque",
    "position_gain": "a servo",
    "speed_gain": "a torque of the drive that falls with speed",
}


def _unsaid(own: Mechanism) -> Iterator[str]:
    """What a mechanism has beyond URDF."""
    for name, what in WORDS.items():
        if getattr(own, name):
            yield f"{name} = {number(getattr(own, name))}: URDF has no word for {what}."
    if own.gain * own.scale != 1.0:
        yield f"URDF's effort is a torque, and a command of 1 makes {number(own.gain * own.scale)} of it."
