"""Which pendulums an agent trains on: every episode draws new parameters."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from sysid import Estimate, InvalidInput, Model
from sysid.physics.ops import Array


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


def _within_bounds(model: Model, drawn: Mapping[str, float]) -> dict[str, float]:
    """What was drawn, clipped to the bounds that the model's parameters carry; InvalidInput for a name it lacks."""
    model.check_names(drawn)
    parameters, within = model.parameters, dict[str, float]()
    for name, value in drawn.items():
        low, high = parameters[name].bounds
        within[name] = float(min(max(value, low), high))
    return within


@dataclass(frozen=True)
class Fixed(Randomization):
    """Nothing is drawn: every episode is the model at its own values."""

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        return {}


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
            if not math.isfinite(value):
                raise InvalidInput(f"centre of {name} is {value}: expected a number")
        if not 0.0 <= self.w < 1.0:
            raise InvalidInput(f"w = {self.w}: expected a relative width in [0, 1)")

    @cached_property
    def _ranges(self) -> Ranges:
        ends = {name: sorted((c * (1.0 - self.w), c * (1.0 + self.w))) for name, c in self.center.items()}
        return Ranges({name: (low, high) for name, (low, high) in ends.items()})

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        return self._ranges.sample(rng, model)


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


@dataclass(frozen=True)
class Ranges(Randomization):
    """Each parameter independently and uniformly from a range (low, high) of its own, within its bounds."""

    ranges: Mapping[str, tuple[float, float]]

    def __post_init__(self) -> None:
        ranges = {name: (float(low), float(high)) for name, (low, high) in self.ranges.items()}
        object.__setattr__(self, "ranges", ranges)
        for name, (low, high) in ranges.items():
            if not -math.inf < low <= high < math.inf:
                raise InvalidInput(f"range of {name} is ({low}, {high}): expected (low, high) with low <= high")

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        return _within_bounds(model, {name: rng.uniform(low, high) for name, (low, high) in self.ranges.items()})


@dataclass(frozen=True)
class Posterior(Randomization):
    """All parameters together from the normal distribution that a fit found, clipped to their bounds afterwards.

        p = p_hat + D R^(1/2) z,   z ~ N(0, 1)        C = D R D: D the standard deviations, R the correlations

    names (P,), values (P,) fitted, covariance (P, P). Raises InvalidInput for a covariance that is not one, or that is
    infinite: the records then leave a parameter open.
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        rows = tuple(tuple(float(c) for c in row) for row in self.covariance)
        for name, value in (("names", tuple(self.names)), ("values", tuple(map(float, self.values)))):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "covariance", rows)
        P = len(self.names)
        if P == 0 or len(self.values) != P or len(rows) != P or any(len(row) != P for row in rows):
            raise InvalidInput(f"{P} names, {len(self.values)} values and {len(rows)} rows: expected as many of each")
        open_ = [name for name, row in zip(self.names, rows, strict=True) if not all(map(math.isfinite, row))]
        if open_:
            raise InvalidInput(
                f"the fit leaves {', '.join(open_)} open (its variance is not finite): nothing to draw from"
            )
        C = np.array(rows)
        if not np.allclose(C, C.T) or np.any(np.diag(C) < 0.0):
            raise InvalidInput("the covariance is not symmetric with variances >= 0: expected that of a fit")

    @classmethod
    def of(cls, estimate: Estimate, names: Sequence[str]) -> Posterior:
        """That of an estimate, of so many of its parameters. Raises InvalidInput as the class does."""
        at = [estimate.names.index(name) for name in names]
        rows = estimate.covariance[np.ix_(at, at)]
        return cls(tuple(names), tuple(estimate.values[name] for name in names), tuple(map(tuple, rows.tolist())))

    @cached_property
    def _root(self) -> Array:
        """D R^(1/2); the square root is the symmetric one, which is unique."""
        C = np.array(self.covariance)
        sd = np.sqrt(np.diag(C))
        scale = np.where(sd > 0.0, sd, 1.0)
        size, direction = np.linalg.eigh(C / np.outer(scale, scale))
        root: Array = scale[:, None] * (direction * np.sqrt(np.maximum(size, 0.0))) @ direction.T
        return root

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        drawn = np.array(self.values) + self._root @ rng.standard_normal(len(self.names))
        return _within_bounds(model, dict(zip(self.names, drawn.tolist(), strict=True)))


@dataclass(frozen=True)
class Mixture(Randomization):
    """One of the alternatives, each as likely as another: for a log that cannot tell which effect is missing.

    Each alternative is a full set of the same parameters; an effect that it does not mean stands at its neutral value:
    ({"coulomb.tau_c": 1.5, "delay.T": 0.0}, {"coulomb.tau_c": 0.0, "delay.T": 0.13}). Clipped to the bounds.
    """

    alternatives: tuple[Mapping[str, float], ...]

    def __post_init__(self) -> None:
        given = tuple(self.alternatives)
        if not given or not all(isinstance(alternative, Mapping) and alternative for alternative in given):
            raise InvalidInput(f"alternatives = {given}: expected at least one, as in ({{'m': 1.0}}, {{'m': 2.0}})")
        names = tuple(given[0])
        for alternative in given:
            if set(alternative) != set(names):
                raise InvalidInput(f"an alternative has {', '.join(alternative)}: expected {', '.join(names)} in each")
            for name, value in alternative.items():
                if not math.isfinite(value):
                    raise InvalidInput(f"an alternative has {name} = {value}: expected a number")
        ordered = tuple({name: float(alternative[name]) for name in names} for alternative in given)
        object.__setattr__(self, "alternatives", ordered)

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        return _within_bounds(model, self.alternatives[rng.integers(len(self.alternatives))])


@dataclass(frozen=True)
class SingleEffect(Randomization):
    """Each of `always` from its range, and of `kinds` none or one, each as likely, from its own; the rest is `neutral`.

    For who does not know which effect is missing: a machine rarely lacks sixteen at once.
    SingleEffect({"m": (0.3, 3.0)}, ({"coulomb.tau_c": (0.0, 1.5)}, {"delay.T": (0.0, 0.3)}), {"coulomb.tau_c": 0.0,
    "delay.T": 0.0}). Clipped to the bounds. Raises InvalidInput where a kind names what `neutral` has not.
    """

    always: Mapping[str, tuple[float, float]]
    kinds: tuple[Mapping[str, tuple[float, float]], ...]
    neutral: Mapping[str, float]

    def __post_init__(self) -> None:
        always, *kinds = (Ranges(ranges).ranges for ranges in (self.always, *self.kinds))
        for name, value in (("always", always), ("kinds", tuple(kinds)), ("neutral", dict(self.neutral))):
            object.__setattr__(self, name, value)
        for name in (name for kind in kinds for name in kind):
            if not math.isfinite(self.neutral.get(name, math.nan)):
                raise InvalidInput(f"{name} has no neutral number: expected one of every parameter of a kind")

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        chosen = int(rng.integers(len(self.kinds) + 1))
        rest = {name: (number, number) for name, number in self.neutral.items()}
        return Ranges({**rest, **self.always, **(self.kinds[chosen - 1] if chosen else {})}).sample(rng, model)


@dataclass(frozen=True)
class RandomForce(Randomization):
    """Draws what `inner` draws, and puts a random torque d on the joint all through the episode.

        d_0 ~ N(0, s^2)   d_(k+1) = a d_k + s sqrt(1 - a^2) z_k   a = exp(-dt / T)   z ~ N(0, 1)

    held over each interval dt: Ornstein-Uhlenbeck, of sd s [N m] and memory T [s]; T = 0: each step anew. Random force
    injection (E. Valassakis, Z. Ding, E. Johns: Crossing the Gap, IROS 2020), with the memory that a residual torque
    shows. Raises InvalidInput for s or T below zero or not finite, and for an inner one that has a random force itself.
    """

    inner: Randomization
    s: float
    T: float

    def __post_init__(self) -> None:
        if not isinstance(self.inner, Randomization) or isinstance(self.inner, RandomForce):
            raise InvalidInput(f"inner is {self.inner!r}: expected one without a random force, such as Fixed()")
        for name, unit in (("s", "N m"), ("T", "s")):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise InvalidInput(f"{name} = {value}: expected a finite number [{unit}] >= 0")
            object.__setattr__(self, name, float(value))

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        return self.inner.sample(rng, model)

    def torques(self, rng: np.random.Generator, steps: int, dt: float) -> Array:
        """d (steps,) [N m] of one episode at intervals of dt [s]."""
        a = math.exp(-dt / self.T) if self.T > 0.0 else 0.0
        first, *z = rng.standard_normal(steps).tolist()
        new = math.sqrt(1.0 - a * a)
        return self.s * np.array(list(accumulate(z, lambda d, z_k: a * d + new * z_k, initial=first)))

    def to_json(self) -> dict[str, Any]:
        """Plain data: the kind, the inner one's own and the numbers."""
        return super().to_json() | {"inner": self.inner.to_json()}


KINDS: dict[str, type[Randomization]] = {
    kind.__name__: kind for kind in (Fixed, Band, PriorRange, Ranges, Posterior, Mixture, SingleEffect, RandomForce)
}
"""What stored data call them."""


def from_json(data: Mapping[str, Any]) -> Randomization:
    """The randomization that `to_json` wrote; raises InvalidInput for other data."""
    numbers = {name: value for name, value in data.items() if name != "kind"}
    if data.get("kind") not in KINDS:
        raise InvalidInput(f"a randomization of kind {data.get('kind')!r}: expected one of {', '.join(KINDS)}")
    if "inner" in numbers:
        numbers["inner"] = from_json(numbers["inner"])
    try:
        return KINDS[data["kind"]](**numbers)
    except (TypeError, ValueError, AttributeError) as error:
        raise InvalidInput(f"a {data['kind']} of {numbers}: expected what to_json writes ({error})") from None
