"""Rivals: models that differ in one effect each, every one fitted to the same log as well as it can be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sysid.diagnosis.candidates import Alternative, candidates
from sysid.effects import Effect, effect
from sysid.errors import InvalidInput
from sysid.identify.gauss_newton import Fit, fit_longest, fit_windows
from sysid.model import Model
from sysid.parameters import Extent
from sysid.planning.design import Hypothesis, Normal, foresee
from sysid.planning.refits import LEAD, at_horizon, grow
from sysid.planning.screen import screen
from sysid.planning.signals import Limits, Signal
from sysid.records import Record
from sysid.sensor import Sensor

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

    excess     sd of what the best of them leaves of the log, in units of the sensor's noise; 1 at least
    absorbed   rivals that the free parameters imitate whatever is played: nothing else is known then
    """

    hypotheses: tuple[Hypothesis, ...]
    pairs: tuple[Pair, ...]
    base: Hypothesis
    excess: float = 1.0
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
    sensor: Sensor,
    limits: Limits,
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
    extent = Extent(base.dt, limits.duration, limits.u_max)
    possible = candidates(base, extent, names)
    for name in names:
        if name not in possible:
            raise InvalidInput(f"{name} cannot stand beside the model's own effects: it cannot be a rival")
    log = tuple(records)
    if not log and known:
        log = _reference(base.with_effect(next(iter(known.values()))), sensor, limits)
    if not log:
        probes = {n: _probed(a[len(a) // 2]) for n, a in possible.items()}
        return _listed(base, base_names, probes, {}, list(names), None)
    fit, fits, unseen = _fitted(base, base_names, names, known, log, sensor)
    if unseen and set(unseen) <= set(INERTIAL):
        return Rivals((), (), Hypothesis(NOTHING, fit.model, base_names), absorbed=unseen)
    probes = {n: _probed(possible[n][len(possible[n]) // 2]) for n in unseen}
    gains = {n: fit.solution.lin.cost - f.solution.lin.cost for n, f in fits.items()}
    truths = [n for n in names if n in known and not records] or [
        n for n, gain in gains.items() if gain > 0.0 and gain >= _TRUE * max(gains.values())
    ]
    return _listed(fit.model, base_names, probes, fits, truths or list(names), fit if records else None)


def _probed(alternative: Alternative) -> Effect:
    return alternative.at(alternative.sizes)


def _reference(model: Model, sensor: Sensor, limits: Limits) -> tuple[Record, ...]:
    signal = Signal("multisine", 0.5 * limits.u_max, 0.3, 0.1, min(2.0, 0.1 / model.dt), 1.0, 0.0, 0)
    return tuple(foresee(model, [signal], limits, sensor).records)


def _fitted(
    base: Model,
    base_names: tuple[str, ...],
    names: tuple[str, ...],
    known: dict[str, Effect],
    log: Sequence[Record],
    sensor: Sensor,
) -> tuple[Fit, dict[str, Fit], tuple[str, ...]]:
    """The fit with none, one with each rival, all on the same windows, and the rivals that the log does not show."""
    fit = fit_longest(base, base_names, log, sensor, lead=LEAD)
    searched = tuple(n for n in names if n not in known)
    scores = screen(fit, searched)[0] if searched else {}
    begun = {n: s.best.at(s.sizes) for n, s in scores.items() if s.visible and s.best is not None}
    fits = {name: _with(fit, e) for name, e in (known | begun).items()}
    unseen = tuple(n for n in names if n not in fits)
    if fits and math.isfinite(fit.horizon):
        longest = grow(min(fits.values(), key=lambda f: f.solution.lin.cost)).horizon
        fits = {name: at_horizon(f, longest) for name, f in fits.items()}
        fit = at_horizon(fit, longest)
    return fit, fits, unseen


def _with(fit: Fit, added: Effect) -> Fit:
    own = {f"{added.name}.{k}": float(p.value) for k, p in added.parameters.items()}
    p = np.concatenate([fit.solution.p, list(own.values())])
    names = (*fit.names, *own)
    r = fit.response
    return fit_windows(fit.model.with_effect(added), names, r.records, r.sensor, fit.horizon, p, fit, LEAD)


def _listed(
    base: Model,
    base_names: tuple[str, ...],
    probes: dict[str, Effect],
    fits: dict[str, Fit],
    truths: Sequence[str],
    logged: Fit | None,
) -> Rivals:
    """The hypotheses and their pairs; a single one stands against the model without it."""
    nothing = Hypothesis(NOTHING, base, base_names)
    hypotheses = [Hypothesis(name, fit.model, fit.names) for name, fit in fits.items()]
    for name, e in probes.items():
        hypotheses.append(Hypothesis(name, base.with_effect(e), (*base_names, *(f"{name}.{k}" for k in e.parameters))))
    if len(hypotheses) == 1:
        hypotheses.append(nothing)
    pairs, variance = [], 1.0
    if logged is not None:
        variance = max(1.0, min((f.variance for f in fits.values()), default=logged.variance))
    for i, truth in enumerate(hypotheses):
        for j, rival in enumerate(hypotheses):
            if i == j or truth.name not in truths:
                continue
            before = None
            if logged is not None:
                before = _evidence(fits.get(truth.name, logged), fits.get(rival.name, logged)) / variance
            pairs.append(Pair(i, j, before))
    return Rivals(tuple(hypotheses), tuple(pairs), nothing, math.sqrt(variance))


def _evidence(truth: Fit, rival: Fit) -> float:
    """What the rival, at its best numbers on the same readings, leaves of the truth's."""
    own, other = truth.solution.lin, rival.solution.lin
    return float(Normal.of(other.S_x, other.S_p, other.e - own.e).together().unexplained()[0])
