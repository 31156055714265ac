"""Causes: which known effects promise to explain what a model leaves of a log, before any is fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.diagnosis.findings import spaced_unit
from sysid.diagnosis.residual_torque import followed
from sysid.diagnosis.search_settings import DEFAULT
from sysid.errors import InvalidInput
from sysid.estimation.held_out import HeldOutError, finite, held_out_error
from sysid.estimation.prediction_error import Fit, inverse
from sysid.estimation.scores import Score, alikeness, price, scores
from sysid.estimation.solver import bounded_step
from sysid.physics.effects import CATALOGUE, Effect, Joint, JointEffect
from sysid.physics.ops import Array, Value
from sysid.physics.parameters import Parameter, parameter
from sysid.physics.plants import Plant

PRICE = 9.0
"""Decrease of the deviance that each number of a cause has to promise: noise does so in 3 of 1000 logs."""
LEAST_SHARE = 0.05
"""Share of the squared error beyond the noise that a second cause must explain."""
MOST_CAUSES = 3
"""Causes at a time."""
SIZED_EACH_ROUND = 4
"""Effects of which the size is found, in each round."""


@dataclass(frozen=True)
class Cause:
    """A known effect that explains what the model leaves, by a score test beside the causes before it.

    effect   its name; "plant" where inertia and gravity are off
    alike    other effects that this log cannot tell from it
    numbers  about how large it is, {name: {value, sd, unit}}
    share    of the squared error over 1 s beyond the noise that goes with it
    words    what it is and its size
    """

    effect: str
    alike: tuple[str, ...]
    numbers: dict[str, dict[str, Any]]
    share: float
    words: str

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        numbers = {k: {**v, "sd": finite(v["sd"])} for k, v in self.numbers.items()}
        return {**vars(self), "alike": list(self.alike), "numbers": numbers, "share": finite(self.share)}


@dataclass(frozen=True, eq=False)
class PlantNumbers(JointEffect):
    """Inertia and gravity torque of the plant that are larger than the model's, by shares of J [kg m^2] and of gravity.

    J theta_ddot = ... - inertia J theta_ddot + gravity gravity_torque(theta)
    """

    name = "plant"
    rarity = 1.0
    share_of_inertia: Value = parameter(0.0, unit="1", bounds=(-0.9, 10.0), neutral=0.0)
    share_of_gravity: Value = parameter(0.0, unit="1", bounds=(-1.0, 10.0), neutral=0.0)
    J: float = 1.0

    def inertia(self) -> Value:
        """Its share of J [kg m^2]."""
        return self.share_of_inertia * self.J

    def torque(self, joint: Joint) -> Value:
        """Its share of the gravity torque [N m]."""
        return self.share_of_gravity * joint.plant.gravity_torque(joint.theta)


def causes(found: Fit, names: Sequence[str], error: HeldOutError) -> tuple[Cause, ...]:
    """The effects that promise most, one after the other, the strongest first.

    Each is added to the model at the size that it promises, and the size of the random torque is found anew; sizes that
    came before stay free beside it.

    found   a fit of the model with its numbers as they are
    names   parameters that an identifier had fitted: what they would absorb is no evidence
    error   of the model over 1 s on the same records
    """
    chosen, before, excess = list[_Chosen](), error, error.ratio**2 - 1.0
    while len(chosen) < MOST_CAUSES:
        free = (*names, *(n for own in chosen for n in own.names))
        trial = _best(found, free)
        if trial is None:
            break
        effect, alike = trial
        try:
            then = followed(found.samples, found.model.with_effect(effect))
        except InvalidInput:
            break
        after = held_out_error(then.model, found.samples.records, found.samples.sensor, error.window)
        share = (before.ratio**2 - after.ratio**2) / max(excess, 1e-9)
        if not share > (LEAST_SHARE if chosen else 0.0):
            break
        found, before = then, after
        chosen.append(_Chosen(effect, alike, min(share, 1.0)))
    return _told(found, names, chosen)


@dataclass(frozen=True, eq=False)
class _Chosen:
    effect: Effect
    alike: tuple[str, ...]
    share: float

    @property
    def magnitudes(self) -> tuple[Parameter, ...]:
        return tuple(p for p in self.effect.parameters.values() if p.neutral is not None)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{self.effect.name}.{p.name}" for p in self.magnitudes)


def _best(found: Fit, free: Sequence[str]) -> tuple[Effect, tuple[str, ...]] | None:
    """The effect that pays most, and those that the log cannot tell from it."""
    found = replace(found, names=tuple(free), Z=found.filter.whiten(*found.linearised.changes(free)))
    tested = scores(found)
    merits = {n: s.lm - price(n, PRICE, s.shapes) for n, s in tested.items() if s.visible}
    likely = sorted((n for n in merits if merits[n] > 0.0), key=lambda n: -merits[n])[:SIZED_EACH_ROUND]
    trials = {n: (tested[n].best.at(tested[n].sizes), price(n, PRICE, tested[n].shapes)) for n in likely}
    if "plant" not in {e.name for e in found.model.effects}:
        slightly = PlantNumbers(share_of_inertia=0.01, share_of_gravity=0.01, J=found.inertia)
        trials["plant"] = slightly, 2.0 * PRICE + 2.0 * slightly.rarity
    settled = {n: _settled(found, effect) for n, (effect, _) in trials.items()}
    paid = {n: gain - trials[n][1] for n, (_, gain) in settled.items() if gain > trials[n][1]}
    if not paid:
        return None
    name = max(paid, key=paid.__getitem__)
    return settled[name][0], _alike(tested, name)


def _alike(tested: dict[str, Score], name: str) -> tuple[str, ...]:
    if name not in tested:
        return ()
    return tuple(
        n for n, s in tested.items() if n != name and s.lm > 0.0 and alikeness(s, tested[name]) > DEFAULT.alike
    )


def _settled(found: Fit, effect: Effect) -> tuple[Effect, float]:
    """The effect at the size at which it explains most of the innovations, and the decrease of the deviance then.

    From a score alone the size of a delay is that of its slope at no delay.
    """
    e, gain = found.e, 0.0
    for _ in range(4):
        z = _caused(found, effect)
        z = z - found.basis @ (found.basis.T @ z)
        whole = np.sum(z, axis=1)
        gain = float(2.0 * whole @ e - whole @ whole)
        factors = np.asarray(np.linalg.lstsq(z, e, rcond=1e-6)[0], dtype=float)
        if np.all(np.abs(factors - 1.0) < 0.02):
            break
        effect = _scaled(effect, factors)
    return effect, gain if math.isfinite(gain) else 0.0


def _caused(found: Fit, effect: Effect) -> Array:
    """The innovations (2 M, q) that an effect causes by each of its magnitudes."""
    neutral = effect.at_neutral()
    values = {k: float(p.value) for k, p in effect.parameters.items() if p.neutral is not None}
    parts = [neutral.with_parameters({k: v}) for k, v in values.items()]
    with np.errstate(over="ignore", invalid="ignore"):
        moved = found.linearised.effect_changes(parts, [1.0] * len(parts))
    return np.nan_to_num(found.filter.whiten(*(np.nan_to_num(v) for v in moved)))


def _scaled(effect: Effect, factors: Array) -> Effect:
    """The effect with its distances from neutral times these factors, within bounds; a limit stays."""
    values, magnitudes = {}, [p for p in effect.parameters.values() if p.neutral is not None]
    for p, factor in zip(magnitudes, factors.tolist(), strict=True):
        if not p.never and p.neutral is not None:
            values[p.name] = float(np.clip(p.neutral + factor * (float(p.value) - p.neutral), *p.bounds))
    scaled: Effect = effect.with_parameters(values)
    return scaled


def _told(found: Fit, names: Sequence[str], chosen: Sequence[_Chosen]) -> tuple[Cause, ...]:
    """Causes with sizes that a Gauss-Newton step of all of them together has found."""
    own = [n for c in chosen for n in c.names]
    free = (*names, *own)
    if not own:
        return ()
    Z = found.filter.whiten(*found.linearised.changes(free))
    parameters = found.model.parameters
    now = np.array([float(parameters[n].value) for n in free])
    low, high = np.array([parameters[n].bounds for n in free]).T
    step = bounded_step(Z, found.e, low - now, high - now)
    sd = np.sqrt(np.diag(inverse(Z.T @ Z)))
    numbers = {
        n: {"value": float(v), "sd": float(s), "unit": parameters[n].unit}
        for n, v, s in zip(free, now + step, sd, strict=True)
    }
    sized = [(c, {n: numbers[n] for n in c.names}) for c in chosen]
    return tuple(
        Cause(c.effect.name, c.alike, n, c.share, _words(c, n, parameters, found.model.plant)) for c, n in sized
    )


# words -----------------------------------------------------------------------------------------------------------


def _words(
    chosen: _Chosen, numbers: dict[str, dict[str, Any]], parameters: Mapping[str, Parameter], plant: Plant
) -> str:
    effect = chosen.effect
    if isinstance(effect, PlantNumbers):
        return _plant(list(numbers.values()), plant)
    shapes = [f"{p.name} = {_size(float(p.value), p.unit)}" for p in effect.parameters.values() if p.neutral is None]
    sizes = {parameters[n].field: _size(v["value"], v["unit"]) for n, v in numbers.items()}
    what = effect.words or effect.name.replace("_", " ")
    if len(sizes) == 1:
        said = f"{what} of about {next(iter(sizes.values()))}" + (f" ({', '.join(shapes)})" if shapes else "")
    else:
        said = f"{what} (about {', '.join([*(f'{k} = {v}' for k, v in sizes.items()), *shapes])})"
    alike = [CATALOGUE[n].words or n.replace("_", " ") for n in chosen.alike]
    return said + (f", or {' or '.join(alike)}, which moves these readings alike" if alike else "")


def _size(value: float, unit: str) -> str:
    """A number to two digits, short times in milliseconds."""
    if unit == "s" and abs(value) < 1.0:
        return f"{1e3 * value:.2g} ms"
    return f"{value:.2g}{spaced_unit(unit)}"


def _plant(numbers: Sequence[dict[str, Any]], plant: Plant) -> str:
    names = ("inertia" if plant.turns else "mass", "gravity torque")
    sure = [abs(v["value"]) > 3.0 * v["sd"] for v in numbers]
    said = [f"{n} is about {v['value']:+.0%} off" for n, v, s in zip(names, numbers, sure, strict=True) if s]
    return f"the plant's numbers do not fit: {' and '.join(said) or 'inertia or gravity is off'}"
