"""Causes: which known effects explain a model's errors on a log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sysid.data.json_file import plain_fields
from sysid.diagnosis.findings import fitted_numbers, numbers_in_words, spaced_unit
from sysid.diagnosis.search_settings import DEFAULT
from sysid.errors import InvalidInput
from sysid.estimation.estimate import Estimate
from sysid.estimation.held_out import HeldOutError, held_out_error
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended
from sysid.estimation.scores import collinearity, price, scores
from sysid.estimation.solver import QUICK, fit_parameters
from sysid.physics.effects import CATALOGUE, Effect, Joint, JointEffect
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter
from sysid.physics.plants import Plant

PRICE = 9.0
"""Decrease of the deviance that each number of a cause has to bring; noise alone brings it in 3 of 1000 logs."""
LEAST_EXPLAINED = 0.05
"""Least share of the squared error beyond the noise that a cause after the first has to explain."""
LARGE_SHARE = 0.3
"""Share of that error from which other numbers of the model are named as a cause, or a rest as unexplained."""
MOST_CAUSES = 3
"""Most causes of one answer."""
FITTED_EACH_ROUND = 4
"""Number of effects that are fitted in each round."""


@dataclass(frozen=True)
class Cause:
    """A known effect that explains a part of the model's error, fitted beside the other causes.

    effect             its name; "plant" if the model's own numbers are off
    indistinguishable  other effects that this log cannot tell from it
    numbers            its fitted numbers, {name: {value, sd, unit}}
    share              of the squared error over 1 s, beyond the noise, that it explains
    description        what it is and its size
    """

    effect: str
    indistinguishable: tuple[str, ...]
    numbers: dict[str, dict[str, Any]]
    share: float
    description: str

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        begin = {"effect": self.effect, "alike": list(self.indistinguishable)}
        return begin | plain_fields(self, "numbers", "share") | {"words": self.description}


@dataclass(frozen=True, eq=False)
class PlantNumbers(JointEffect):
    """The plant's inertia and gravity torque exceed the model's, by shares of J [kg m^2] and of the gravity torque.

    J theta_ddot = ... - share_of_inertia J theta_ddot + share_of_gravity gravity_torque(theta)
    """

    name = "plant"
    rarity = 1.0
    share_of_inertia: Value = parameter(0.0, unit="1", bounds=(-0.9, 10.0), neutral=0.0)
    share_of_gravity: Value = parameter(0.0, unit="1", bounds=(-1.0, 10.0), neutral=0.0)
    J: float = 1.0

    def inertia(self) -> Value:
        """The additional inertia [kg m^2]."""
        return self.share_of_inertia * self.J

    def torque(self, joint: Joint) -> Value:
        """The additional gravity torque [N m]."""
        return self.share_of_gravity * joint.gravity


def causes(fit: Fit, names: Sequence[str], error: HeldOutError) -> tuple[Cause, ...]:
    """The effects that explain most of a model's error, chosen one after the other, the strongest first.

    Each is fitted beside the causes before it, and beside the parameters that an identifier had fitted: a missing
    effect bends these, and what they can absorb is no evidence for an effect.

    fit     a fit of the random torque alone, with the model's numbers as they are
    names   the parameters that an identifier had fitted
    error   of the model over 1 s on the same records
    """
    excess, before, chosen = max(error.ratio**2 - 1.0, 1e-9), error.ratio, list[Cause]()
    plant: tuple[Cause, ...] = ()
    if names:
        fit = fit_parameters(fit.samples, fit.model, names, fit, settings=QUICK)
        before = min(_error(fit, error), error.ratio)
        share = (error.ratio**2 - before**2) / excess
        plant = (_other_numbers(fit, share),) if share > LARGE_SHARE else ()
    while len(chosen) < MOST_CAUSES:
        best = _best(fit)
        if best is None:
            break
        effect, indistinguishable, fit = best
        after = _error(fit, error)
        share = (before**2 - after**2) / excess
        if not share > (LEAST_EXPLAINED if chosen else 0.0):
            break
        chosen.append(Cause(effect, indistinguishable, {}, min(share, 1.0), ""))
        before, end = after, fit
    return (*plant, *_sized(chosen, end.estimate())) if chosen else plant


def _error(fit: Fit, error: HeldOutError) -> float:
    return held_out_error(fit.model, fit.samples.records, fit.samples.sensor, error.window).ratio


def _best(fit: Fit) -> tuple[str, tuple[str, ...], Fit] | None:
    """The effect that pays most, those that the log cannot tell from it, and the fit with it; None if none pays."""
    tested = scores(fit)
    promise = {n: s.merit(PRICE) for n, s in tested.items() if s.visible}
    likely = sorted((n for n, merit in promise.items() if merit > 0.0), key=lambda n: -promise[n])[:FITTED_EACH_ROUND]
    begun: list[Effect] = [tested[n].best.at(tested[n].sizes) for n in likely]
    free = {fit.model.parameters[n].owner for n in fit.names}
    if not free & {"", PlantNumbers.name}:
        begun.append(PlantNumbers(J=fit.inertia))
    paid, fits = dict[str, float](), dict[str, Fit]()
    for effect in begun:
        try:
            fits[effect.name] = extended(fit, [effect], QUICK)
        except InvalidInput:  # it excludes another, or the model runs away with it
            continue
        paid[effect.name] = fit.deviance - fits[effect.name].deviance - price(effect, PRICE)
    name = max(paid, key=paid.__getitem__, default="")
    if not name or not paid[name] > 0.0:
        return None
    if name not in tested:
        return name, (), fits[name]
    least, others = DEFAULT.high_collinearity, (n for n, s in tested.items() if n != name and s.lm > 0.0)
    return name, tuple(n for n in others if collinearity(tested[n], tested[name]) > least), fits[name]


def _other_numbers(fit: Fit, share: float) -> Cause:
    """The cause "plant": the model's own numbers are others in these records."""
    numbers = fitted_numbers(fit.estimate())
    description = f"the model's own numbers are others here ({numbers_in_words(numbers)})"
    return Cause(PlantNumbers.name, (), numbers, min(share, 1.0), description)


def _sized(chosen: Sequence[Cause], estimate: Estimate) -> Iterator[Cause]:
    """The chosen causes, with the sizes that they have in the last fit, beside each other."""
    for cause in chosen:
        numbers = fitted_numbers(estimate, cause.effect)
        is_plant = cause.effect == PlantNumbers.name
        description = _plant(numbers, estimate.model.plant) if is_plant else _description(cause, numbers)
        yield replace(cause, numbers=numbers, description=description)


# words -----------------------------------------------------------------------------------------------------------


def _description(chosen: Cause, numbers: Mapping[str, Mapping[str, Any]]) -> str:
    what = CATALOGUE[chosen.effect].label
    sizes = {name.rpartition(".")[2]: _size(number["value"], number["unit"]) for name, number in numbers.items()}
    if len(sizes) == 1:
        said = f"{what} of about {sizes.popitem()[1]}"
    else:
        said = f"{what} (about {', '.join(f'{name} = {size}' for name, size in sizes.items())})"
    others = [CATALOGUE[n].label for n in chosen.indistinguishable]
    return said + (f", or {' or '.join(others)}, which moves these readings alike" if others else "")


def _size(value: float, unit: str) -> str:
    """A number to two digits with its unit, times below a second in milliseconds."""
    if unit == "s" and abs(value) < 1.0:
        return f"{1e3 * value:.2g} ms"
    return f"{value:.2g}{spaced_unit(unit)}"


def _plant(numbers: Mapping[str, Mapping[str, Any]], plant: Plant) -> str:
    names = ("inertia" if plant.turns else "mass", "gravity torque")
    sized = zip(names, numbers.values(), strict=True)
    said = [f"{n} is about {v['value']:+.0%} off" for n, v in sized if abs(v["value"]) > 3.0 * v["sd"]]
    return f"the plant's numbers do not fit: {' and '.join(said) or 'inertia or gravity is off'}"
