"""Physics: plants, the effects that can be added to them, integrators, and the model that is made of them."""

from sysid.physics import ops

__all__ = ["ops"]
