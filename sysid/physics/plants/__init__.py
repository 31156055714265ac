"""What swings or slides: plants that give an inertia and a gravity torque."""

from sysid.plants.axis import LinearAxis
from sysid.plants.joint import GeneralJoint
from sysid.plants.pendulum import PointMassPendulum, RodPendulum
from sysid.plants.plant import Plant

__all__ = ["GeneralJoint", "LinearAxis", "Plant", "PointMassPendulum", "RodPendulum"]
