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


# fmt: off
SIZES: dict[str, Sizes] = {
    "viscous": Sizes(
        Size(0.225, "N m s/rad", (("b", 0.225),), 2.47, 0.44, 108.97),
        None,
        None,
        Size(0.3, "N m s/rad", (("b", 0.3),), 19.75, 3.0, 153.54),
    ),
    "coulomb": Sizes(
        Size(0.938, "N m", (("tau_c", 0.938),), 2.5, 0.4, 78.57),
        None,
        None,
        Size(1.5, "N m", (("tau_c", 1.5),), 32.42, 3.86, 115.37),
    ),
    "stribeck": Sizes(
        Size(1.5, "N m", (("tau_c", 0.5), ("excess", 1.0), ("v_s", 0.5)), 4.17, 0.83, 48.69),
        None,
        None,
        Size(1.5, "N m", (("tau_c", 0.5), ("excess", 1.0), ("v_s", 0.5)), 4.17, 0.83, 48.69),
    ),
    "drag": Sizes(
        Size(0.0525, "N m s^2/rad^2", (("c", 0.0525),), 4.77, 0.86, 180.06),
        None,
        None,
        Size(0.06, "N m s^2/rad^2", (("c", 0.06),), 24.27, 4.07, 188.04),
    ),
    "asymmetric_viscous": Sizes(
        Size(0.3, "N m s/rad", (("b_plus", 0.3),), 8.11, 1.64, 24.97),
        None,
        None,
        Size(0.3, "N m s/rad", (("b_plus", 0.3),), 8.11, 1.64, 24.97),
    ),
    "asymmetric_coulomb": Sizes(
        Size(1.31, "N m", (("tau_plus", 1.31),), 4.39, 0.81, 33.51),
        None,
        None,
        Size(1.5, "N m", (("tau_plus", 1.5),), 11.33, 2.01, 41.34),
    ),
    "load_friction": Sizes(
        Size(0.1, "1", (("mu", 0.1),), 9.79, 1.59, 110.23),
        None,
        None,
        Size(0.1, "1", (("mu", 0.1),), 9.79, 1.59, 110.23),
    ),
    "tilt": Sizes(
        Size(0.05, "rad", (("alpha", 0.05),), -0.11, -0.03, -1.62),
        Size(0.0599, "rad", (("alpha", 0.0599),), 40.54, 10.41, -2.28),
        Size(0.075, "rad", (("alpha", 0.075),), 107.46, 27.6, 2.98),
        Size(0.1, "rad", (("alpha", 0.1),), 216.88, 55.48, 297.25),
    ),
    "spring": Sizes(
        Size(0.05, "N m/rad", (("k", 0.05),), -0.04, -0.01, -1.62),
        Size(0.282, "N m/rad", (("k", 0.282),), 44.36, 10.41, 74.34),
        Size(0.321, "N m/rad", (("k", 0.321),), 128.68, 29.94, 67.89),
        Size(0.4, "N m/rad", (("k", 0.4),), 204.77, 47.42, 87.41),
    ),
    "ripple": Sizes(
        Size(1.5, "N m", (("a", 1.5), ("order", 6.0)), 0.76, 0.19, -1.99),
        None,
        None,
        Size(1.5, "N m", (("a", 1.5), ("order", 6.0)), 0.76, 0.19, -1.99),
    ),
    "rotor_inertia": Sizes(
        Size(0.188, "kg m^2", (("J_r", 0.188),), -0.96, -0.24, 169.02),
        Size(0.225, "kg m^2", (("J_r", 0.225),), 36.34, 8.93, 256.31),
        Size(0.262, "kg m^2", (("J_r", 0.262),), 127.02, 31.05, 313.87),
        Size(0.75, "kg m^2", (("J_r", 0.75),), 377.02, 85.58, 433.93),
    ),
    "torque_bias": Sizes(
        Size(0.75, "N m", (("tau_0", 0.75),), 0.28, 0.07, 195.91),
        Size(0.887, "N m", (("tau_0", 0.887),), 42.34, 10.87, 228.69),
        Size(1.22, "N m", (("tau_0", 1.22),), 113.02, 29.12, 375.47),
        Size(1.5, "N m", (("tau_0", 1.5),), 342.77, 89.06, 553.79),
    ),
    "periodic": Sizes(
        Size(1.5, "N m", (("a", 1.5), ("f", 1.0)), 2.26, 0.58, 2.54),
        None,
        None,
        Size(1.5, "N m", (("a", 1.5), ("f", 1.0)), 2.26, 0.58, 2.54),
    ),
    "drift": Sizes(
        Size(0.112, "N m/s", (("r", 0.112),), 0.7, 0.18, 47.86),
        Size(0.126, "N m/s", (("r", 0.126),), 40.75, 10.45, 61.13),
        Size(0.15, "N m/s", (("r", 0.15),), 92.83, 23.64, 73.32),
        Size(0.15, "N m/s", (("r", 0.15),), 92.83, 23.64, 73.32),
    ),
    "delay": Sizes(
        Size(0.075, "s", (("T", 0.075),), 5.07, 1.28, 132.53),
        Size(0.126, "s", (("T", 0.126),), 39.37, 9.88, 248.17),
        Size(0.155, "s", (("T", 0.155),), 120.64, 30.04, 360.21),
        Size(0.3, "s", (("T", 0.3),), 454.31, 109.03, 534.0),
    ),
    "lag": Sizes(
        Size(0.075, "s", (("T", 0.075),), 3.22, 0.8, 115.2),
        Size(0.169, "s", (("T", 0.169),), 39.3, 9.14, 269.17),
        Size(0.263, "s", (("T", 0.263),), 142.7, 30.2, 373.07),
        Size(0.3, "s", (("T", 0.3),), 183.52, 37.69, 399.62),
    ),
    "torque_gain": Sizes(
        Size(0.438, "1", (("c", 0.562),), 9.08, 1.48, 129.57),
        Size(0.474, "1", (("c", 0.526),), 68.57, 10.78, 132.07),
        None,
        Size(0.5, "1", (("c", 0.5),), 82.31, 12.57, 126.74),
    ),
    "dead_zone": Sizes(
        Size(0.75, "N m", (("d", 0.75),), 0.38, 0.07, 118.39),
        Size(0.938, "N m", (("d", 0.938),), 65.54, 10.37, 136.82),
        None,
        Size(1.5, "N m", (("d", 1.5),), 79.62, 9.36, 174.7),
    ),
    "saturation": Sizes(
        Size(1.12, "N m", (("limit", 0.88),), 10.43, 1.51, 116.62),
        Size(1.29, "N m", (("limit", 0.71),), 82.97, 10.94, 120.41),
        None,
        Size(1.5, "N m", (("limit", 0.5),), 78.44, 9.23, 116.96),
    ),
    "angle_offset": Sizes(
        Size(0.05, "rad", (("offset", 0.05),), 1.15, 0.29, 0.78),
        Size(0.0604, "rad", (("offset", 0.0604),), 38.1, 9.73, 2.46),
        Size(0.0778, "rad", (("offset", 0.0778),), 117.51, 30.0, 7.88),
        Size(0.2, "rad", (("offset", 0.2),), 394.19, 100.63, 464.69),
    ),
    "velocity_bias": Sizes(
        Size(0.125, "rad/s", (("bias", 0.125),), 2.15, 0.55, 0.81),
        Size(0.197, "rad/s", (("bias", 0.197),), 44.63, 11.39, 73.13),
        Size(0.263, "rad/s", (("bias", 0.263),), 108.23, 27.63, 116.89),
        Size(1.0, "rad/s", (("bias", 1.0),), 611.51, 156.12, 529.96),
    ),
    "velocity_gain": Sizes(
        Size(0.0308, "1", (("c", 0.9692),), -0.28, -0.07, 86.57),
        Size(0.0657, "1", (("c", 0.9343),), 43.06, 10.99, 251.82),
        Size(0.0735, "1", (("c", 0.9265),), 123.51, 31.53, 352.67),
        Size(0.5, "1", (("c", 0.5),), 864.74, 220.76, 796.97),
    ),
    "sensor_delay": Sizes(
        Size(0.075, "s", (("T", 0.075),), 6.89, 1.76, 127.52),
        Size(0.125, "s", (("T", 0.125),), 36.05, 9.2, 246.34),
        Size(0.157, "s", (("T", 0.157),), 123.4, 31.5, 358.34),
        Size(0.2, "s", (("T", 0.2),), 248.75, 63.51, 463.3),
    ),
    "backlash": Sizes(
        Size(0.1, "rad", (("width", 0.1),), 4.81, 1.23, 97.95),
        Size(0.118, "rad", (("width", 0.118),), 41.39, 10.57, 102.86),
        Size(0.178, "rad", (("width", 0.178),), 117.82, 30.08, 242.51),
        Size(0.2, "rad", (("width", 0.2),), 204.06, 52.1, 303.65),
    ),
}
# fmt: on
