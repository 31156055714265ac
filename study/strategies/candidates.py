"""Strategies that compare candidates by the return of an agent that was trained on each.

A candidate is a band, of +- w about a centre: x in the unit cube is (m, l, w), m and l within their bounds and w from 0
to 0.5. Its agent plays one episode on the plant, from rest hanging down: a machine that starts alike returns alike, and
one rollout compares two policies.

Bayesian optimization proposes points of the cube from what was tried, x (N, D), and what came of it, y (N,): BoTorch's
process and acquisition functions. Every answer of it is a function of these and the seed.
"""

from __future__ import annotations

import warnings
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from policies.environments.randomization import Band
from study.strategies.strategy import Choice, Dialogue, Situation, Strategy, Train, TrainedAgent, Try
from study.trials.training_setup import TrainingSetup
from sysid.data.files import check_installed
from sysid.physics.ops import Array

DIGITS = 4
"""Of a candidate's coordinates, so that the last bits of a library do not make another agent."""
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
    return _largest("LogExpectedImprovement", x, y, seed + len(x), best_f=float(np.max(y)))


def most_promising(x: Array, y: Array, seed: int) -> Array:
    """Where the process' mean is largest (D,)."""
    return _largest("PosteriorMean", x, y, seed)


def _largest(acquisition: str, x: Array, y: Array, seed: int, **options: float) -> Array:
    """Where BoTorch's acquisition of that name is largest, of a process with its default kernel and priors, the numbers
    of which are the likeliest."""
    check_installed("botorch", "strategies", "BayRn")
    import torch
    from botorch.acquisition import analytic
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from botorch.models.transforms import Standardize
    from botorch.optim import optimize_acqf
    from gpytorch.mlls import ExactMarginalLogLikelihood

    points, values = (torch.as_tensor(given, dtype=torch.float64) for given in (x, y[:, None]))
    cube = torch.tensor([[0.0], [1.0]], dtype=torch.float64).expand(2, x.shape[1])
    with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.manual_seed(seed)
        process = SingleTaskGP(points, values, outcome_transform=Standardize(m=1))
        fit_gpytorch_mll(ExactMarginalLogLikelihood(process.likelihood, process))
        sought = getattr(analytic, acquisition)(process, **options)
        best, _ = optimize_acqf(sought, bounds=cube, q=1, num_restarts=STARTS, raw_samples=SAMPLES)
    return np.round(best[0].detach().numpy(), DIGITS)


WIDEST = 0.5


def band(situation: Situation, x: Array) -> TrainingSetup:
    """What a candidate trains on."""
    low, high = situation.bounds.T
    x = np.clip(np.round(x, DIGITS), 0.0, 1.0)
    center = situation.named(low + x[:-1] * (high - low))
    return TrainingSetup(situation.prior, Band(center, WIDEST * float(x[-1])))


def unit(situation: Situation, w: float) -> Array:
    """Where the prior with a band of w is."""
    low, high = situation.bounds.T
    return np.append((situation.believed - low) / (high - low), w / WIDEST)


def tried(situation: Situation, xs: Array) -> Generator[Any, Any, tuple[list[TrainedAgent], Array]]:
    """Agents of candidates (C, D), trained side by side, and what each returned (C,)."""
    agents = yield Train(tuple(band(situation, x) for x in xs))
    returns = []
    for agent in agents:
        returns.append((yield Try(agent)).mean)
    return list(agents), np.array(returns)


@dataclass(frozen=True)
class BayRn(Strategy):
    """Muratore et al., "Data-efficient domain randomization with Bayesian optimization", RA-L 2021.

    A Gaussian process over candidates and their returns; the next candidate has the largest expected improvement. In
    the end the agent is trained where the process has its largest mean, as the source does. BoTorch does both.

    begin    random candidates before the first proposal (quasi-random; the same on all plants)
    Changed: the distributions are bands in place of normals of every parameter, and one rollout rates a candidate,
    where the source averages several from random starts. SimuRLacra's scripts for BayRn take the same acquisition,
    begin with up to ten candidates, and search it from 500 of 1,000 points where 8 of 256 do for three numbers.
    """

    begin: int = 4
    short: ClassVar[str] = "BayRn"
    source: ClassVar[str] = "Muratore 2021"
    group: ClassVar[str] = "compared"
    in_rounds: ClassVar[bool] = True
    least: ClassVar[int] = 5

    def spend(self, situation: Situation) -> Dialogue:
        """A first set of candidates, then one after the other where improvement is expected, until none is left."""
        x = scattered(self.begin, len(situation.names) + 1, situation.seed)
        agents, returns = yield from tried(situation, x)
        while len(x) < situation.budget:
            proposed = improving(x, returns, situation.seed)
            more, values = yield from tried(situation, proposed[None])
            x, returns, agents = np.vstack([x, proposed]), np.append(returns, values), agents + more
        best = int(np.argmax(returns))
        promising = most_promising(x, returns, situation.seed)
        return Choice(band(situation, promising), agents[best], float(returns[best]))


@dataclass(frozen=True)
class CrossEntropy(Strategy):
    """Vuong et al., "How to pick the domain randomization parameters for sim-to-real transfer of reinforcement learning
    policies?", 2019: the cross-entropy method over the distribution, by the returns of agents trained on it.

    candidates of a generation, of which the `elite` best make the next one's normal distribution; sd of the first one
    about the prior, in the unit cube. In the end the agent is trained at the mean of the last elite.
    Changed: the source has 12 or more distributions a generation; so many rollouts are not to be had here.
    """

    candidates: int = 5
    elite: int = 2
    sd: float = 0.25
    narrowest: float = 0.02
    short: ClassVar[str] = "cross-entropy"
    source: ClassVar[str] = "Vuong 2019"
    group: ClassVar[str] = "compared"
    in_rounds: ClassVar[bool] = True
    least: ClassVar[int] = 5

    def spend(self, situation: Situation) -> Dialogue:
        """Generations of candidates, each about the elite of the one before."""
        mean, sd = unit(situation, 0.1), np.full(len(situation.names) + 1, self.sd)
        best: tuple[float, TrainedAgent | None] = -np.inf, None
        for _ in range(situation.budget // self.candidates):
            x = self.generation(mean, sd, situation.rng)
            agents, returns = yield from tried(situation, x)
            mean, sd = self.refitted(x, returns)
            k = int(np.argmax(returns))
            best = max(best, (float(returns[k]), agents[k]), key=lambda pair: pair[0])
        return Choice(band(situation, mean), best[1], best[0])

    def generation(self, mean: Array, sd: Array, rng: np.random.Generator) -> Array:
        """Candidates (C, D) within the unit cube."""
        return np.clip(mean + sd * rng.standard_normal((self.candidates, len(mean))), 0.0, 1.0)

    def refitted(self, x: Array, returns: Array) -> tuple[Array, Array]:
        """Mean and sd of the elite."""
        elite = x[np.argsort(-returns, kind="stable")[: self.elite]]
        return np.mean(elite, axis=0), np.maximum(np.std(elite, axis=0), self.narrowest)
