"""Estimate: the answer of every identifier, a fitted model with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from sysid.data.json_file import plain_fields
from sysid.data.sensor import UNITS, Sensor
from sysid.errors import InvalidInput, is_real
from sysid.physics.model import Model
from sysid.physics.ops import Array

ESTIMATE_FIELDS = (
    *("method", "values", "units", "sd", "covariance", "noise", "success", "status", "cost", "random_torque"),
    *("correlation_time", "n_readings", "at_bound", "ambiguous"),
)
"""What plain data tell of an estimate."""


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """A fitted model with its uncertainty, as every identifier returns it.

    Attributes
    ----------
    model : Model
        The model with the fitted numbers.
    names : tuple of str
        The names of the P fitted parameters.
    covariance : array (P, P)
        The covariance of the fitted parameters, in their units.
    noise : dict
        The sd of the readings about the fit, by channel, in the plant's units; for the unscented filter it is that
        about its predictions.
    success : bool
        Whether the numbers can be used.
    status : str
        A sentence on how the fit ended and, if it ended badly, what to try.
    cost : float
        The sum of squares that was minimised, in units of the sensor's variance; nan if there is none.
    n_readings : int
        The number of readings that were used.
    method : str
        The identifier's name.
    sensor : Sensor or None
        The sensor whose noise was assumed, if the identifier keeps it.
    random_torque, correlation_time : float
        The sd of the random torque that the log asks for beside the model, in the plant's unit, and its correlation
        time [s]; 0 if it asks for none.
    """

    model: Model
    names: tuple[str, ...]
    covariance: Array
    noise: dict[str, float]
    success: bool
    status: str
    cost: float
    n_readings: int
    method: str
    sensor: Sensor | None = None
    random_torque: float = 0.0
    correlation_time: float = 0.0

    @property
    def values(self) -> dict[str, float]:
        """The fitted numbers by name."""
        parameters = self.model.parameters
        return {name: float(parameters[name].value) for name in self.names}

    @property
    def sd(self) -> dict[str, float]:
        """The standard deviation of each fitted parameter."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def interval(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Symmetric confidence intervals, which cover the truth with probability `level` if the model is right."""
        if not (is_real(level) and 0.0 < level < 1.0):
            raise InvalidInput(f"level = {level!r}: expected a probability between 0 and 1, such as 0.95")
        z = NormalDist().inv_cdf(0.5 + 0.5 * level)
        return {k: (v - z * self.sd[k], v + z * self.sd[k]) for k, v in self.values.items()}

    @property
    def ambiguous(self) -> tuple[str, ...]:
        """What these records leave undetermined, in sentences: combinations whose sd is above half their size."""
        parameters = self.model.parameters
        scale = np.array([parameters[n].yardstick for n in self.names])
        lost = [n for n, v in zip(self.names, np.diag(self.covariance), strict=True) if not math.isfinite(v)]
        unknown = ("the records do not determine these parameters: " + ", ".join(lost or self.names),)
        if not np.all(np.isfinite(self.covariance)):
            return unknown
        size, direction = np.linalg.eigh(self.covariance / np.outer(scale, scale))
        if np.all(size > 0.5**2):
            return unknown
        sentences = []
        for variance, v in zip(size, direction.T, strict=True):
            if variance > 0.5**2:
                parts = [n for n, w in zip(self.names, v, strict=True) if abs(w) > 0.3]
                if len(parts) == 1:
                    sentences.append(f"{parts[0]} is poorly determined by these records")
                else:
                    sentences.append(f"{' and '.join(parts)} cannot be told apart by these records")
        return tuple(sentences)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """The fitted parameters that ended at a bound: less than a thousandth of their sd from it."""
        parameters, sd, names = self.model.parameters, self.sd, []
        for name, value in self.values.items():
            near = 1e-6 * parameters[name].scale + (1e-3 * sd[name] if math.isfinite(sd[name]) else 0.0)
            if min(abs(value - b) for b in parameters[name].bounds) < near:
                names.append(name)
        return tuple(names)

    @property
    def units(self) -> dict[str, str]:
        """The units of the fitted parameters and of the noise, for this plant."""
        parameters, unit = self.model.parameters, self.model.plant.unit
        fitted = {name: parameters[name].unit for name in self.names}
        return fitted | {channel: unit(UNITS.get(channel, "")) for channel in self.noise}

    def to_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON; a number that is not finite becomes None."""
        return plain_fields(self, *ESTIMATE_FIELDS)

    def __repr__(self) -> str:
        parameters = self.model.parameters
        width, units = max(len(n) for n in self.names), self.units
        lines = [f"{self.method}: {self.status}"]
        for name, (low, high) in self.interval().items():
            p = parameters[name]
            mark = "  (at its bound)" if name in self.at_bound else ""
            lines.append(
                f"  {name:<{width}} = {p.value:.5g} +- {self.sd[name]:.2g} {units[name]}"
                f"   95 % [{low:.5g}, {high:.5g}]{mark}"
            )
        lines.append("  (+- is one standard deviation)")
        noise = ", ".join(f"{k} {v:.3g} {units[k]}" for k, v in self.noise.items())
        lines.append(f"  sd of the readings about the fit: {noise}  ({self.n_readings} readings)")
        if self.random_torque:
            size = f"{self.random_torque:.3g} {self.model.plant.unit('N m')} (one standard deviation)"
            memory = f", correlated over {self.correlation_time:.2g} s," if self.correlation_time else ""
            lines.append(f"  beside the model a random torque of {size}{memory} acts: diagnose it")
        lines.extend(f"  {sentence}" for sentence in self.ambiguous)
        return "\n".join(lines)
