"""Rivals: models that differ in one effect each, every one fitted to the same log as well as it can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.diagnose.design import Hypothesis, Normal, foresee, noise_free, separation
from sysid.diagnose.screen import screen
from sysid.diagnose.search import LEAD
from sysid.diagnose.signals import Limits, Signal
from sysid.effects import Effect, effect
from sysid.errors import InvalidInput
from sysid.identify.gauss_newton import Fit, fit_longest, fit_windows
from sysid.model import Model
from sysid.records import Record
from sysid.sensor import Sensor

NOTHING = "nothing"
"""Name of the hypothesis that no rival is there."""

_TRUE = 0.25
"""A rival may be the truth where it explains at least that share of what the best one explains."""


@dataclass(frozen=True, eq=False)
class Rivals:
    """Hypotheses that a log confuses.

    pairs      (truth, rival) by number: which of them must be told apart
    base       the model with none of them
    before     evidence that the log itself holds, the least over the pairs; None where there is no log
    invisible  rivals that the free parameters absorb whatever is played
    """

    hypotheses: tuple[Hypothesis, ...]
    pairs: tuple[tuple[int, int], ...]
    base: Hypothesis
    before: float | None
    invisible: tuple[str, ...] = ()


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

    Raises InvalidInput where no size is known: none is in the model, none came with numbers, and there is no log.
    """
    names = names_of(rivals)
    own = tuple(f"{name}." for name in names)
    known = {e.name: e for e in model.effects if e.name in names}
    known |= {r.name: r for r in rivals if isinstance(r, Effect)}
    base = model
    for e in model.effects:
        base = base.without_effect(e.name) if e.name in names else base
    base_names = tuple(n for n in free if not n.startswith(own))
    if not base_names:
        raise InvalidInput("nothing is free beside the rivals: name at least one parameter of the plant")
    log = tuple(records)
    if not log:
        if not known:
            raise InvalidInput(
                f"no size is known of {', '.join(names)}: give the records, or an effect with numbers in place of its name"
            )
        first = next(iter(known.values()))
        log = _reference(base.with_effect(first), sensor, limits)
    fits, base_fit, invisible = _fitted(base, base_names, names, known, log, sensor)
    if invisible:
        return Rivals((), (), Hypothesis(NOTHING, base_fit.model, base_names), None, invisible)
    return _ranked(fits, base_fit, bool(records), known)


def _reference(model: Model, sensor: Sensor, limits: Limits) -> tuple[Record, ...]:
    signal = Signal("multisine", 0.5 * limits.u_max, 0.3, 0.1, min(2.0, 0.1 / model.dt), 1.0, 0.0, 0)
    return tuple(noise_free(foresee(model, [signal], limits), sensor))


def _fitted(
    base: Model,
    base_names: tuple[str, ...],
    names: tuple[str, ...],
    known: dict[str, Effect],
    log: Sequence[Record],
    sensor: Sensor,
) -> tuple[dict[str, Fit], Fit, tuple[str, ...]]:
    """A fit with each rival, all on the same windows, the fit with none, and the rivals that cannot be seen."""
    fit = fit_longest(base, base_names, log, sensor, lead=LEAD)
    searched = tuple(n for n in names if n not in known)
    scores = screen(fit, searched)[0] if searched else {}
    excluded = [n for n in searched if n not in scores]
    if excluded:
        raise InvalidInput(f"{excluded[0]} cannot stand beside the model's own effects: it cannot be a rival")
    begun = dict(known)
    for name, score in scores.items():
        if not score.visible or score.best is None:
            return {}, fit, names
        begun[name] = score.best.at(score.sizes)
    fits = {name: _with(fit, begun[name]) for name in names}
    longest = min(
        fit_longest(f.model, f.names, log, sensor, f.solution.p, f, shortest=f.horizon, lead=LEAD).horizon
        for f in fits.values()
    )
    if longest > fit.horizon:
        fits = {
            name: fit_windows(f.model, f.names, log, sensor, longest, f.solution.p, f, LEAD) for name, f in fits.items()
        }
        fit = fit_windows(fit.model, fit.names, log, sensor, longest, fit.solution.p, fit, LEAD)
    return fits, fit, ()


def _with(fit: Fit, added: Effect) -> Fit:
    own = {f"{added.name}.{k}": float(p.value) for k, p in added.parameters.items()}
    p = np.concatenate([fit.solution.p, list(own.values())])
    names = (*fit.names, *own)
    r = fit.response
    return fit_windows(fit.model.with_effect(added), names, r.records, r.sensor, fit.horizon, p, fit, LEAD)


def _ranked(fits: dict[str, Fit], base: Fit, logged: bool, known: dict[str, Effect]) -> Rivals:
    nothing = Hypothesis(NOTHING, base.model, base.names)
    hypotheses = [Hypothesis(name, fit.model, fit.names) for name, fit in fits.items()]
    lins = [fit.solution.lin for fit in fits.values()]
    gains = [base.solution.lin.cost - lin.cost for lin in lins]
    truths = [i for i, gain in enumerate(gains) if gain >= _TRUE * max(gains)] if logged else []
    truths = truths or [i for i, name in enumerate(fits) if name in known] or [int(np.argmax(gains))]
    if len(hypotheses) == 1:
        hypotheses.append(nothing)
        lins.append(base.solution.lin)
    pairs = tuple((i, j) for i in truths for j in range(len(hypotheses)) if i != j)
    before = None
    if logged:
        value = separation(pairs).value
        before = float(value([Normal.of(lins[j], lins[i]).together() for i, j in pairs])[0])
    return Rivals(tuple(hypotheses), pairs, nothing, before)
