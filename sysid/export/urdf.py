"""URDF: a model as robots are described to ROS: a link's inertia, and the joint's damping and friction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from sysid.export.exported import Exported, element, left_out, number, text_of
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
    link, inertia = own.body, number(own.body.inertia + own.armature)
    limit = min(own.force_limit, own.gain * min(own.limit, own.scale * own.u_max))
    about = {"ixx": inertia, "iyy": inertia, "izz": inertia, "ixy": "0", "ixz": "0", "iyz": "0"}
    inertial = element(
        "inertial",
        element("origin", xyz=number(0.0, 0.0, link.center)),
        element("mass", value=number(link.mass)),
        element("inertia", **about),
    )
    bounds = {"effort": number(limit if math.isfinite(limit) else 1e6), "velocity": "1e6"}
    if not own.turns:
        bounds |= {"lower": "-1e6", "upper": "1e6"}
    return element(
        "robot",
        element("link", name="base"),
        element("link", inertial, name="link"),
        element(
            "joint",
            element("parent", link="base"),
            element("child", link="link"),
            element("origin", xyz="0 0 0", rpy=number(0.0, own.tilt, 0.0)),
            element("axis", xyz="0 1 0" if own.turns else "1 0 0"),
            element("dynamics", damping=number(own.damping), friction=number(own.friction)),
            element("limit", **bounds),
            name=joint,
            type="continuous" if own.turns else "prismatic",
        ),
        name="gapfinder",
    )


def _unsaid(own: Mechanism) -> Iterator[str]:
    """What a mechanism has beyond URDF."""
    words = {
        "stiffness": "a spring",
        "bias": "a constant torque",
        "delay": "a delay of the torque",
        "lag": "a lag of the torque",
        "position_gain": "a servo",
        "speed_gain": "a torque that falls with speed",
    }
    for name, what in words.items():
        if getattr(own, name):
            yield f"{name} = {number(getattr(own, name))} is not in the file: URDF has no word for {what}."
    if own.gain * own.scale != 1.0:
        yield f"A command makes {number(own.gain * own.scale)} times its size in torque: URDF's effort is the torque."
    if own.armature:
        yield f"The rotor's inertia ({number(own.armature)}) is part of the link's: URDF has no word for it."
