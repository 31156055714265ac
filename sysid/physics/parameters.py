"""Parameters: dataclass fields that know their unit, their bounds and their neutral value."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, Self, TypeAlias

import numpy as np

from sysid.errors import InvalidInput
from sysid.physics import ops
from sysid.physics.ops import Value

_KEY = "parameter"

USUAL_SPEED = 8.0
"""Largest speed [reach/s] of a usual motion of a joint; motors are faster."""
NEVER = 1e5
"""A neutral value of this size or more means a limit that nothing reaches."""


class Extent(NamedTuple):
    """The sizes of a log and its model on which probes may depend.

    The reach is a large way: a radian for a joint, half of the travel [m] for an axis. So no answer depends on whether
    positions came in metres.

    Attributes
    ----------
    dt : float
        The control interval [s].
    duration : float
        The longest rollout [s].
    u_max : float
        The largest command [N m].
    reach : float
        A large way [rad], for an axis [m].
    inertia : float
        The model's inertia [kg m^2].
    speed : float
        The largest speed [reach/s], if anything moves.
    """

    dt: float
    duration: float
    u_max: float
    reach: float = 1.0
    inertia: float = 1.0
    speed: float = USUAL_SPEED


LogProbe = Callable[[Extent], Sequence[float]]
"""A function that gives the values to try a parameter at on a log."""
Probe: TypeAlias = float | Sequence[float] | LogProbe | None


@dataclass(frozen=True)
class Parameter:
    """One number of a model, with its unit, its bounds and its neutral value.

    Attributes
    ----------
    name : str
        In a model, the names of its `owner` and of its `field`, as in "coulomb.tau_c".
    value : Value
        The number in `unit`: a float, an array, a CasADi symbol or a tensor.
    unit : str
        The unit of the value and of its bounds.
    bounds : (float, float)
        The values that are allowed, ends included.
    neutral : float or None
        The value at which the effect changes nothing; a parameter that has none (None) is a shape.
    probe : float, sequence of float, function or None
        The values to try it at: numbers, or a function of a log's Extent that gives them.
    known : bool
        Whether it is looked up, as gravity is: no fit changes it unless it is asked to.
    owner : str
        The effect that has it; "" for the plant.
    field : str
        The field that holds it.
    angles : int
        The power of the angle in the declared unit: 1 in "rad/s", -2 in "N m s^2/rad^2".
    """

    name: str
    value: Value
    unit: str
    bounds: tuple[float, float]
    neutral: float | None = None
    probe: Probe = None
    known: bool = False
    owner: str = ""
    field: str = ""
    angles: int = 0

    def probes(self, extent: Extent) -> tuple[float, ...]:
        """The values within the bounds to try this parameter at on a log of that extent.

        If none are declared, that of a shape is its value, else it is a hundredth of `large` beside neutral. Values
        declared in radians count in units of the reach.

        Parameters
        ----------
        extent : Extent
            The sizes of the log and its model.

        Returns
        -------
        tuple of float
            The values, each once, in `unit`; the neutral value is not among them.
        """
        chosen = self.probe(extent) if callable(self.probe) else self.probe
        numbers = chosen if isinstance(chosen, Sequence) else (chosen,) if chosen is not None else ()
        numbers = [extent.reach**self.angles * float(number) for number in numbers]
        if chosen is None:
            numbers = [float(self.value) if self.neutral is None else self.neutral + 0.01 * self.large(extent)]
        low, high = self.bounds
        within = dict.fromkeys(min(max(number, low), high) for number in numbers)
        return tuple(number for number in within if number != self.neutral)

    @property
    def scale(self) -> float:
        """A typical size: that of the number itself or, at zero, a tenth of the bounds' width but no more than 0.1."""
        return abs(float(self.value)) or 0.1 * min(self.bounds[1] - self.bounds[0], 1.0)

    @property
    def yardstick(self) -> float:
        """The size that its error is compared with: `scale`, but at least 0.01 if it may be nothing, as a friction or a
        delay may. A number near 0 is no measure of its own error."""
        return max(self.scale, 0.0 if self.neutral is None else 0.01)

    def large(self, extent: Extent) -> float:
        """A large number on a log of that extent: 1 in its unit, but with the log's own torque, inertia and reach.

        Where the log is faster than USUAL_SPEED, a slope over the speed is smaller: at the largest speed its torque is
        that of a 1 at USUAL_SPEED.

        Parameters
        ----------
        extent : Extent
            The sizes of the log and its model.

        Returns
        -------
        float
            The number, in `unit`.
        """
        size = extent.inertia if self.unit.startswith("kg") else extent.u_max if self.unit.startswith("N") else 1.0
        faster = max(extent.speed / USUAL_SPEED, 1.0)
        return (size or 1.0) * extent.reach**self.angles / faster ** _power_of_speed(self.unit)

    @property
    def never(self) -> bool:
        """Whether it is a limit that changes nothing until it is reached: no derivative at neutral shows it."""
        return self.neutral is not None and abs(self.neutral) >= NEVER

    @property
    def is_torque(self) -> bool:
        """Whether it is the size of an effect's torque [N m], or force [N]."""
        return bool(self.owner) and self.unit in ("N m", "N") and self.neutral is not None and not self.never

    def check(self, value: Value, owner: str = "") -> None:
        """Raise InvalidInput where numbers are not finite or out of bounds; symbols and tensors pass.

        Parameters
        ----------
        value : Value
            The number, or an array of numbers, to check.
        owner : str
            What the message puts before the parameter's name; by default nothing.

        Raises
        ------
        InvalidInput
            For numbers that are not finite or are out of bounds, and for what is no number, such as None or a text.
        """
        low, high = self.bounds
        if isinstance(value, float) and math.isfinite(value) and low <= value <= high:
            return
        name = f"{owner}.{self.name}" if owner else self.name
        if value is None or isinstance(value, bool | str | list | tuple | dict):
            raise InvalidInput(f"parameter {name} is {value!r}: expected a number or an array [{self.unit}]")
        if not ops.is_number(value):
            return
        numbers = np.asarray(value, dtype=float)
        if not np.all(np.isfinite(numbers)):
            raise InvalidInput(f"parameter {name} is {value}: a finite number [{self.unit}] was expected")
        if np.any(numbers < low) or np.any(numbers > high):
            worst = numbers.flat[np.argmax(np.maximum(low - numbers, numbers - high))]
            raise InvalidInput(
                f"parameter {name} = {worst:g} {self.unit} is out of bounds: expected {low:g} <= {name} <= {high:g}"
            )


def parameter(
    default: float,
    *,
    unit: str,
    bounds: tuple[float, float] = (-math.inf, math.inf),
    neutral: float | None = None,
    probe: Probe = None,
    known: bool = False,
) -> Any:
    """Declare a dataclass field as a parameter of the model.

    Parameters
    ----------
    default : float
        Its value where none is given.
    unit : str
        SI, in the units of what turns: "N m", "rad/s"; a linear axis translates them.
    bounds : (float, float)
        The values that are allowed, ends included.
    neutral : float, optional
        The value at which the effect that owns it changes nothing; a parameter without one is a shape.
    probe : float, sequence or function of an Extent, optional
        Values to try it at before anything is fitted.
    known : bool
        Whether it is looked up rather than fitted, as gravity is.

    Returns
    -------
    Any
        A field of a dataclass.
    """
    declared = {"unit": unit, "bounds": bounds, "neutral": neutral, "probe": probe, "known": known}
    return dataclasses.field(default=default, metadata={_KEY: declared})


@dataclass(frozen=True, eq=False)
class Parametric:
    """A part of a model (plant or effect) whose numbers are fields made by `parameter`.

    Parameters
    ----------
    bounds : mapping of str to (float, float)
        Other bounds than the declared ones, by field name: `RodPendulum(m=5.0, bounds={"m": (1.0, 9.0)})`.

    Raises
    ------
    InvalidInput
        For numbers that are not finite or are out of bounds, and for bounds of an unknown name or not low < high.
    """

    bounds: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        for name, (low, high) in self.bounds.items():
            if name not in self.parameters:
                raise InvalidInput(f"bounds name {name!r}: {type(self).__name__} has {', '.join(self.parameters)}")
            if not low < high:
                raise InvalidInput(f"bounds of {name} are ({low}, {high}): expected (low, high) with low < high")
        for p in self.parameters.values():
            p.check(p.value, owner=type(self).__name__)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters by field name, in the order in which they are declared."""
        declared = {}
        for field in dataclasses.fields(self):
            if _KEY in field.metadata:
                name, settings = field.name, field.metadata[_KEY]
                settings = settings | {"bounds": self.bounds[name]} if name in self.bounds else settings
                angles = _power_of_angle(settings["unit"])
                declared[name] = Parameter(name, getattr(self, name), field=name, angles=angles, **settings)
        return declared

    def with_parameters(self, values: Mapping[str, Value]) -> Self:
        """The same part holding other numbers: floats, arrays, CasADi symbols or tensors.

        Parameters
        ----------
        values : mapping of str to Value
            The numbers by field name; fields that are not named keep theirs.

        Returns
        -------
        Parametric
            A new part of the same class.

        Raises
        ------
        InvalidInput
            For numbers that are not finite or are out of bounds.
        """
        return dataclasses.replace(self, **values) if values else self


@cache
def _power_of_angle(unit: str) -> int:
    above, _, below = unit.replace("rad^2", "rad rad").partition("/")
    return above.count("rad") - below.count("rad")


@cache
def _power_of_speed(unit: str) -> int:
    """n of a slope over the n-th power of the speed, in N m s^n/rad^n; 0 of other units."""
    above, _, below = unit.partition("/")
    return above.replace("s^2", "s s").split().count("s") if below else 0


# ---- probes that depend on the log -----------------------------------------------------------------------------------


def of_largest(*shares: float) -> LogProbe:
    """Shares of the log's largest torque; the shares themselves where the log has none."""
    return lambda extent: tuple(share * (extent.u_max or 1.0) for share in shares)


def of_curve(*shares: float) -> LogProbe:
    """Shares of a slope: that of the log's largest torque over its largest speed."""
    return lambda extent: tuple(share * (extent.u_max or 1.0) / extent.speed for share in shares)


def of_duration(*shares: float) -> LogProbe:
    """Shares of the log's longest rollout [s], 0.1 s at least."""
    return lambda extent: tuple(max(share * extent.duration, 0.1) for share in shares)


def doubling(longest: float) -> LogProbe:
    """Times [s]: 0.5, 1, 2, 4, ... intervals, as far as `longest` [s] and the log reach."""

    def times(extent: Extent) -> tuple[float, ...]:
        last, doubled = min(longest, extent.duration), [0.5 * extent.dt]
        while 2.0 * doubled[-1] <= last:
            doubled.append(2.0 * doubled[-1])
        return tuple(doubled) if doubled[0] <= last else (last,)

    return times
