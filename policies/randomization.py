"""Which pendulums an agent trains on: every episode draws new parameters."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sysid import InvalidInput, Model


class Randomization(ABC):
    """Draws the parameters of an episode; a frozen dataclass of plain numbers, so that it can be stored as JSON."""

    @abstractmethod
    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        """The parameters of one episode, within the bounds that the model's parameters carry.

        Raises InvalidInput for a name that the model does not have.
        """

    def to_json(self) -> dict[str, Any]:
        """Plain data: the kind and its numbers."""
        return {"kind": type(self).__name__, **asdict(self)}  # type: ignore[call-overload]


@dataclass(frozen=True)
class Band(Randomization):
    """Each parameter independently from U(c (1 - w), c (1 + w)) around its centre c, clipped to its bounds afterwards.

    w = 0 trains at the centre alone. Clipping the sample, not the interval, piles probability up at the bound: the
    paper does so. (Paper, Sec. II-B.)
    """

    center: Mapping[str, float]
    w: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", {name: float(value) for name, value in self.center.items()})
        if not self.center:
            raise InvalidInput("the band has no centre; expected at least one parameter, as in {'m': 1.0, 'l': 1.0}")
        for name, value in self.center.items():
            if not (math.isfinite(value) and value > 0.0):
                raise InvalidInput(f"centre of {name} is {value}: expected a positive number")
        if not 0.0 <= self.w < 1.0:
            raise InvalidInput(f"w = {self.w}: expected a relative width in [0, 1)")

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        model.check_names(self.center)
        parameters = model.parameters
        drawn = {name: rng.uniform(c * (1.0 - self.w), c * (1.0 + self.w)) for name, c in self.center.items()}
        return {name: float(np.clip(p, *parameters[name].bounds)) for name, p in drawn.items()}


@dataclass(frozen=True)
class PriorRange(Randomization):
    """Each parameter independently and uniformly from the whole of its bounds. (Paper, Sec. III: prior range.)"""

    names: tuple[str, ...] = ("m", "l")

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        """The parameters of one episode; raises InvalidInput for one without finite bounds."""
        model.check_names(self.names)
        parameters = model.parameters
        for name in self.names:
            if not all(map(math.isfinite, parameters[name].bounds)):
                raise InvalidInput(f"parameter {name} has bounds {parameters[name].bounds}: expected finite ones")
        return {name: float(rng.uniform(*parameters[name].bounds)) for name in self.names}
