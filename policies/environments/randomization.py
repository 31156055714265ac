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
    """What draws the parameters of an episode; a frozen dataclass of plain numbers, so that it can be stored as JSON.

    Methods
    -------
    sample(rng, model)
        The parameters of one episode.
    to_json()
        Plain data.
    """

    @abstractmethod
    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        """Draw the parameters of one episode, within the bounds that the model's parameters carry.

        Parameters
        ----------
        rng : numpy.random.Generator
            Where the random numbers come from.
        model : Model
            The model whose parameters are drawn.

        Returns
        -------
        dict of str to float
            The parameters by name.

        Raises
        ------
        InvalidInput
            For a name that the model does not have.
        """

    def to_json(self) -> dict[str, Any]:
        """The randomization as plain data.

        Returns
        -------
        dict
            The kind and its numbers.
        """
        return {"kind": type(self).__name__, **asdict(self)}


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
    """Nothing is drawn: every episode is the model at its own values.

    Methods
    -------
    sample(rng, model)
        It draws no parameters.
    """

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        return {}


@dataclass(frozen=True)
class Band(Randomization):
    """Each parameter is drawn independently from a band around its centre, and clipped to its bounds afterwards.

        p ~ U(c (1 - w), c (1 + w))

    Parameters
    ----------
    center : mapping of str to float
        The centre c of each parameter, by name, in the parameter's unit.
    w : float, optional
        The relative half-width, in [0, 1); w = 0 trains at the centre alone.

    Raises
    ------
    InvalidInput
        For no centre at all, a centre that is not finite, and a w outside [0, 1).

    Notes
    -----
    Clipping the sample, not the interval, piles probability up at the bound: the paper does so (Sec. II-B).
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
class Ranges(Randomization):
    """Each parameter is drawn independently and uniformly from a range of its own, within its bounds.

    Parameters
    ----------
    ranges : mapping of str to pair of floats
        The range (low, high) of each parameter, by name, in the parameter's unit.

    Raises
    ------
    InvalidInput
        For a range that is not finite, or whose low is above its high.
    """

    ranges: Mapping[str, tuple[float, float]]

    def __post_init__(self) -> None:
        ranges = {name: (float(low), float(high)) for name, (low, high) in self.ranges.items()}
        object.__setattr__(self, "ranges", ranges)
        for name, (low, high) in ranges.items():
            if not -math.inf < low <= high < math.inf:
                raise InvalidInput(f"range of {name} is ({low}, {high}): expected (low, high) with low <= high")

    @classmethod
    def of(cls, model: Model, names: Sequence[str]) -> Ranges:
        """The whole of the bounds that some of a model's parameters carry: the paper's prior range (Sec. III).

        Parameters
        ----------
        model : Model
            The model.
        names : sequence of str
            The names of the parameters that are drawn.

        Returns
        -------
        Ranges
            Their bounds.

        Raises
        ------
        InvalidInput
            For a name that the model does not have, and for a parameter without finite bounds.
        """
        model.check_names(names)
        return cls({name: model.parameters[name].bounds for name in names})

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        return _within_bounds(model, {name: rng.uniform(low, high) for name, (low, high) in self.ranges.items()})


@dataclass(frozen=True)
class Posterior(Randomization):
    """All parameters are drawn together from the normal distribution that a fit found, and clipped to their bounds.

        p = p_hat + D R^(1/2) z,   z ~ N(0, 1)        C = D R D: D the standard deviations, R the correlations

    Parameters
    ----------
    names : tuple of str (P,)
        The names of the parameters.
    values : tuple of float (P,)
        The fitted values p_hat, in the parameters' units.
    covariance : tuple of tuples of float (P, P)
        The covariance C of the fitted values.

    Raises
    ------
    InvalidInput
        For a covariance that is not one, or that is infinite: the records then leave a parameter open.
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
        """The posterior of an estimate, for some of its parameters.

        Parameters
        ----------
        estimate : Estimate
            What a fit found.
        names : sequence of str (P,)
            The names of the parameters that are drawn.

        Returns
        -------
        Posterior
            Their normal distribution.

        Raises
        ------
        InvalidInput
            As the class does.
        """
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
        return scale[:, None] * (direction * np.sqrt(np.maximum(size, 0.0))) @ direction.T

    def sample(self, rng: np.random.Generator, model: Model) -> dict[str, float]:
        drawn = np.array(self.values) + self._root @ rng.standard_normal(len(self.names))
        return _within_bounds(model, dict(zip(self.names, drawn.tolist(), strict=True)))


@dataclass(frozen=True)
class Mixture(Randomization):
    """One of the alternatives is drawn, each as likely as another: for a log that cannot tell which effect is missing.

    Parameters
    ----------
    alternatives : tuple of mappings of str to float
        Each alternative is a full set of the same parameters; an effect that it does not mean stands at its neutral
        value, as in ({"coulomb.tau_c": 1.5, "delay.T": 0.0}, {"coulomb.tau_c": 0.0, "delay.T": 0.13}). What is drawn is
        clipped to the bounds.

    Raises
    ------
    InvalidInput
        For no alternatives, for alternatives with different parameters, and for a number that is not finite.
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
    """Some parameters are always drawn, and one effect or none of several.

        SingleEffect({"m": (0.3, 3.0)}, ({"coulomb.tau_c": (0.0, 1.5)}, {"delay.T": (0.0, 0.3)}),
                     {"coulomb.tau_c": 0.0, "delay.T": 0.0})

    Parameters
    ----------
    always : mapping of str to pair of floats
        The range (low, high) of each parameter that is drawn in every episode.
    kinds : tuple of mappings of str to pair of floats
        None or one of these is drawn, each as likely, from its own ranges.
    neutral : mapping of str to float
        The neutral value of every parameter of a kind; what is not drawn stands there.

    Raises
    ------
    InvalidInput
        Where a kind names what `neutral` has not, and for a range that is none.

    Notes
    -----
    It is for who does not know which effect is missing: a machine rarely lacks sixteen at once. What is drawn
    is clipped to the bounds.
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
    """What `inner` draws is drawn, and a random torque d acts on the joint all through the episode.

        d_0 ~ N(0, s^2)   d_(k+1) = a d_k + s sqrt(1 - a^2) z_k   a = exp(-dt / T)   z ~ N(0, 1)

    The torque is held over each interval dt; it is an Ornstein-Uhlenbeck process.

    Parameters
    ----------
    inner : Randomization
        What draws the parameters.
    s : float
        The standard deviation of the torque [N m].
    T : float
        The memory of the torque [s]; T = 0 draws it anew at each step.

    Raises
    ------
    InvalidInput
        For s or T below zero or not finite, and for an inner one that has a random force itself.

    Notes
    -----
    This is random force injection, with the memory that a residual torque shows.

    References
    ----------
    Crossing the Gap, by E. Valassakis, Z. Ding and E. Johns, IROS 2020.
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
        """Draw the random torque of one episode.

        Parameters
        ----------
        rng : numpy.random.Generator
            Where the random numbers come from.
        steps : int
            The number of intervals.
        dt : float
            Their length [s].

        Returns
        -------
        array (steps,)
            The torque d [N m] of each interval.
        """
        a = math.exp(-dt / self.T) if self.T > 0.0 else 0.0
        first, *z = rng.standard_normal(steps).tolist()
        new = math.sqrt(1.0 - a * a)
        return self.s * np.array(list(accumulate(z, lambda d, z_k: a * d + new * z_k, initial=first)))

    def to_json(self) -> dict[str, Any]:
        return super().to_json() | {"inner": self.inner.to_json()}


KINDS: dict[str, type[Randomization]] = {
    kind.__name__: kind for kind in (Fixed, Band, Ranges, Posterior, Mixture, SingleEffect, RandomForce)
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
