"""The effects whose price is asked for: what each is made of at a size, and how large it may plausibly be.

Left out of the catalogue: back_emf and coasting_drive, which are viscous friction while the driver is on; stamp, which
belongs to a log and not to a machine. Plausible is up to where a builder would no longer call it a detail: three
quarters of the torque limit of 2 N m for a torque, the same at 5 rad/s for what grows with the speed, half for a gain,
0.3 s for a delay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sysid import Effect

U_MAX = 2.0


@dataclass(frozen=True)
class Magnitude:
    """An effect over one number, its `size` in `unit`: 0 changes nothing, `largest` is the end of what is plausible.

    numbers   the effect's parameters by name at a size; meaning: what the size is
    """

    effect: str
    meaning: str
    unit: str
    largest: float
    numbers: Callable[[float], dict[str, float]] = field(repr=False)

    def at(self, size: float) -> Effect:
        """The effect at a size [unit]."""
        from sysid import effect

        return effect(self.effect, **self.numbers(size))


_ALL = (
    Magnitude("viscous", "b", "N m s/rad", 0.3, lambda s: {"b": s}),
    Magnitude("coulomb", "tau_c", "N m", 1.5, lambda s: {"tau_c": s}),
    Magnitude(
        "stribeck",
        "tau_c + excess, of which 2/3 excess, v_s = 0.5 rad/s",
        "N m",
        1.5,
        lambda s: {"tau_c": s / 3.0, "excess": 2.0 * s / 3.0, "v_s": 0.5},
    ),
    Magnitude("drag", "c", "N m s^2/rad^2", 0.06, lambda s: {"c": s}),
    Magnitude("asymmetric_viscous", "b_plus, with b_minus = 0", "N m s/rad", 0.3, lambda s: {"b_plus": s}),
    Magnitude("asymmetric_coulomb", "tau_plus, with tau_minus = 0", "N m", 1.5, lambda s: {"tau_plus": s}),
    Magnitude("load_friction", "mu", "1", 0.1, lambda s: {"mu": s}),
    Magnitude("tilt", "alpha", "rad", 0.1, lambda s: {"alpha": s}),
    Magnitude("spring", "k", "N m/rad", 0.4, lambda s: {"k": s}),
    Magnitude("ripple", "a, of order 6", "N m", 1.5, lambda s: {"a": s, "order": 6.0}),
    Magnitude("rotor_inertia", "J_r", "kg m^2", 0.75, lambda s: {"J_r": s}),
    Magnitude("torque_bias", "tau_0", "N m", 1.5, lambda s: {"tau_0": s}),
    Magnitude("periodic", "a, at 1 Hz", "N m", 1.5, lambda s: {"a": s, "f": 1.0}),
    Magnitude("drift", "r", "N m/s", 0.15, lambda s: {"r": s}),
    Magnitude("delay", "T", "s", 0.3, lambda s: {"T": s}),
    Magnitude("lag", "T", "s", 0.3, lambda s: {"T": s}),
    Magnitude("torque_gain", "1 - c", "1", 0.5, lambda s: {"c": 1.0 - s}),
    Magnitude("dead_zone", "d", "N m", 1.5, lambda s: {"d": s}),
    Magnitude("saturation", "2 N m - limit", "N m", 1.5, lambda s: {"limit": U_MAX - s}),
    Magnitude("angle_offset", "offset", "rad", 0.2, lambda s: {"offset": s}),
    Magnitude("velocity_bias", "bias", "rad/s", 1.0, lambda s: {"bias": s}),
    Magnitude("velocity_gain", "1 - c", "1", 0.5, lambda s: {"c": 1.0 - s}),
    Magnitude("sensor_delay", "T", "s", 0.2, lambda s: {"T": s}),
    Magnitude("backlash", "width", "rad", 0.2, lambda s: {"width": s}),
)

MAGNITUDES = {magnitude.effect: magnitude for magnitude in _ALL}
