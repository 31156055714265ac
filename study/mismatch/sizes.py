"""The sizes of effects that are hidden from policies, fixed before any policy was trained, with what they cost.

Chosen by `effect_cost.choose` from study/results/effect_cost/effect_cost.csv. This module loads nothing heavy.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Size:
    """An effect at a size, and what not to know it costs by dynamic programming.

    numbers   the effect's parameters (name, value): effect(name, **dict(numbers))
    loss      J_aware - J_ignorant; percent of |J_aware|; sharp: loss of the ignorant that plans to the edge
    """

    size: float
    unit: str
    numbers: tuple[tuple[str, float], ...]
    loss: float
    percent: float
    sharp: float


@dataclass(frozen=True)
class Sizes:
    """small: below 2 %; medium: about 10 %; large: about 30 %, None where no plausible size costs so much; largest: the
    end of what is plausible."""

    small: Size
    medium: Size | None
    large: Size | None
    largest: Size


SIZES: dict[str, Sizes] = {
    "viscous": Sizes(
        small=Size(size=0.225, unit="N m s/rad", numbers=(("b", 0.225),), loss=2.47, percent=0.44, sharp=108.97),
        medium=None,
        large=None,
        largest=Size(size=0.3, unit="N m s/rad", numbers=(("b", 0.3),), loss=19.75, percent=3.0, sharp=153.54),
    ),
    "coulomb": Sizes(
        small=Size(size=0.938, unit="N m", numbers=(("tau_c", 0.938),), loss=2.5, percent=0.4, sharp=78.57),
        medium=None,
        large=None,
        largest=Size(size=1.5, unit="N m", numbers=(("tau_c", 1.5),), loss=32.42, percent=3.86, sharp=115.37),
    ),
    "stribeck": Sizes(
        small=Size(
            size=1.5,
            unit="N m",
            numbers=(("tau_c", 0.5), ("excess", 1.0), ("v_s", 0.5)),
            loss=4.17,
            percent=0.83,
            sharp=48.69,
        ),
        medium=None,
        large=None,
        largest=Size(
            size=1.5,
            unit="N m",
            numbers=(("tau_c", 0.5), ("excess", 1.0), ("v_s", 0.5)),
            loss=4.17,
            percent=0.83,
            sharp=48.69,
        ),
    ),
    "drag": Sizes(
        small=Size(size=0.0525, unit="N m s^2/rad^2", numbers=(("c", 0.0525),), loss=4.77, percent=0.86, sharp=180.06),
        medium=None,
        large=None,
        largest=Size(size=0.06, unit="N m s^2/rad^2", numbers=(("c", 0.06),), loss=24.27, percent=4.07, sharp=188.04),
    ),
    "asymmetric_viscous": Sizes(
        small=Size(size=0.3, unit="N m s/rad", numbers=(("b_plus", 0.3),), loss=8.11, percent=1.64, sharp=24.97),
        medium=None,
        large=None,
        largest=Size(size=0.3, unit="N m s/rad", numbers=(("b_plus", 0.3),), loss=8.11, percent=1.64, sharp=24.97),
    ),
    "asymmetric_coulomb": Sizes(
        small=Size(size=1.31, unit="N m", numbers=(("tau_plus", 1.31),), loss=4.39, percent=0.81, sharp=33.51),
        medium=None,
        large=None,
        largest=Size(size=1.5, unit="N m", numbers=(("tau_plus", 1.5),), loss=11.33, percent=2.01, sharp=41.34),
    ),
    "load_friction": Sizes(
        small=Size(size=0.1, unit="1", numbers=(("mu", 0.1),), loss=9.79, percent=1.59, sharp=110.23),
        medium=None,
        large=None,
        largest=Size(size=0.1, unit="1", numbers=(("mu", 0.1),), loss=9.79, percent=1.59, sharp=110.23),
    ),
    "tilt": Sizes(
        small=Size(size=0.05, unit="rad", numbers=(("alpha", 0.05),), loss=-0.11, percent=-0.03, sharp=-1.62),
        medium=Size(size=0.0599, unit="rad", numbers=(("alpha", 0.0599),), loss=40.54, percent=10.41, sharp=-2.28),
        large=Size(size=0.075, unit="rad", numbers=(("alpha", 0.075),), loss=107.46, percent=27.6, sharp=2.98),
        largest=Size(size=0.1, unit="rad", numbers=(("alpha", 0.1),), loss=216.88, percent=55.48, sharp=297.25),
    ),
    "spring": Sizes(
        small=Size(size=0.05, unit="N m/rad", numbers=(("k", 0.05),), loss=-0.04, percent=-0.01, sharp=-1.62),
        medium=Size(size=0.282, unit="N m/rad", numbers=(("k", 0.282),), loss=44.36, percent=10.41, sharp=74.34),
        large=Size(size=0.321, unit="N m/rad", numbers=(("k", 0.321),), loss=128.68, percent=29.94, sharp=67.89),
        largest=Size(size=0.4, unit="N m/rad", numbers=(("k", 0.4),), loss=204.77, percent=47.42, sharp=87.41),
    ),
    "ripple": Sizes(
        small=Size(size=1.5, unit="N m", numbers=(("a", 1.5), ("order", 6.0)), loss=0.76, percent=0.19, sharp=-1.99),
        medium=None,
        large=None,
        largest=Size(size=1.5, unit="N m", numbers=(("a", 1.5), ("order", 6.0)), loss=0.76, percent=0.19, sharp=-1.99),
    ),
    "rotor_inertia": Sizes(
        small=Size(size=0.188, unit="kg m^2", numbers=(("J_r", 0.188),), loss=-0.96, percent=-0.24, sharp=169.02),
        medium=Size(size=0.225, unit="kg m^2", numbers=(("J_r", 0.225),), loss=36.34, percent=8.93, sharp=256.31),
        large=Size(size=0.262, unit="kg m^2", numbers=(("J_r", 0.262),), loss=127.02, percent=31.05, sharp=313.87),
        largest=Size(size=0.75, unit="kg m^2", numbers=(("J_r", 0.75),), loss=377.02, percent=85.58, sharp=433.93),
    ),
    "torque_bias": Sizes(
        small=Size(size=0.75, unit="N m", numbers=(("tau_0", 0.75),), loss=0.28, percent=0.07, sharp=195.91),
        medium=Size(size=0.887, unit="N m", numbers=(("tau_0", 0.887),), loss=42.34, percent=10.87, sharp=228.69),
        large=Size(size=1.22, unit="N m", numbers=(("tau_0", 1.22),), loss=113.02, percent=29.12, sharp=375.47),
        largest=Size(size=1.5, unit="N m", numbers=(("tau_0", 1.5),), loss=342.77, percent=89.06, sharp=553.79),
    ),
    "periodic": Sizes(
        small=Size(size=1.5, unit="N m", numbers=(("a", 1.5), ("f", 1.0)), loss=2.26, percent=0.58, sharp=2.54),
        medium=None,
        large=None,
        largest=Size(size=1.5, unit="N m", numbers=(("a", 1.5), ("f", 1.0)), loss=2.26, percent=0.58, sharp=2.54),
    ),
    "drift": Sizes(
        small=Size(size=0.112, unit="N m/s", numbers=(("r", 0.112),), loss=0.7, percent=0.18, sharp=47.86),
        medium=Size(size=0.126, unit="N m/s", numbers=(("r", 0.126),), loss=40.75, percent=10.45, sharp=61.13),
        large=Size(size=0.15, unit="N m/s", numbers=(("r", 0.15),), loss=92.83, percent=23.64, sharp=73.32),
        largest=Size(size=0.15, unit="N m/s", numbers=(("r", 0.15),), loss=92.83, percent=23.64, sharp=73.32),
    ),
    "delay": Sizes(
        small=Size(size=0.075, unit="s", numbers=(("T", 0.075),), loss=5.07, percent=1.28, sharp=132.53),
        medium=Size(size=0.126, unit="s", numbers=(("T", 0.126),), loss=39.37, percent=9.88, sharp=248.17),
        large=Size(size=0.155, unit="s", numbers=(("T", 0.155),), loss=120.64, percent=30.04, sharp=360.21),
        largest=Size(size=0.3, unit="s", numbers=(("T", 0.3),), loss=454.31, percent=109.03, sharp=534.0),
    ),
    "lag": Sizes(
        small=Size(size=0.075, unit="s", numbers=(("T", 0.075),), loss=3.22, percent=0.8, sharp=115.2),
        medium=Size(size=0.169, unit="s", numbers=(("T", 0.169),), loss=39.3, percent=9.14, sharp=269.17),
        large=Size(size=0.263, unit="s", numbers=(("T", 0.263),), loss=142.7, percent=30.2, sharp=373.07),
        largest=Size(size=0.3, unit="s", numbers=(("T", 0.3),), loss=183.52, percent=37.69, sharp=399.62),
    ),
    "torque_gain": Sizes(
        small=Size(size=0.438, unit="1", numbers=(("c", 0.562),), loss=9.08, percent=1.48, sharp=129.57),
        medium=Size(size=0.474, unit="1", numbers=(("c", 0.526),), loss=68.57, percent=10.78, sharp=132.07),
        large=None,
        largest=Size(size=0.5, unit="1", numbers=(("c", 0.5),), loss=82.31, percent=12.57, sharp=126.74),
    ),
    "dead_zone": Sizes(
        small=Size(size=0.75, unit="N m", numbers=(("d", 0.75),), loss=0.38, percent=0.07, sharp=118.39),
        medium=Size(size=0.938, unit="N m", numbers=(("d", 0.938),), loss=65.54, percent=10.37, sharp=136.82),
        large=None,
        largest=Size(size=1.5, unit="N m", numbers=(("d", 1.5),), loss=79.62, percent=9.36, sharp=174.7),
    ),
    "saturation": Sizes(
        small=Size(size=1.12, unit="N m", numbers=(("limit", 0.88),), loss=10.43, percent=1.51, sharp=116.62),
        medium=Size(size=1.29, unit="N m", numbers=(("limit", 0.71),), loss=82.97, percent=10.94, sharp=120.41),
        large=None,
        largest=Size(size=1.5, unit="N m", numbers=(("limit", 0.5),), loss=78.44, percent=9.23, sharp=116.96),
    ),
    "angle_offset": Sizes(
        small=Size(size=0.05, unit="rad", numbers=(("offset", 0.05),), loss=1.15, percent=0.29, sharp=0.78),
        medium=Size(size=0.0604, unit="rad", numbers=(("offset", 0.0604),), loss=38.1, percent=9.73, sharp=2.46),
        large=Size(size=0.0778, unit="rad", numbers=(("offset", 0.0778),), loss=117.51, percent=30.0, sharp=7.88),
        largest=Size(size=0.2, unit="rad", numbers=(("offset", 0.2),), loss=394.19, percent=100.63, sharp=464.69),
    ),
    "velocity_bias": Sizes(
        small=Size(size=0.125, unit="rad/s", numbers=(("bias", 0.125),), loss=2.15, percent=0.55, sharp=0.81),
        medium=Size(size=0.197, unit="rad/s", numbers=(("bias", 0.197),), loss=44.63, percent=11.39, sharp=73.13),
        large=Size(size=0.263, unit="rad/s", numbers=(("bias", 0.263),), loss=108.23, percent=27.63, sharp=116.89),
        largest=Size(size=1.0, unit="rad/s", numbers=(("bias", 1.0),), loss=611.51, percent=156.12, sharp=529.96),
    ),
    "velocity_gain": Sizes(
        small=Size(size=0.0308, unit="1", numbers=(("c", 0.9692),), loss=-0.28, percent=-0.07, sharp=86.57),
        medium=Size(size=0.0657, unit="1", numbers=(("c", 0.9343),), loss=43.06, percent=10.99, sharp=251.82),
        large=Size(size=0.0735, unit="1", numbers=(("c", 0.9265),), loss=123.51, percent=31.53, sharp=352.67),
        largest=Size(size=0.5, unit="1", numbers=(("c", 0.5),), loss=864.74, percent=220.76, sharp=796.97),
    ),
    "sensor_delay": Sizes(
        small=Size(size=0.075, unit="s", numbers=(("T", 0.075),), loss=6.89, percent=1.76, sharp=127.52),
        medium=Size(size=0.125, unit="s", numbers=(("T", 0.125),), loss=36.05, percent=9.2, sharp=246.34),
        large=Size(size=0.157, unit="s", numbers=(("T", 0.157),), loss=123.4, percent=31.5, sharp=358.34),
        largest=Size(size=0.2, unit="s", numbers=(("T", 0.2),), loss=248.75, percent=63.51, sharp=463.3),
    ),
    "backlash": Sizes(
        small=Size(size=0.1, unit="rad", numbers=(("width", 0.1),), loss=4.81, percent=1.23, sharp=97.95),
        medium=Size(size=0.118, unit="rad", numbers=(("width", 0.118),), loss=41.39, percent=10.57, sharp=102.86),
        large=Size(size=0.178, unit="rad", numbers=(("width", 0.178),), loss=117.82, percent=30.08, sharp=242.51),
        largest=Size(size=0.2, unit="rad", numbers=(("width", 0.2),), loss=204.06, percent=52.1, sharp=303.65),
    ),
}
