"""Friction that is a spring before it slides."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sysid.physics import ops
from sysid.physics.effects.effect import DynamicEffect, Memory, Stretch
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter

LARGEST_GIVE = 0.3
"""Share of a motion's reach that a contact gives by, at most, before it slides."""


@dataclass(frozen=True, eq=False)
class Dahl(DynamicEffect):
    """Dry friction that builds up over a travel.

    Before a joint slides, the contact gives like a spring of tau_c / z_s [N m/rad], z_s [rad]; w is its deflection, 1
    where it slides forwards. For z_s -> 0 it is Coulomb friction. (Dahl: Aerospace Corporation TOR-0158(3107-18)-1,
    1968.)
    """

    words = "dry friction that gives like a spring before it slides"
    rarity = 2.5
    begins: ClassVar[Mapping[str, float]] = {"tau_c": 0.05}
    refines: ClassVar[tuple[tuple[str, ...], ...]] = (("coulomb",),)
    formula = "tau = -tau_c w, dw/dt = (theta_dot - |theta_dot| w) / z_s"
    confused = ("coulomb", "stribeck", "lugre")
    start_sd = (0.5,)
    tau_c: Value = parameter(0.0, unit="N m", bounds=(0.0, math.inf), neutral=0.0)
    z_s: Value = parameter(0.01, unit="rad", bounds=(1e-5, 1.0), probe=(0.003, 0.02, 0.1))

    def resolved(self, sd: float, reach: float) -> bool:
        """Whether it gives by more than the sd, else it is Coulomb friction to these readings; and by less than a large
        part of the motion, else it hardly slides."""
        return sd < float(self.z_s) < LARGEST_GIVE * reach

    def sliding(self, theta_dot: Value) -> tuple[Value, Value]:
        """The largest friction [N m], and the share of it that is left at a speed theta_dot [rad/s]."""
        return self.tau_c, 1.0

    def follow(self, states: Memory, stretch: Stretch) -> tuple[Value, Value, Memory]:
        """The exact solution at the mean speed of the stretch."""
        (w,) = states
        largest, share = self.sliding(stretch.travel / stretch.h)
        end = ops.where(stretch.travel > 0.0, share, -share)
        r = ops.maximum(ops.abs(stretch.travel) / (share * self.z_s), 1e-6)
        left = ops.exp(-r)
        mean = (1.0 - left) / r
        torque = -largest * (end + (w - end) * mean)
        slope = largest * (w - end) * (mean - left) / (r * end * self.z_s)
        return torque, 0.5 * stretch.h * slope, (end + (w - end) * left,)


@dataclass(frozen=True, eq=False)
class LuGre(Dahl):
    """Dahl's friction with Stribeck's curve s.

    A joint that slides feels ratio tau_c s: ratio tau_c [N m] at slow speed, tau_c at a few v_s [rad/s]. The bristle's
    own damping is left out; viscous friction is an effect of its own. (Canudas de Wit, Olsson, Astrom, Lischinsky: IEEE
    Transactions on Automatic Control 40 (1995) 419.)
    """

    name = "lugre"
    words = "dry friction that gives like a spring and is larger at slow speed"
    rarity = 3.5
    refines = (("coulomb",), ("dahl",), ("stribeck",))
    formula = (
        "tau = -ratio tau_c w, dw/dt = (theta_dot - |theta_dot| w / s) / z_s, "
        "s = (1 + (ratio - 1) exp(-(theta_dot/v_s)^2)) / ratio"
    )
    confused = ("coulomb", "stribeck", "dahl")
    ratio: Value = parameter(1.5, unit="1", bounds=(1.0, 20.0), probe=(1.5,))
    v_s: Value = parameter(0.15, unit="rad/s", bounds=(0.005, 10.0), probe=(0.05, 0.3))

    def sliding(self, theta_dot: Value) -> tuple[Value, Value]:
        """ratio tau_c, and the share that Stribeck's curve leaves of it."""
        speed = theta_dot / self.v_s
        return self.ratio * self.tau_c, (1.0 + (self.ratio - 1.0) * ops.exp(-speed * speed)) / self.ratio


EFFECTS = (Dahl, LuGre)
