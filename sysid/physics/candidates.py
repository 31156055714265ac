"""Candidates: how each effect of the catalogue is tried on a log before anything is fitted."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.errors import InvalidInput
from sysid.physics.effects import ACTUATORS, CATALOGUE, Effect
from sysid.physics.model import Model
from sysid.physics.parameters import Extent, Parameter


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way to try an effect: with fixed numbers for its shapes, and one probe for each magnitude.

    neutral     the effect with these shapes, changing nothing
    magnitudes  the names (q,) of the parameters that are tried
    probes      the effect with each magnitude in turn off neutral, by sizes (q,)
    side        1 if the (only) magnitude cannot be below neutral, -1 if it cannot be above, else 0
    """

    neutral: Effect
    magnitudes: tuple[str, ...]
    probes: tuple[Effect, ...]
    sizes: tuple[float, ...]
    side: int

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.neutral.name

    def at(self, sizes: Sequence[float]) -> Effect:
        """The effect with its magnitudes off neutral by `sizes`, a little inside their bounds.

        A limit whose neutral value means "never" is set to its probe instead: nothing is linear on the way from there.
        """
        values = {}
        for k, a, probe in zip(self.magnitudes, sizes, self.probes, strict=True):
            p = self.neutral.parameters[k]
            low, high = p.bounds
            if p.never:
                values[k] = float(getattr(probe, k))
                continue
            neutral = 0.0 if p.neutral is None else p.neutral
            inside = min(1e-3 * min(high - low, 1.0), 0.05 * abs(float(getattr(probe, k)) - neutral))
            values[k] = float(np.clip(neutral + a, low + inside, high - inside))
        return self.neutral.with_parameters(values)


def candidates_for(kind: type[Effect], extent: Extent) -> tuple[Candidate, ...]:
    """The Candidates of an effect: every combination of its shapes and of its magnitudes' probes."""
    effect = kind().at_neutral()
    parameters = effect.parameters
    shapes = [p for p in parameters.values() if p.neutral is None]
    magnitudes = [p for p in parameters.values() if p.neutral is not None]
    names = tuple(p.name for p in magnitudes)
    combinations = []
    for shape in itertools.product(*(p.probes(extent) for p in shapes)):
        neutral = effect.with_parameters(dict(zip((p.name for p in shapes), shape, strict=True)))
        for values in itertools.product(*(p.probes(extent) for p in magnitudes)):
            probes = tuple(neutral.with_parameters({k: v}) for k, v in zip(names, values, strict=True))
            sizes = tuple(v - (p.neutral or 0.0) for v, p in zip(values, magnitudes, strict=True))
            combinations.append(Candidate(neutral, names, probes, sizes, _side(magnitudes)))
    return tuple(combinations)


def _side(magnitudes: Sequence[Parameter]) -> int:
    if len(magnitudes) != 1:
        return 0
    low, high = magnitudes[0].bounds
    return int(magnitudes[0].neutral == low) - int(magnitudes[0].neutral == high)


def candidates(
    model: Model, extent: Callable[[type[Effect]], Extent], names: Iterable[str] | None = None
) -> dict[str, tuple[Candidate, ...]]:
    """The Candidates of each effect that the model may lack: it is in the catalogue (or `names`), neither in the
    model nor excluded by it, and has a probe inside its bounds.

    `extent` gives the Extent of the log for a kind of effect.
    """
    present = set(model.effect_names)
    excluded = {name for e in model.effects for name in e.excludes}
    by_effect = {}
    for name in CATALOGUE if names is None else names:
        if name in ACTUATORS:
            raise InvalidInput(f"{name} is an actuator, and none is searched for: expected it in the model")
        kind = CATALOGUE[name]
        if name in present or name in excluded or present & set(kind.excludes):
            continue
        tried = candidates_for(kind, extent(kind))
        if tried:
            by_effect[name] = tried
    return by_effect
