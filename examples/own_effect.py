"""A user's own effect, ranked like those of the catalogue.

    python examples/own_effect.py                                       plants a magnet in a simulated log, and finds it
    python -m sysid diagnose swing*.csv --effects examples/own_effect.py  looks for one in a log of yours

Ten lines make an effect: its parameters with unit, bounds, neutral value and, for a shape, the numbers to try; and its
torque, written with sysid.ops so that it can be simulated, fitted and trained on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

import sysid
from sysid.physics import ops
from sysid.planning.excitation import multisine


@sysid.register
@dataclass(frozen=True, eq=False)
class Magnet(sysid.JointEffect):
    """A magnet beside the path, which pulls towards its place with up to k [N m]."""

    formula = "tau = -k d exp((1 - d^2) / 2), d = (theta - place) / 0.3 rad"
    k: float = sysid.parameter(0.0, unit="N m", bounds=(-10.0, 10.0), neutral=0.0)
    place: float = sysid.parameter(0.0, unit="rad", bounds=(-7.0, 7.0), probe=tuple(np.arange(-3.0, 3.2, 0.4).tolist()))

    def torque(self, joint: sysid.Joint) -> ops.Value:
        """The pull [N m]."""
        d = ops.wrap(joint.theta - self.place) / 0.3
        return -self.k * d * ops.exp(0.5 * (1.0 - d * d))


def log(seed: int = 1) -> list[sysid.Record]:
    """Four simulated swings of a pendulum with a magnet beside its path."""
    rng = np.random.default_rng(seed)
    truth = sysid.Model(sysid.PointMassPendulum(m=1.0, l=0.5), (Magnet(k=0.3, place=2.1),), sysid.RK4(10), dt=0.02)
    u = np.stack([multisine(rng, 300, truth.dt, 3.0, 1.5) for _ in range(4)])
    return sysid.Sensor(0.003, 0.05).measure(sysid.simulate(truth, u, np.full(4, math.pi), np.zeros(4)), rng)


def main() -> None:
    """Diagnose the log without and with the user's effect."""
    records = log()
    model = sysid.Model(sysid.PointMassPendulum(m=1.2, l=0.6), dt=0.02)
    ours = [name for name in sysid.CATALOGUE if name != Magnet.name]
    print("without:", sysid.diagnose(model, records, effects=ours), sep="\n")
    print("with:", sysid.diagnose(model, records), sep="\n")


if __name__ == "__main__":
    main()
