"""Refits: a fit with more effects, or without one, begun where another fit ended."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from sysid.estimation.disturbances import Disturbances
from sysid.estimation.energy_balance import EnergyBalance
from sysid.estimation.prediction_error import Fit
from sysid.estimation.solver import THOROUGH, Settings, fit_parameters, large_disturbances
from sysid.physics.effects import Effect

VANISHED = 1e-3
"""Share of a large random torque below which it has vanished, and would not grow again by itself."""


def continued(
    now: Fit,
    disturbances: Disturbances | None = None,
    settings: Settings = THOROUGH,
    balance: EnergyBalance | None = None,
) -> Fit:
    """The fit of the same model and names, begun where the present one ended (see `fit_parameters`)."""
    return fit_parameters(now.samples, now.model, now.names, now, disturbances, settings, balance)


def extended(now: Fit, effects: Sequence[Effect], settings: Settings = THOROUGH) -> Fit:
    """The fit with more effects, begun where the present one ended."""
    model, names = now.model, list(now.names)
    for effect in effects:
        model = model.with_effect(effect)
        names += model.names_of(effect.name)
    return fit_parameters(now.samples, model, names, now, settings=settings)


def exchanged(now: Fit, old: Collection[str], effect: Effect) -> Fit:
    """The fit with an effect in the place of others, begun at the numbers and the motion of the present one."""
    model = now.model
    for name in old:
        model = model.without_effect(name) if name in model.effect_names else model
    model = model.with_effect(effect)
    names = [*(n for n in now.names if n in model.parameters), *model.names_of(effect.name)]
    return fit_parameters(now.samples, model, names, now)


def settled(fit: Fit) -> Fit:
    """A quick fit continued until it converges; if it does not, the likelier of it and a fit begun anew at its numbers.

    The correlation times stay, since the numbers were judged under them and would be others under the default ones.
    """
    after = continued(fit)
    if after.converged:
        return after
    large = large_disturbances(fit.samples).with_memory(fit.disturbances.T)
    anew = fit_parameters(fit.samples, fit.model, fit.names, disturbances=large, balance=fit.balance)
    return min(after, anew, key=lambda f: f.deviance)


def with_energy_balance(fit: Fit) -> Fit:
    """The fit with the energy balance read beside it, if it is one of free swings and needs a random torque."""
    if fit.undisturbed or fit.model.damping in fit.names:
        return fit
    return balanced(fit, EnergyBalance.of(fit.samples, fit.model))


def balanced(fit: Fit, balance: EnergyBalance | None) -> Fit:
    """The fit with this energy balance read beside it; the same fit if there is none."""
    return fit if balance is None else continued(fit, balance=balance)


def reduced(now: Fit, name: str, settings: Settings = THOROUGH) -> Fit:
    """The fit without an effect, begun where the present one ended. Beside an energy balance, whose search began with
    a random torque, one that has vanished begins anew, since the model may lack something then."""
    model, s = now.model.without_effect(name), 1.5 * now.disturbances.s
    large = large_disturbances(now.samples).s
    vanished = now.balance is not None and s < VANISHED * large
    loose = replace(now.disturbances, s=0.1 * large if vanished else s)
    return fit_parameters(now.samples, model, [n for n in now.names if n in model.parameters], now, loose, settings)


def without_free(now: Fit, effects: Collection[str], settings: Settings = THOROUGH) -> Fit:
    """The fit without those of these effects that have free numbers; `now` if there are none."""
    free = {now.model.parameters[n].owner for n in now.names}
    for name in effects:
        if name in free:
            now = reduced(now, name, settings)
    return now
