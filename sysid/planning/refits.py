"""Refits of a search: a fit with one more effect, without one, at another horizon; and what a larger model gains."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sysid.effects import Effect
from sysid.identify.gauss_newton import COLOURED, Fit, fit_longest, fit_windows
from sysid.planning.screen import Score
from sysid.records import Array

LEAD = 0.3
"""Seconds before a window that are not scored, in every fit of a search, so that their costs compare."""


def at_horizon(fit: Fit, horizon: float) -> Fit:
    """The same model fitted at another horizon."""
    if fit.horizon == horizon:
        return fit
    response = fit.response
    return fit_windows(fit.model, fit.names, response.records, response.sensor, horizon, fit.solution.p, fit, LEAD)


def extend(fit: Fit, score: Score, full: Fit | None = None) -> Fit:
    """The fit with one more effect, at the same horizon, begun where the fit ended and at the best of several sizes:
    those that the screen expects, its probes, and almost nothing, so that it does not end above the smaller fit.
    """
    assert score.best is not None
    expected = score.best.at(score.sizes)
    others = [score.best.at(tuple(0.03 * size for size in score.sizes))]
    others += [probe for other in score.others for probe in other.probes]
    best = _with(fit, [expected, *others], fit.solution.p, fit)
    promised = 0.5 * score.lm * fit.variance
    if full is None and fit.solution.lin.cost - best.solution.lin.cost < 0.3 * promised:
        best = min(best, _with(fit, [expected], fit.solution.p, fit), key=_cost)
    if not best.solution.converged:
        best = min(best, at_horizon(_through_shorter(fit, expected), fit.horizon), key=_cost)
    if full is not None:
        p = np.array([full.solution.p[full.names.index(n)] for n in fit.names])
        best = min(best, _with(fit, [expected, *others], p, full), key=_cost)
    return best


def _through_shorter(fit: Fit, effect: Effect) -> Fit:
    """The fit with one more effect, begun at short windows: where a whole motion is far off they still show the way."""
    response, own = fit.response, _numbers(effect)
    model, p = fit.model.with_effect(effect), np.concatenate([fit.solution.p, list(own.values())])
    return fit_longest(model, (*fit.names, *own), response.records, response.sensor, p, lead=LEAD)


def _with(fit: Fit, effects: Sequence[Effect], p: Array, near: Fit) -> Fit:
    response, model = fit.response, fit.model.with_effect(effects[0])
    own = [_numbers(e) for e in effects]
    starts = [np.concatenate([p, list(values.values())]) for values in own]
    names = (*fit.names, *own[0])
    return fit_windows(model, names, response.records, response.sensor, fit.horizon, starts, near, LEAD)


def _numbers(effect: Effect) -> dict[str, float]:
    """Its parameters by full name."""
    return {f"{effect.name}.{k}": float(p.value) for k, p in effect.parameters.items()}


def _cost(fit: Fit) -> float:
    return fit.solution.lin.cost


def reduce_by(fit: Fit, name: str) -> Fit:
    """The fit without an effect, at the same horizon."""
    keep = [i for i, n in enumerate(fit.names) if not n.startswith(f"{name}.")]
    names, p = tuple(fit.names[i] for i in keep), fit.solution.p[keep]
    response = fit.response
    model = fit.model.without_effect(name)
    return fit_windows(model, names, response.records, response.sensor, fit.horizon, p, fit, LEAD)


def grow(fit: Fit) -> Fit:
    """The same model at the longest horizon that it follows."""
    if math.isinf(fit.horizon):
        return fit
    response = fit.response
    return fit_longest(
        fit.model, fit.names, response.records, response.sensor, fit.solution.p, fit, shortest=fit.horizon, lead=LEAD
    )


def gain(base: Fit, other: Fit, wary: bool = True) -> float:
    """Cross-validated gain in log likelihood: each record (or stretch, where records are few) left out in turn.

    One Gauss-Newton step from the full fit stands for a refit:  dp = -(F - F_g)^-1 g_g,  e_g' = e_g - S_g dp.
    Where residuals stay coloured with the larger model, two standard errors of the folds are taken off if `wary`.
    """
    gains = (_left_out(base) - _left_out(other)) / min(base.variance, other.variance)
    total = float(np.sum(gains))
    if wary and other.inflation > COLOURED:
        total -= 2.0 * float(np.std(gains)) * math.sqrt(len(gains))
    return total


def _left_out(fit: Fit) -> Array:
    """Half the sum of squares of each fold, predicted by the others."""
    reduced, response = fit.reduced, fit.response
    S, e = reduced.S.reshape(reduced.e.size, len(fit.names)), reduced.e.ravel()
    owner = np.array([w.record for w in response.windows])
    if len(response.records) >= 4:
        folds = np.repeat(owner, e.size // len(owner))
    else:
        folds = response.clusters() * 8 // (int(response.clusters().max()) + 1)
    F, costs = reduced.information, []
    ridge = 1e-9 * np.diag(np.diag(F))
    for fold in np.unique(folds):
        at = folds == fold
        S_g, e_g = S[at], e[at]
        dp = -np.linalg.lstsq(F - S_g.T @ S_g + ridge, S_g.T @ e_g, rcond=1e-12)[0]
        costs.append(0.5 * float(np.sum((e_g - S_g @ dp) ** 2)))
    return np.array(costs)
