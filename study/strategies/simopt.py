"""SimOpt: the distribution of the parameters moves until simulated episodes look like real ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar

from policies.environments.randomization import Posterior
from policies.evaluation import rollout
from study.strategies.readings import reads_angles, smoothed
from study.strategies.strategy import Dialogue, Situation, Strategy, Train, TrainedAgent, Tried, Try
from study.trials.training_setup import TrainingSetup
from sysid.physics.ops import Array


@dataclass(frozen=True)
class SimOpt(Strategy):
    """Chebotar et al., "Closing the sim-to-real loop", ICRA 2019.

    A policy is trained on a normal distribution of the parameters and played on the plant; samples of the distribution
    are simulated under the same policy from the same starts, and relative entropy policy search moves the distribution
    to those whose episodes are nearest, within a bound on the Kullback-Leibler divergence. Again, up to `rounds` times.

    kl         the bound of a step [nats]; steps: of the search, a round
    samples    of the distribution, a step
    sd         of the first distribution, about the prior, as a share of the plausible range
    blur       [samples] sd of the Gaussian filter over the differences, as in the source

    Changed: the agent of every round is trained from nothing; the starts are what the smoothed readings say;
    observations are compared as (cos theta, sin theta, theta_dot / 8), or the speed alone where that was read. The
    bound is that of SimuRLacra's script for SimOpt, which takes 5 steps of 500 samples a round.
    """

    kl: float = 1.0
    steps: int = 3
    rounds: int = 5
    samples: int = 200
    sd: float = 0.2
    blur: float = 5.0
    short: ClassVar[str] = "SimOpt"
    source: ClassVar[str] = "Chebotar 2019"
    group: ClassVar[str] = "adapted"
    in_rounds: ClassVar[bool] = True

    def spend(self, situation: Situation) -> Dialogue:
        """Rounds of training, playing and steps of the distribution, then training on the last one."""
        mean, bounds = situation.believed, situation.bounds
        covariance = np.diag((self.sd * (bounds[:, 1] - bounds[:, 0])) ** 2)
        for share in situation.rounds(self.rounds):
            (agent,) = yield Train((setup_of(situation, mean, covariance),))
            tried = yield Try(agent, share, at_rest=False)
            for _ in range(self.steps):
                drawn = situation.rng.multivariate_normal(mean, covariance, self.samples)
                drawn = np.clip(drawn, bounds[:, 0], bounds[:, 1])
                weights = reps_weights(-self.discrepancy(situation, agent, tried, drawn), self.kl)
                mean, covariance = weighted_normal(drawn, weights)
        return setup_of(situation, mean, covariance)

    def discrepancy(self, situation: Situation, agent: TrainedAgent, tried: Tried, drawn: Array) -> Array:
        """How unlike the real episodes those of parameters (S, P) are: (S,), the mean of L1 and squared L2 norms."""
        discrepancies = np.zeros(len(drawn))
        for record in tried.records:
            theta, theta_dot = smoothed(record, situation.sensor)
            starts = np.full(len(drawn), theta[0]), np.full(len(drawn), theta_dot[0])
            seen = rollout(agent.policy, situation.model(drawn), *starts, horizon=len(theta))
            situation.simulated += seen.u.size
            whole = reads_angles(record.theta)
            off = observed(seen.theta, seen.theta_dot, whole) - observed(theta[:, None], theta_dot[:, None], whole)
            off = gaussian_filter1d(off, self.blur, axis=1)
            discrepancies += np.mean(np.abs(off) + off**2, axis=(0, 1)) / len(tried.records)
        return discrepancies


def setup_of(situation: Situation, mean: Array, covariance: Array) -> TrainingSetup:
    """Training on a normal distribution of the parameters, clipped to their bounds."""
    rows = tuple(map(tuple, covariance.tolist()))
    return TrainingSetup(situation.prior, Posterior(situation.names, tuple(mean.tolist()), rows))


def observed(theta: Array, theta_dot: Array, whole: bool) -> Array:
    """Channels (C, N, E) that are compared."""
    return np.array([np.cos(theta), np.sin(theta), theta_dot / 8.0] if whole else [theta_dot / 8.0])


def reps_weights(returns: Array, kl: float) -> Array:
    """Weights (S,) of samples: the most return within a divergence of `kl` from equal weights.

        w_i ~ exp(R_i / eta),   eta = argmin eta kl + eta log mean exp(R_i / eta)

    Peters, Muelling and Altun, "Relative entropy policy search", AAAI 2010.
    """
    spread = np.ptp(returns)
    if spread == 0.0:
        return np.full(len(returns), 1.0 / len(returns))
    scaled = (returns - np.max(returns)) / spread

    def dual(log_eta: float) -> float:
        eta = np.exp(log_eta)
        return float(eta * kl + eta * np.log(np.mean(np.exp(scaled / eta))))

    eta = np.exp(minimize_scalar(dual, bounds=(-9.0, 9.0), method="bounded", options={"xatol": 1e-6}).x)
    weights = np.exp(scaled / eta)
    return weights / np.sum(weights)


def weighted_normal(samples: Array, weights: Array) -> tuple[Array, Array]:
    """Mean (P,) and covariance (P, P) of weighted samples; no sd falls below 1e-3."""
    mean = weights @ samples
    off = samples - mean
    return mean, (off * weights[:, None]).T @ off + 1e-3**2 * np.eye(samples.shape[1])
