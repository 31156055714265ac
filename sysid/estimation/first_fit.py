"""First fit: a model fitted from far off, when its numbers may be wrong by any factor and friction may be missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from sysid.estimation.initial_guess import coasting_guess, initial_guesses, limited_guess
from sysid.estimation.likelihood import maximum_likelihood
from sysid.estimation.linearisation import Samples
from sysid.estimation.prediction import BLOCKS, HORIZON, left_out_errors
from sysid.estimation.prediction_error import NUMBERS_GAIN, Fit, with_likely_shared_error, with_smooth_error
from sysid.estimation.refits import continued
from sysid.estimation.solver import fit_parameters
from sysid.physics.effects import CATALOGUE
from sysid.physics.effects.actuation import CoastingDrive, Saturation
from sysid.physics.model import Model

COMMON = ("viscous", "coulomb", "torque_bias")
"""Effects that a first fit adds to the plant, so that friction and an offset do not bend inertia and gravity."""
EQUAL_INERTIA = 0.05
"""Relative difference of two inertias (`_inertia_per_command`) up to which fits from two guesses have ended at the same
optimum."""
FIRST_CORRELATION_TIMES = (0.01, 0.1, 1.0)
"""Correlation times [s] of the random torque that are tried: from nearly white to the length of a prediction."""


def first_fit(samples: Samples, model: Model, names: Sequence[str]) -> Fit:
    """Fit a model from far off: first beside friction that it may lack, then by itself. Of several initial guesses, the
    fit that ends likeliest counts."""
    fits = [without_common(helped, model, names) for helped in first_fits(samples, model, names)]
    return min(fits, key=lambda fit: fit.deviance)


def first_fits(samples: Samples, model: Model, names: Sequence[str]) -> list[Fit]:
    """The fits beside common effects from each initial guess, without those that end at the same optimum as another.

    One begins beside a limit of the drive too, where a regression shows one far below the largest command. A limit that
    is reached nearly always looks like a larger inertia, and no slope leads from there to it. The same holds for a
    drive that lets the joint coast, if it was given one command and none.
    """
    fits: list[Fit] = []
    guesses = [(guess, tuple(names)) for guess in initial_guesses(model, names, samples.records, samples.sensor)]
    for beside, effect in ((limited_guess, Saturation.name), (coasting_guess, CoastingDrive.name)):
        special = beside(model, names, samples.records, samples.sensor)
        if special is not None:
            guesses.append((special, (*names, *special.names_of(effect))))
    for guess, free in guesses:
        helped = with_common(samples, guess, free)
        inertia = _inertia_per_command(helped)
        if all(abs(math.log(inertia / _inertia_per_command(other))) > EQUAL_INERTIA for other in fits):
            fits.append(helped)
    return fits


def _inertia_per_command(fit: Fit) -> float:
    """The inertia for each unit of the torque that a command brings. A log may show the actuator's number, such as k_p
    of a servo, while the inertia is known."""
    actuator = fit.model.actuator
    return fit.inertia if actuator is None else fit.inertia / float(getattr(actuator, actuator.scale))


def with_common(samples: Samples, begun: Model, names: Sequence[str]) -> Fit:
    """The fit of a model from an initial guess, beside the friction and the offset that it may lack."""
    names, given = tuple(names), begun.effect_names
    braked = begun.damping in names
    extent = samples.extent(begun)
    more: tuple[str, ...] = ()
    for kind in (CATALOGUE[name] for name in COMMON if name not in given):
        if braked and kind.brakes:
            continue
        effect = kind().at_beginning(extent)
        begun = begun.with_effect(effect)
        more += begun.names_of(effect.name)
    fitted = fit_parameters(samples, begun, (*names, *more))
    return fitted if fitted.undisturbed else with_best_memory(fitted)


def without_common(near: Fit, model: Model, names: Sequence[str]) -> Fit:
    """The fit of the model by itself, begun at the numbers that it has in a fit beside friction and offset."""
    plain = model.with_numbers(names, near.model.numbers(names).tolist())
    likely = near.disturbances
    return fit_parameters(near.samples, plain, names, near, replace(likely, s=2.0 * likely.s))


def with_best_memory(fitted: Fit) -> Fit:
    """The fit with the correlation time T of the random torque that is likeliest, or with one that predicts better.

    What a machine lacks is no Gaussian process. Where slow torques and rare jolts (a gear that reverses) are missing, a
    slow random torque is likeliest, with parameters that suit the jolts. Cross-validated predictions over a second show
    which parameters are the machine's: another T is taken if they are better by more than their standard error.

    The angle of a free swing, or speeds that share an error, may have a smooth error, too, if that makes the log
    likelier by more than chance.
    """
    likely = with_likely_shared_error(fitted)
    if fitted.samples.error_channel or not fitted.samples.driven:
        begins = (likely, with_smooth_error(fitted))
        rough, smooth = (continued(fitted, disturbances) for disturbances in begins)
        if smooth.deviance < rough.deviance - NUMBERS_GAIN and smooth.errs_by_little:
            fitted, likely = smooth, smooth.disturbances
    fits = [continued(fitted, likely.with_memory(T)) for T in FIRST_CORRELATION_TIMES]
    best = min(fits, key=lambda f: f.deviance)
    errors = {f: left_out_errors(f, HORIZON, BLOCKS) for f in fits}
    for fit in sorted(fits, key=lambda f: errors[f].ratio):
        gain, sd = errors[fit].gain(errors[best])
        if gain > sd:
            return fit
    return _with_finer_memory(best)


def _with_finer_memory(fitted: Fit) -> Fit:
    """The fit with a correlation time between those that were tried, if that is likelier by more than chance. With a
    wrong one, slow or fast errors are blamed on the parameters, and their intervals are too narrow."""
    system, now = fitted.linearised.system, fitted.disturbances
    between = [T for T in (now.T / 3.0, now.T * 3.0) if FIRST_CORRELATION_TIMES[0] < T < FIRST_CORRELATION_TIMES[-1]]
    likely = maximum_likelihood(system, map(now.with_memory, between))
    if fitted.filter.deviance - system.filter(likely).deviance < NUMBERS_GAIN:
        return fitted
    return continued(fitted, likely)
