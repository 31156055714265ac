"""Sample logs: simulated machines with something hidden in them, for those who have no log at hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data.record import Record
from sysid.data.sensor import Sensor
from sysid.physics import ops
from sysid.physics.effects import Effect, Joint, JointEffect
from sysid.physics.effects.actuation import Delay
from sysid.physics.effects.friction import Coulomb
from sysid.physics.integrators import RK4
from sysid.physics.model import Model
from sysid.physics.ops import Value
from sysid.physics.plants import RodPendulum
from sysid.physics.simulate import simulate
from sysid.planning.excitation import steps

DT = 0.02
"""The control interval [s]."""
ROLLOUTS = 8
"""Rollouts of a log."""
SAMPLES = 400
"""Intervals of a rollout."""


@dataclass(frozen=True, eq=False)
class SampleMagnet(JointEffect):
    """A magnet beside the swing, which holds the arm where it hangs a little to the right; in no catalogue."""

    def torque(self, joint: Joint) -> Value:
        x = (joint.theta - math.pi - 0.5) / 0.25
        return -0.8 * x * ops.exp(-x * x)


@dataclass(frozen=True)
class Sample:
    """A log that can be made: its title, what stands on its button, and what the machine hides."""

    title: str
    about: str
    hidden: tuple[Effect, ...]


SAMPLES_BY_NAME = {
    "friction": Sample("a sticky joint", "A rod whose joint sticks.", (Coulomb(0.15),)),
    "two": Sample(
        "two at once", "Two effects at once, one of which hides the other.", (Coulomb(0.15), Delay(2.5 * DT))
    ),
    "unknown": Sample("an unknown torque", "Something that no catalogue holds: write it yourself.", (SampleMagnet(),)),
}


def sample(name: str, seed: int = 1) -> Sequence[Record]:
    """Eight rollouts of 8 s at 50 Hz: angle with 0.003 rad and speed with 0.05 rad/s of noise."""
    rng = np.random.default_rng(seed)
    truth = Model(RodPendulum(m=1.04, l=0.97, g=9.81), SAMPLES_BY_NAME[name].hidden, RK4(substeps=20), dt=DT)
    u = np.stack([steps(rng, SAMPLES, DT, 2.0, 0.4) for _ in range(ROLLOUTS)])
    theta = math.pi + rng.uniform(-0.8, 0.8, ROLLOUTS)
    return Sensor(0.003, 0.05).measure(simulate(truth, u, theta, np.zeros(ROLLOUTS)), rng)
