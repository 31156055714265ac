"""First fit: a model fitted from far off, where its numbers may be wrong by any factor and friction may be missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from sysid.effects import CATALOGUE
from sysid.estimation.chain import Chain
from sysid.estimation.prediction_error import Fit, Prior, fit, with_likeliest_memory
from sysid.identify.rough import rough
from sysid.model import Model
from sysid.records import extent_of

FRICTION = {"viscous": ("b", 0.02), "coulomb": ("tau_c", 0.05)}
"""What a first fit knows beside the plant, so that friction does not bend inertia and gravity: each number begins at
that share of the largest drive torque."""


def first_fit(chain: Chain, model: Model, names: Sequence[str]) -> Fit:
    """The model fitted from far off: by a regression, beside friction that it may lack, and then by itself."""
    names, extent = tuple(names), extent_of(chain.records)
    begun = rough(model, names, chain.records, chain.sensor)
    more = dict[str, float]()
    for name, (key, share) in FRICTION.items():
        if name not in {e.name for e in begun.effects}:
            begun = begun.with_effect(CATALOGUE[name]())
            more[f"{name}.{key}"] = share * (extent.u_max or float(begun.inertia()))
    helped = fit(chain, begun.with_parameters(more), (*names, *more))
    likely = helped.disturbances
    if not helped.undisturbed:
        likely = with_likeliest_memory(helped)
        helped = fit(chain, helped.model, helped.names, helped, likely)
        likely = helped.disturbances
    plain = model.with_parameters({n: float(helped.model.parameters[n].value) for n in names})
    loose = replace(likely, s=2.0 * likely.s)
    return fit(chain, plain, names, _narrowed(helped, plain, names), loose)


def _narrowed(near: Fit, model: Model, names: tuple[str, ...]) -> Fit:
    """A fit that others may begin at, of a model with fewer numbers."""
    at = [near.names.index(n) for n in names]
    prior = Prior(near.prior.mean[at], near.prior.precision[at])
    return replace(near, model=model, names=names, prior=prior)
