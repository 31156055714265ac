"""Model discrimination: rival effects that a log confuses, each as a model fitted to it, and what tells them apart."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.data.record import Record
from sysid.errors import InvalidInput
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction_error import Fit
from sysid.estimation.refits import extended
from sysid.estimation.scores import scores
from sysid.estimation.solver import fit_parameters
from sysid.physics.candidates import candidates
from sysid.physics.effects import CATALOGUE, Effect, effect
from sysid.physics.model import Model
from sysid.physics.parameters import Extent
from sysid.planning.design import ROUGHLY, Conditions, Hypothesis, Pool, within_limits
from sysid.planning.evidence import Sensitivities
from sysid.planning.excitation import random_signals
from sysid.planning.planned_experiment import HypothesisPair

NOTHING = "nothing"
"""Name of the hypothesis without any rival."""
_TRUE = 0.25
"""A rival may be the truth if it explains at least this share of what the best one explains."""
STRUCTURAL = 1e-4
"""If a rival leaves less than this share of an effect's evidence, no torque ever tells the two apart."""
NESTED = 1e-2
"""The same for a rival that was fitted in full, since such a fit need not have converged."""


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses that a log confuses, the last of them without any rival, and the pairs to tell apart.

    conditions those of the next log, with what the best hypothesis leaves unexplained in this one
    absorbed   rivals that the free parameters imitate whatever is played; if there are any, there are none
    """

    hypotheses: tuple[Hypothesis, ...]
    pairs: tuple[HypothesisPair, ...]
    conditions: Conditions
    absorbed: tuple[str, ...] = ()


def inertial(model: Model, names: Sequence[str]) -> bool:
    """Whether all these effects and parameters show in the motion only as J / c and G / c, c being the torque gain."""
    plant_names = model.names_of("")
    return all(n in plant_names or (n in CATALOGUE and CATALOGUE[n].inertial) for n in names)


def checked_names(rivals: Sequence[str | Effect]) -> tuple[str, ...]:
    """The rivals' names, checked; raises InvalidInput for one that is not in the catalogue or comes twice."""
    names = tuple(effect(r).name if isinstance(r, str) else r.name for r in rivals)
    if len(set(names)) < len(names):
        raise InvalidInput(f"rivals name an effect twice: {', '.join(names)}")
    return names


def hypotheses_of(
    model: Model,
    free: Sequence[str],
    rivals: Sequence[str | Effect],
    records: Sequence[Record],
    conditions: Conditions,
) -> Hypotheses:
    """The hypotheses for some rivals, fitted to the log or, without one, of the sizes that they are given.

    A rival of unknown size (no log and no numbers, or the log does not show it) has that of its probe. Raises
    InvalidInput for names that are unknown, come twice or cannot stand in this model.
    """
    names = checked_names(rivals)
    sized = {e.name: e for e in (*model.effects, *(r for r in rivals if isinstance(r, Effect))) if e.name in names}
    bare = replace(model, effects=tuple(e for e in model.effects if e.name not in names))
    base = Hypothesis(NOTHING, bare, tuple(n for n in free if n in bare.parameters))
    if not base.names:
        raise InvalidInput("nothing is free beside the rivals: name at least one parameter of the plant")
    limits = conditions.limits
    extent = Extent(model.dt, limits.duration, limits.u_max, inertia=float(bare.inertia()))
    possible = candidates(bare, lambda kind: extent, names)
    for name in names:
        if name not in possible:
            raise InvalidInput(f"{name} cannot stand beside the model's own effects: it cannot be a rival")
    middle = {n: tried[len(tried) // 2] for n, tried in possible.items()}
    probes = {n: candidate.at(candidate.sizes) for n, candidate in middle.items()}
    if not records:
        truths = [n for n in names if n in sized]
        return _listed(Fits(base, {}, conditions), probes | sized, truths or names)
    fits = _fitted(base, names, sized, records, conditions)
    if fits.conditions.much_louder(conditions):  # the noise was told wrong
        fits = _fitted(base, names, sized, records, fits.conditions)
    probes = {n: probe for n, probe in probes.items() if n not in fits.with_rival}
    if probes and inertial(model, tuple(probes)):
        return Hypotheses((fits.base,), (), conditions, absorbed=tuple(probes))
    return _listed(fits, probes, fits.likely or names)


@dataclass(frozen=True, eq=False)
class Fits:
    """The model with none of the rivals, at its fitted numbers, and one fit with each rival that the log shows.

    conditions   those of the next log
    deviance     of the fit with none; None where there is no log
    """

    base: Hypothesis
    with_rival: dict[str, Fit]
    conditions: Conditions
    deviance: float | None = None

    @property
    def likely(self) -> list[str]:
        """The rivals that explain a good part of what the best one explains."""
        assert self.deviance is not None
        gains = {n: self.deviance - fit.deviance for n, fit in self.with_rival.items()}
        return [n for n, gain in gains.items() if gain > 0.0 and gain >= _TRUE * max(gains.values())]


def _fitted(
    base: Hypothesis,
    names: Sequence[str],
    sized: dict[str, Effect],
    records: Sequence[Record],
    conditions: Conditions,
) -> Fits:
    """Fit the model without rivals, and with each rival that the readings show or whose size is known."""
    samples = Samples(base.model, records, conditions.sensor)
    none = fit_parameters(samples, base.model, base.names, settings=ROUGHLY)
    searched = [n for n in names if n not in sized]
    tested = scores(none, searched) if searched else {}
    begun = sized | {n: s.best.at(s.sizes) for n, s in tested.items() if s.visible}
    fits = {name: extended(none, [e], ROUGHLY) for name, e in begun.items()}
    after = conditions.after([none, *fits.values()])
    return Fits(Hypothesis(NOTHING, none.model, base.names), fits, after, none.deviance)


def _listed(fits: Fits, probes: dict[str, Effect], truths: Sequence[str]) -> Hypotheses:
    """The hypotheses, and the pairs to tell apart; a single rival is compared with the model without it."""
    hypotheses = [Hypothesis(name, fit.model, fit.names) for name, fit in fits.with_rival.items()]
    for name, e in probes.items():
        own_names = (*fits.base.names, *(f"{name}.{k}" for k in e.parameters))
        hypotheses.append(Hypothesis(name, fits.base.model.with_effect(e), own_names))
    rivals = [h.name for h in hypotheses] if len(hypotheses) > 1 else [hypotheses[0].name, NOTHING]
    pairs = []
    for truth in (rival for rival in rivals if rival in truths):
        others = [rival for rival in rivals if rival != truth]
        before = [None] * len(others) if fits.deviance is None else _evidence(fits, truth, others)
        pairs += [HypothesisPair(truth, *rival) for rival in zip(others, before, strict=True)]
    return Hypotheses((*hypotheses, fits.base), tuple(pairs), fits.conditions)


def _evidence(fits: Fits, truth: str, rivals: Sequence[str]) -> list[float]:
    """The evidence for the truth against each rival at its best numbers, on the log at hand and to first order."""
    if truth not in fits.with_rival:
        return [0.0] * len(rivals)
    effects = {n: fit.model.effect_named(n) for n, fit in fits.with_rival.items()}
    true_fit, conditions = fits.with_rival[truth], fits.conditions
    samples = Samples(true_fit.model, true_fit.samples.records, conditions.sensor)
    along = Sensitivities(
        samples, true_fit.model, effects[truth], true_fit.motion, fits.base.names, conditions.disturbances
    )
    return [float(along.unlike(effects[truth], effects.get(n)).unexplained()[0]) for n in rivals]


# ---- what signals tell -----------------------------------------------------------------------------------------------


def with_evidence(pool: Pool, pairs: Sequence[HypothesisPair], within: float = math.inf) -> tuple[HypothesisPair, ...]:
    """The pairs with the evidence that a pool's signals bring when each rival is fitted to what the truth shows.

    If the first-order evidence is over `within` times the least so far, it stands, and no fit is made.
    """
    first_order = [float(pool.unlike(c.truth, c.rival).together().unexplained()[0]) for c in pairs]
    least, measured = math.inf, list[HypothesisPair]()
    for linear, c in sorted(zip(first_order, pairs, strict=True), key=lambda pair: pair[0]):
        after = pool.left(c.truth, c.rival) if linear < within * least else linear
        least = min(least, after)
        measured.append(c._replace(after=after))
    return tuple(measured)


def separable(
    hypotheses: Sequence[Hypothesis], pairs: Sequence[HypothesisPair], conditions: Conditions, rng: np.random.Generator
) -> tuple[HypothesisPair, ...]:
    """The pairs that some torque decides, without those in which the truth is a special case of the rival.

    The evidence against a rival is compared with that against the hypothesis of no effect.
    """
    signals = random_signals(rng, conditions.limits, hypotheses[0].model.dt, 8, swings=False)
    signals = within_limits(hypotheses, signals, conditions)
    some = [s for s in signals if s.kind in ("steps", "bang-bang")][:1]
    pool, played, decided = Pool(hypotheses, signals, conditions), Pool(hypotheses, some, conditions), []
    for c in pairs:
        if len(pool.hypotheses[c.rival].names) > len(pool.hypotheses[c.truth].names):
            # at a kink linearisation does not see that the truth is a special case of the rival: a fit does
            apart = played.left(c.truth, c.rival) > NESTED * played.left(c.truth, NOTHING)
        else:
            alone, against = (pool.unlike(c.truth, other).unexplained() for other in (NOTHING, c.rival))
            apart = bool(np.any(against > STRUCTURAL * alone))
        if apart:
            decided.append(c)
    return tuple(decided)


def indistinguishable(pairs: Sequence[HypothesisPair], apart: Sequence[HypothesisPair]) -> dict[str, str]:
    """Each hypothesis that no torque tells from an earlier one, with that one."""
    order, separated = list(dict.fromkeys(c.truth for c in pairs)), {frozenset((c.truth, c.rival)) for c in apart}
    equal = (c for c in reversed(pairs) if frozenset((c.truth, c.rival)) not in separated)
    return {c.truth: c.rival for c in equal if c.rival in order[: order.index(c.truth)]}
