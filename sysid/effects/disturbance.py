"""Torques that come from outside, whatever the joint does."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.effects.effect import Joint, JointEffect
from sysid.ops import Value
from sysid.parameters import parameter


@dataclass(frozen=True, eq=False)
class TorqueBias(JointEffect):
    """tau = tau_0: a constant torque (a torque sensor's or amplifier's offset, a preloaded cable)."""

    tau_0: Value = parameter(0.0, unit="N m", bounds=(-10.0, 10.0), neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        """tau_0 [N m]."""
        return self.tau_0
