"""Bayesian optimization of a function on the unit cube, to be maximised: BoTorch's process and acquisition functions.

x (N, D), y (N,) are what was tried and what came of it. Every answer is a function of these and the seed.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from study.strategies.strategy import required
from sysid.physics.ops import Array

STARTS, SAMPLES = 8, 256
"""Of the search for the largest value: local ones, and random points that these begin at."""


def scattered(count: int, dimension: int, seed: int) -> Array:
    """Points (N, D) spread evenly: Sobol's sequence, scrambled."""
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a count that is no power of two is balanced enough
        return qmc.Sobol(dimension, seed=np.random.default_rng(seed)).random(count)


def improving(x: Array, y: Array, seed: int) -> Array:
    """Where the expected improvement over the best value is largest (D,)."""
    analytic = required("botorch.acquisition.analytic", "botorch", "BayRn")
    with _seeded(seed + len(x)):
        process = _fitted(x, y)
        return _largest(analytic.LogExpectedImprovement(process, best_f=float(np.max(y))), x.shape[1])


def most_promising(x: Array, y: Array, seed: int) -> Array:
    """Where the process' mean is largest (D,)."""
    analytic = required("botorch.acquisition.analytic", "botorch", "BayRn")
    with _seeded(seed):
        return _largest(analytic.PosteriorMean(_fitted(x, y)), x.shape[1])


@contextlib.contextmanager
def _seeded(seed: int) -> Iterator[None]:
    """Torch's generator as if it began anew, and what BoTorch warns of kept quiet."""
    import torch

    with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.manual_seed(seed)
        yield


def _fitted(x: Array, y: Array) -> Any:
    """A process with BoTorch's default kernel and priors, its numbers by maximum likelihood."""
    import torch

    models = required("botorch.models", "botorch", "BayRn")
    fit = required("botorch.fit", "botorch", "BayRn").fit_gpytorch_mll
    likelihoods = required("gpytorch.mlls", "gpytorch", "BayRn")
    outcome = required("botorch.models.transforms", "botorch", "BayRn").Standardize(m=1)
    targets = torch.as_tensor(y, dtype=torch.float64)[:, None]
    process = models.SingleTaskGP(torch.as_tensor(x, dtype=torch.float64), targets, outcome_transform=outcome)
    fit(likelihoods.ExactMarginalLogLikelihood(process.likelihood, process))
    return process


def _largest(acquisition: Any, dimension: int) -> Array:
    import torch

    optimize = required("botorch.optim", "botorch", "BayRn").optimize_acqf
    cube = torch.tensor([[0.0] * dimension, [1.0] * dimension], dtype=torch.float64)
    found, _ = optimize(acquisition, bounds=cube, q=1, num_restarts=STARTS, raw_samples=SAMPLES)
    return np.round(found[0].detach().numpy(), 4)
