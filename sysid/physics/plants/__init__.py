"""What swings or slides: plants that give an inertia and a gravity torque."""

from sysid.physics.plants.axis import LinearAxis
from sysid.physics.plants.joint import GeneralJoint
from sysid.physics.plants.pendulum import PointMassPendulum, RodPendulum
from sysid.physics.plants.plant import Plant
