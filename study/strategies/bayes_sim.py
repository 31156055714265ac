"""BayesSim: the posterior of the parameters given statistics of the rollouts, learned from simulations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from policies.environments import task
from policies.environments.randomization import Mixture
from study.strategies.readings import reads_angles, sensed, smooth, summary_statistics
from study.strategies.strategy import Dialogue, Play, Situation, Strategy
from study.trials.training_setup import TrainingSetup
from sysid import Record, simulate
from sysid.physics.ops import Array


@dataclass(frozen=True)
class BayesSim(Strategy):
    """Ramos, Possas and Fox, "BayesSim: adaptive domain randomization via probabilistic inference", RSS 2019.

    A mixture density network maps summary statistics to a mixture of normals over the parameters; it is trained on
    simulations of parameters from the prior range, and asked for the statistics of the real rollouts. The agent trains
    on draws from its answer.

    simulations   sets of parameters, each played as often as there are rollouts
    components    of the mixture, with full covariances; draws: that the agent trains on

    Changed: statistics are means over the rollouts; simulated readings have the sensor's noise, and all are smoothed.
    SimuRLacra's script for a pendulum has five components too, and three rounds of 200 simulations, each drawn from the
    answer of the one before, in place of 1,000 at once.
    """

    simulations: int = 1000
    components: int = 5
    width: int = 32
    epochs: int = 1500
    draws: int = 100
    short: ClassVar[str] = "BayesSim"
    source: ClassVar[str] = "Ramos 2019"
    group: ClassVar[str] = "adapted"

    def spend(self, situation: Situation) -> Dialogue:
        records = yield Play(situation.budget)
        drawn = self.posterior(situation, records)
        return TrainingSetup(situation.prior, Mixture(tuple(map(situation.named, drawn))))

    def posterior(self, situation: Situation, records: Sequence[Record]) -> Array:
        """Draws (D, P) of the parameters given the records, within their bounds."""
        low, high = situation.bounds.T
        values = situation.rng.uniform(low, high, (self.simulations, len(low)))
        seen = np.mean([statistics(situation, r.u, r.theta, r.theta_dot) for r in records], axis=0)
        whole = reads_angles(records[0].theta)
        simulated = self._simulated(situation, values, [len(r.u) for r in records], whole)
        network = DensityNetwork(self.components, self.width, self.epochs)
        network.fit(simulated, (values - low) / (high - low), situation.rng)
        drawn = low + network.sample(seen, 50 * self.draws, situation.rng) * (high - low)
        inside = drawn[np.all((drawn >= low) & (drawn <= high), axis=1)]
        return (inside if len(inside) >= self.draws else np.clip(drawn, low, high))[: self.draws]

    def _simulated(self, situation: Situation, values: Array, lengths: Sequence[int], whole: bool) -> Array:
        """Statistics (S, F) of as many rollouts of every set of parameters as there are real ones."""
        total, rng, model = 0.0, situation.rng, situation.model(values)
        for steps in lengths:
            u = rng.uniform(-situation.prior.u_max, situation.prior.u_max, (len(values), steps))
            theta, theta_dot = task.draw_start_states([rng] * len(values))
            run = simulate(model, u, theta, theta_dot)
            situation.simulated += u.size
            seen = sensed(run.theta, run.theta_dot, situation.sensor, whole, rng)
            total = total + statistics(situation, u, *seen) / len(lengths)
        return np.asarray(total)


def statistics(situation: Situation, u: Array, theta: Array, theta_dot: Array) -> Array:
    """Of readings (..., N+1) under torques (..., N), smoothed; angles enter where they were read all the time."""
    angle, speed = smooth(theta, theta_dot, situation.sensor, situation.prior.dt)
    return summary_statistics(u, speed, angle if reads_angles(theta) else None)


class DensityNetwork:
    """A mixture density network: p(y | x) = sum_k pi_k(x) N(y; mu_k(x), (L_k L_k')^-1), L_k lower triangular.

    One hidden layer, trained by maximum likelihood until held-out pairs, a fifth, become less likely; what was best for
    them is kept. Bishop, "Mixture density networks", 1994.
    """

    def __init__(self, components: int, width: int, epochs: int) -> None:
        self.K, self.width, self.epochs = components, width, epochs

    def fit(self, x: Array, y: Array, rng: np.random.Generator) -> None:
        """Train on pairs x (N, F), y (N, P)."""
        import torch

        self.P, self.shift, self.scale = y.shape[1], np.mean(x, axis=0), np.std(x, axis=0) + 1e-9
        outputs = self.K * (1 + self.P + self.P * (self.P + 1) // 2)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(rng.integers(2**31)))
            self.network = torch.nn.Sequential(
                torch.nn.Linear(x.shape[1], self.width), torch.nn.Tanh(), torch.nn.Linear(self.width, outputs)
            ).double()
        inputs, targets = torch.as_tensor((x - self.shift) / self.scale), torch.as_tensor(y)
        optimizer = torch.optim.Adam(self.network.parameters(), lr=1e-2, weight_decay=1e-4)
        apart, best, kept = len(x) // 5, -math.inf, None
        for _ in range(self.epochs):
            optimizer.zero_grad()
            (-self._log_density(inputs[apart:], targets[apart:]).mean()).backward()
            optimizer.step()
            with torch.no_grad():
                held_out = float(self._log_density(inputs[:apart], targets[:apart]).mean())
            if held_out > best:
                best, kept = held_out, {name: leaf.clone() for name, leaf in self.network.state_dict().items()}
        self.network.load_state_dict(kept)

    def _parts(self, x):
        """log pi (N, K), mu (N, K, P) and L (N, K, P, P)."""
        import torch

        logits, mean, entries = torch.split(
            self.network(x), [self.K, self.K * self.P, self.K * self.P * (self.P + 1) // 2], dim=-1
        )
        entries = entries.reshape(len(x), self.K, -1)
        rows, columns = torch.tril_indices(self.P, self.P)
        L = torch.zeros(len(x), self.K, self.P, self.P, dtype=torch.float64)
        on = torch.where(rows == columns, torch.exp(entries.clamp(-6.0, 6.0)), entries)
        L[:, :, rows, columns] = on
        return torch.log_softmax(logits, -1), mean.reshape(len(x), self.K, self.P), L

    def _log_density(self, x, y):
        import torch

        weight, mean, L = self._parts(x)
        z = (L * (y[:, None] - mean)[..., None]).sum(-2)
        log_det = torch.log(torch.diagonal(L, dim1=-2, dim2=-1)).sum(-1)
        each = weight + log_det - 0.5 * (z**2).sum(-1) - 0.5 * self.P * math.log(2.0 * math.pi)
        return torch.logsumexp(each, -1)

    def sample(self, x: Array, count: int, rng: np.random.Generator) -> Array:
        """Draws (count, P) of y given one x (F,)."""
        import torch

        with torch.no_grad():
            weight, mean, L = (
                part[0].numpy() for part in self._parts(torch.as_tensor((x - self.shift) / self.scale)[None])
            )
        chosen = rng.choice(self.K, count, p=np.exp(weight) / np.sum(np.exp(weight)))
        spread = np.linalg.inv(L).transpose(0, 2, 1)
        return mean[chosen] + np.einsum("nij,nj->ni", spread[chosen], rng.standard_normal((count, self.P)))
