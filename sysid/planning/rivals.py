"""Rivals: models that differ in one effect each, every one fitted to the same log as well as it can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from sysid.diagnosis.candidates import Alternative, candidates
from sysid.diagnosis.scores import scores
from sysid.diagnosis.search import extended
from sysid.effects import Effect, effect
from sysid.errors import InvalidInput
from sysid.estimation.chain import Chain
from sysid.estimation.first_fit import first_fit
from sysid.estimation.prediction_error import DEFAULT, Fit, fit
from sysid.model import Model
from sysid.parameters import Extent
from sysid.planning.design import KNOWN, Conditions, Hypothesis, foresee
from sysid.planning.evidence import Sensitivities
from sysid.planning.signals import Signal
from sysid.records import Record

NOTHING = "nothing"
"""Name of the hypothesis that no rival is there."""

INERTIAL = ("m", "l", "g", "J", "G", "torque_gain", "rotor_inertia")
"""What shows in the motion as J / c and G / c only, with c the torque gain."""

_TRUE = 0.25
"""A rival may be the truth where it explains at least that share of what the best one explains."""


class Pair(NamedTuple):
    """By number: the hypothesis that is taken to be true, the rival that it is to be told from, and the evidence on the
    log at hand (None: there is no log)."""

    truth: int
    rival: int
    before: float | None


@dataclass(frozen=True, eq=False)
class Rivals:
    """Hypotheses that a log confuses, the pairs that must be told apart, and the model with none of them.

    conditions those of the next log: with what the best of them leaves of this one
    absorbed   rivals that the free parameters imitate whatever is played: nothing else is known then
    """

    hypotheses: tuple[Hypothesis, ...]
    pairs: tuple[Pair, ...]
    base: Hypothesis
    conditions: Conditions
    absorbed: tuple[str, ...] = ()


def names_of(rivals: Sequence[str | Effect]) -> tuple[str, ...]:
    """Their names, checked; raises InvalidInput for one that is not in the catalogue or comes twice."""
    given = (rivals,) if isinstance(rivals, str | Effect) else tuple(rivals)
    names = tuple(effect(r).name if isinstance(r, str) else r.name for r in given)
    if len(set(names)) < len(names):
        raise InvalidInput(f"rivals name an effect twice: {', '.join(names)}")
    return names


def rivals_of(
    model: Model,
    free: Sequence[str],
    rivals: Sequence[str | Effect],
    records: Sequence[Record],
    conditions: Conditions,
) -> Rivals:
    """Every rival fitted to the log, or where there is none, to what the one of known size does under a multisine.

    Where no size can be known (no log, no numbers; or the log does not show the rival), that of the rival's probe.
    Raises InvalidInput for names that are unknown, come twice or cannot stand in this model.
    """
    names = names_of(rivals)
    known = {e.name: e for e in model.effects if e.name in names}
    known |= {r.name: r for r in rivals if isinstance(r, Effect)}
    base = model
    for e in model.effects:
        base = base.without_effect(e.name) if e.name in names else base
    own = tuple(f"{name}." for name in names)
    base_names = tuple(n for n in free if not n.startswith(own))
    if not base_names:
        raise InvalidInput("nothing is free beside the rivals: name at least one parameter of the plant")
    limits = conditions.limits
    possible = candidates(base, Extent(base.dt, limits.duration, limits.u_max), names)
    for name in names:
        if name not in possible:
            raise InvalidInput(f"{name} cannot stand beside the model's own effects: it cannot be a rival")
    probes = {n: _probed(a[len(a) // 2]) for n, a in possible.items()}
    log = tuple(records)
    if not log and known:
        log = _reference(base.with_effect(next(iter(known.values()))), conditions)
    if not log:
        return _listed(Fits(base, base_names, {}, conditions), probes, names)
    fits = _fitted(Chain(base, log, conditions.sensor), base, base_names, names, known, conditions, not records)
    probes = {n: probe for n, probe in probes.items() if n not in fits.with_rival}
    if probes and set(probes) <= set(INERTIAL):
        return Rivals((), (), fits.nothing, conditions, absorbed=tuple(probes))
    truths = [n for n in names if n in known and not records] or fits.likely
    return _listed(fits, probes, truths or names, bool(records))


def _probed(alternative: Alternative) -> Effect:
    return alternative.at(alternative.sizes)


def _reference(model: Model, conditions: Conditions) -> tuple[Record, ...]:
    signal = Signal("multisine", 0.5 * conditions.limits.u_max, 0.3, 0.1, min(2.0, 0.1 / model.dt), 1.0, 0.0, 0)
    return tuple(foresee(model, [signal], conditions).records)


@dataclass(frozen=True, eq=False)
class Fits:
    """The model with none of the rivals, its free parameters, and one fit with each rival that the log shows.

    conditions   those of the next log
    base         the fit with none; None where there is no log
    """

    model: Model
    names: tuple[str, ...]
    with_rival: dict[str, Fit]
    conditions: Conditions
    base: Fit | None = None

    @property
    def nothing(self) -> Hypothesis:
        """That no rival is there."""
        return Hypothesis(NOTHING, self.model, self.names)

    @property
    def likely(self) -> list[str]:
        """The rivals that explain a good part of what the best one explains."""
        assert self.base is not None
        gains = {n: self.base.deviance - own.deviance for n, own in self.with_rival.items()}
        return [n for n, gain in gains.items() if gain > 0.0 and gain >= _TRUE * max(gains.values())]

    def evidence(self, truth: str, rival: str) -> float:
        """What the rival, at its best numbers on the log at hand, leaves of the truth's changes, to first order."""
        if truth not in self.with_rival:
            return 0.0
        if truth not in self._sensitivities:
            found, conditions = self.with_rival[truth], self.conditions
            chain = Chain(found.model, found.chain.records, conditions.sensor)
            self._sensitivities[truth] = Sensitivities.beside(
                chain, found.model, truth, found.motion, self.names, conditions.disturbances
            )
        own, other = (self._effect(name) for name in (truth, rival))
        assert own is not None
        return float(self._sensitivities[truth].unlike(own, other).unexplained()[0])

    @cached_property
    def _sensitivities(self) -> dict[str, Sensitivities]:
        return {}

    def _effect(self, name: str) -> Effect | None:
        found = self.with_rival.get(name)
        return None if found is None else next(e for e in found.model.effects if e.name == name)


def _fitted(
    chain: Chain,
    base: Model,
    base_names: tuple[str, ...],
    names: tuple[str, ...],
    known: dict[str, Effect],
    conditions: Conditions,
    foreseen: bool,
) -> Fits:
    """The fit with none, and one with each rival that the log shows, or the rollouts that were `foreseen`."""
    if foreseen:
        fitted, settings = fit(chain, base, base_names, None, conditions.disturbances, KNOWN), KNOWN
    else:
        fitted, settings = first_fit(chain, base, base_names), DEFAULT
    searched = tuple(n for n in names if n not in known)
    found = scores(fitted, searched) if searched else {}
    begun = known | {n: s.best.at(s.sizes) for n, s in found.items() if s.visible}
    fits = {name: extended(fitted, [e], settings) for name, e in begun.items()}
    after = conditions if foreseen else conditions.after([fitted, *fits.values()])
    if after.much_louder(conditions):
        chain = Chain(base, chain.records, after.sensor)
        return _fitted(chain, base, base_names, names, known, after, foreseen)
    return Fits(fitted.model, base_names, fits, after, fitted)


def _listed(fits: Fits, probes: dict[str, Effect], truths: Sequence[str], logged: bool = False) -> Rivals:
    """The hypotheses and their pairs; a single one stands against the model without it."""
    hypotheses = [Hypothesis(name, own.model, own.names) for name, own in fits.with_rival.items()]
    for name, e in probes.items():
        own_names = (*fits.names, *(f"{name}.{k}" for k in e.parameters))
        hypotheses.append(Hypothesis(name, fits.model.with_effect(e), own_names))
    if len(hypotheses) == 1:
        hypotheses.append(fits.nothing)
    pairs = [
        Pair(i, j, fits.evidence(truth.name, rival.name) if logged else None)
        for i, truth in enumerate(hypotheses)
        for j, rival in enumerate(hypotheses)
        if i != j and truth.name in truths
    ]
    return Rivals(tuple(hypotheses), tuple(pairs), fits.nothing, fits.conditions)
