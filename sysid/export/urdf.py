"""URDF: a model as robots are described to ROS: a link's inertia, and the joint's damping and friction."""

from __future__ import annotations

import math
from xml.etree.ElementTree import Element, SubElement

from sysid.errors import check_kind
from sysid.export.exported import Exported, attribute_numbers, text_of, unsaid_effects
from sysid.export.mechanism import Mechanism, mechanism
from sysid.physics.effects.actuation import BackEmf, Saturation
from sysid.physics.effects.friction import Coulomb, Viscous
from sysid.physics.effects.load import RotorInertia, Tilt
from sysid.physics.model import Model

URDF_EFFECTS = {Viscous, BackEmf, Coulomb, RotorInertia, Tilt, Saturation}
"""The effects that URDF has words for."""


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
        For a model of many machines, and a name that is no text.
    """
    check_kind("joint", joint, str, "its name, such as 'hinge'")
    return Exported("URDF", text_of(_document(mechanism(model), joint)), unsaid_effects(model, URDF_EFFECTS, "URDF"))


def _document(machine: Mechanism, joint: str) -> Element:
    inertia = attribute_numbers(machine.body.inertia + machine.armature)
    limit = min(machine.force_limit, machine.gain * min(machine.limit, machine.scale * machine.u_max))
    root = Element("robot", name="gapfinder")
    SubElement(root, "link", name="base")
    inertial = SubElement(SubElement(root, "link", name="link"), "inertial")
    SubElement(inertial, "origin", xyz=attribute_numbers(0.0, 0.0, machine.body.center))
    SubElement(inertial, "mass", value=attribute_numbers(machine.body.mass))
    SubElement(inertial, "inertia", ixx=inertia, iyy=inertia, izz=inertia, ixy="0", ixz="0", iyz="0")
    made = SubElement(root, "joint", name=joint, type="continuous" if machine.turns else "prismatic")
    SubElement(made, "parent", link="base")
    SubElement(made, "child", link="link")
    SubElement(made, "origin", xyz="0 0 0", rpy=attribute_numbers(0.0, machine.tilt, 0.0))
    SubElement(made, "axis", xyz="0 1 0" if machine.turns else "1 0 0")
    SubElement(
        made, "dynamics", damping=attribute_numbers(machine.damping), friction=attribute_numbers(machine.friction)
    )
    ends = {} if machine.turns else {"lower": "-1e6", "upper": "1e6"}
    SubElement(made, "limit", ends, effort=attribute_numbers(limit if math.isfinite(limit) else 1e6), velocity="1e6")
    return root
