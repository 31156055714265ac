"""What can be hidden in the machine: every catalogue effect at three sizes, and effects that no catalogue has."""

from __future__ import annotations

from dataclasses import dataclass

SIZES = ("small", "medium", "large")

# Effect: its numbers (names as in truth.NEUTRAL, without the effect's own), and their values at the three sizes.
# Units stand in truth.py. Delays are given in rows, beyond 1: what is less is the log's convention, not the machine's;
# limits as a share of the largest command.
TABLE: dict[str, tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]] = {
    "viscous": (("b",), ((0.03,), (0.1,), (0.3,))),
    "coulomb": (("tau_c",), ((0.04,), (0.12,), (0.4,))),
    "stribeck": (("tau_c", "tau_s", "v_s"), ((0.03, 0.12, 0.5), (0.1, 0.3, 0.4), (0.2, 0.6, 0.6))),
    "drag": (("c",), ((0.01,), (0.03,), (0.1,))),
    "asymmetric_viscous": (("b_plus", "b_minus"), ((0.02, 0.06), (0.15, 0.05), (0.1, 0.4))),
    "asymmetric_coulomb": (("tau_plus", "tau_minus"), ((0.03, 0.08), (0.25, 0.1), (0.2, 0.5))),
    "load_friction": (("mu",), ((0.02,), (0.05,), (0.15,))),
    "torque_bias": (("tau_0",), ((0.03,), (-0.1,), (0.4,))),
    "tilt": (("alpha",), ((0.01,), (-0.03,), (0.1,))),
    "spring": (("k",), ((0.1,), (0.3,), (1.0,))),
    "ripple": (("a", "order", "phase"), ((0.05, 7.0, 0.7), (0.15, 4.0, 2.0), (0.4, 6.0, -1.0))),
    "delay": (("rows",), ((1.3,), (1.8,), (3.0,))),
    "lag": (("T",), ((0.012,), (0.03,), (0.08,))),
    "torque_gain": (("k",), ((0.95,), (0.85,), (1.3,))),
    "dead_zone": (("width",), ((0.05,), (0.15,), (0.4,))),
    "saturation": (("share",), ((0.85,), (0.65,), (0.4,))),
    "back_emf": (("k",), ((0.03,), (0.1,), (0.3,))),
    "backlash": (("width",), ((0.01,), (0.03,), (0.08,))),
    "rotor_inertia": (("J",), ((0.02,), (0.05,), (0.15,))),
    "angle_offset": (("theta_0",), ((0.01,), (-0.03,), (0.1,))),
    "velocity_bias": (("v_0",), ((0.02,), (-0.08,), (0.3,))),
    "velocity_gain": (("k",), ((0.985,), (1.05,), (0.85,))),
    "sensor_delay": (("rows",), ((1.3,), (1.8,), (3.0,))),
    "periodic": (("a", "f", "phase"), ((0.03, 1.7, 0.5), (0.1, 3.3, 2.0), (0.3, 0.9, -1.0))),
    "drift": (("rate",), ((0.008,), (-0.03,), (0.1,))),
}
CATALOGUE = tuple(TABLE)
ARM = {"coulomb.tau_c": 0.15, "viscous.b": 0.1, "delay.T": 0.03, "rotor_inertia.J": 0.05}
"""An arm with a gear: what a log shows of it, and the rotor, which mass and length absorb."""


@dataclass(frozen=True)
class Stranger:
    """An effect outside the catalogue: its numbers, the gust's peak [N m], and what an observer must say it depends on.

    Right is an answer that contains `needs` and nothing outside `allows`; or one that names `near` alone, an effect of
    the catalogue that is nearly this.
    """

    numbers: tuple[tuple[str, float], ...]
    needs: frozenset[str]
    allows: frozenset[str]
    gust: float = 0.0
    near: str = ""


def _stranger(needs: str, allows: str = "", gust: float = 0.0, near: str = "", **numbers: float) -> Stranger:
    named = tuple((k.replace("__", "."), v) for k, v in numbers.items())
    return Stranger(named, frozenset(needs.split()), frozenset((needs + " " + allows).split()), gust, near)


STRANGERS: dict[str, Stranger] = {
    "magnet": _stranger("theta", magnet__a=0.5, magnet__theta_m=2.9, magnet__width=0.15),
    "weak magnet": _stranger("theta", magnet__a=0.2, magnet__theta_m=3.4, magnet__width=0.2),
    "cable": _stranger("theta", cable__k=2.0, cable__theta_c=3.8),
    "gust": _stranger("time", gust=0.6),
    "weak gust": _stranger("time", gust=0.2),
    "eddy": _stranger("theta_dot", eddy__c=0.5, eddy__v_p=1.0),
    "patch": _stranger("theta", "theta_dot", patch__tau=0.4, patch__theta_p=3.3, patch__width=0.15),
    "lopsided": _stranger("torque", lopsided__gain=0.85),
    "slosh": _stranger("history", near="flexible_transmission", slosh__J=0.03, slosh__f=1.6, slosh__zeta=0.05),
    "harmonic drive 10 Hz": _stranger("history", "torque", near="flexible_transmission", flexible__f=10.0),
    "harmonic drive 14 Hz": _stranger("history", "torque", near="flexible_transmission", flexible__f=14.0),
    "harmonic drive 20 Hz": _stranger("history", "torque", near="flexible_transmission", flexible__f=20.0),
}
FLEXIBLE = tuple(
    name for name, stranger in STRANGERS.items() if stranger.numbers and stranger.numbers[0][0] == "flexible.f"
)


def numbers_of(effect: str, size: str, dt: float, peak: float) -> dict[str, float]:
    """The truth's numbers for an effect at a size; rows take dt [s], shares the peak torque [N m]."""
    keys, sizes = TABLE[effect]
    values = dict(zip(keys, sizes[SIZES.index(size)], strict=True))
    if "rows" in values:
        values = {"T": values["rows"] * dt}
    if "share" in values:
        values = {"limit": values["share"] * peak}
    return {f"{effect}.{k}": v for k, v in values.items()}
