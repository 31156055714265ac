"""Strategies that search for the parameters as a network says, which learned from simulated episodes where to go.

auto-tuned transfer   of each parameter, whether it is too high or too low
AdaptSim              which step brings the simulator to where policies do better
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise, product
from typing import Any, ClassVar

import numpy as np
from scipy.special import expit

from policies.control.dynamic_programming import Grid, solve
from policies.environments import task
from policies.environments.randomization import Band
from policies.evaluation import Episodes, Policy, rollout
from study.strategies.bayes_sim import statistics
from study.strategies.readings import reads_angles, sensed
from study.strategies.strategy import Dialogue, Situation, Strategy, Train, Try
from study.trials.training_setup import TrainingSetup
from sysid import Model, Sensor
from sysid.physics.ops import Array


def played(situation: Situation, policy: Policy, model: Model, starts: Array, whole: bool) -> tuple[Array, Episodes]:
    """Statistics (E, F) of simulated episodes of a policy from starts (2, E), as the sensors read them; and these."""
    run = rollout(policy, model, *starts)
    situation.simulated += run.u.size
    readings = sensed(run.theta.T, run.theta_dot.T, situation.sensor, whole, situation.rng)
    return statistics(situation, run.u[:-1].T, *readings), run


class EpisodeNetwork:
    """Numbers (N, A) from statistics of episodes (N, F) and a place x (N, P) in the unit cube, by two hidden layers."""

    def __init__(self, width: int, epochs: int) -> None:
        self.width, self.epochs = width, epochs

    def fit(self, seen: Array, x: Array, targets: Array, loss: str, rng: np.random.Generator) -> None:
        """Train on targets (N, A) by a loss of torch.nn.functional, on all data at once."""
        import torch

        self.shift, self.scale = np.mean(seen, axis=0), np.std(seen, axis=0) + 1e-9
        inputs, sizes = self._inputs(seen, x), (seen.shape[1] + x.shape[1], self.width, self.width, targets.shape[1])
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(rng.integers(2**31)))
            layers = [torch.nn.Linear(a, b) for a, b in pairwise(sizes)]
            tanh = torch.nn.Tanh()
            self.network = torch.nn.Sequential(layers[0], tanh, layers[1], tanh, layers[2]).double()
        wanted, optimizer = torch.as_tensor(targets), torch.optim.Adam(self.network.parameters(), lr=1e-2)
        for _ in range(self.epochs):
            optimizer.zero_grad()
            getattr(torch.nn.functional, loss)(self.network(inputs), wanted).backward()
            optimizer.step()

    def answers(self, seen: Array, x: Array) -> Array:
        """What it says of each episode (N, F), its place x (P,) the same for all."""
        import torch

        with torch.no_grad():
            return self.network(self._inputs(seen, np.broadcast_to(x, (len(seen), x.shape[-1])))).numpy()

    def _inputs(self, seen: Array, x: Array) -> Any:
        import torch

        return torch.as_tensor(np.concatenate([(seen - self.shift) / self.scale, 2.0 * x - 1.0], axis=1))


@dataclass(frozen=True)
class AutoTuned(Strategy):
    """Du, Watkins, Darrell, Abbeel and Pathak, "Auto-tuned sim-to-real transfer", ICRA 2021.

    A policy is trained at the parameters and played on the plant. Simulated episodes of the same policy teach a network
    to tell, from an episode and a candidate, the odds that each of the candidate's parameters is above the one that the
    episode was made with; shown the real episodes, it says where to go. Again, up to `rounds` times.

    simulations   episodes of a round, each with candidates of its own; w: of the band that is trained on
    steps, pace   of the search, the first step as a share of the plausible range

    Changed: the network sees statistics of the states where the source's sees images.
    """

    rounds: int = 5
    simulations: int = 1000
    candidates: int = 8
    steps: int = 60
    pace: float = 0.1
    w: float = 0.1
    short: ClassVar[str] = "auto-tuned transfer"
    source: ClassVar[str] = "Du 2021"
    group: ClassVar[str] = "adapted"
    in_rounds: ClassVar[bool] = True

    def spend(self, situation: Situation) -> Dialogue:
        """Rounds of training, playing and a search that follows the network, then training where they led."""
        values = situation.believed
        for share in situation.rounds(self.rounds):
            (agent,) = yield Train((TrainingSetup(situation.prior, Band(situation.named(values), self.w)),))
            tried = yield Try(agent, share, at_rest=False)
            seen = np.array([statistics(situation, r.u, r.theta, r.theta_dot) for r in tried.records])
            whole = reads_angles(tried.records[0].theta)
            network = self.taught(situation, *self.episodes(situation, agent.policy, whole))
            values = self.searched(network, seen, values, situation.bounds)
        return TrainingSetup(situation.prior, Band(situation.named(values), self.w))

    def episodes(self, situation: Situation, policy: Policy, whole: bool) -> tuple[Array, Array]:
        """Statistics (S, F) of simulated episodes as the sensors read them, and their parameters (S, P)."""
        rng, (low, high) = situation.rng, situation.bounds.T
        values = rng.uniform(low, high, (self.simulations, len(low)))
        starts = task.draw_start_states([rng] * len(values))
        return played(situation, policy, situation.model(values), starts, whole)[0], values

    def taught(self, situation: Situation, seen: Array, values: Array) -> EpisodeNetwork:
        """The network, taught with random candidates for each of the episodes: log odds that one is too high."""
        low, high = situation.bounds.T
        seen, values = (np.repeat(array, self.candidates, axis=0) for array in (seen, values))
        tried, network = situation.rng.uniform(low, high, values.shape), EpisodeNetwork(width=32, epochs=300)
        loss = "binary_cross_entropy_with_logits"
        network.fit(seen, (tried - low) / (high - low), (tried > values).astype(float), loss, situation.rng)
        return network

    def searched(self, network: EpisodeNetwork, seen: Array, values: Array, bounds: Array) -> Array:
        """Where the network finds the parameters neither too high nor too low, in the mean of the episodes."""
        low, high = bounds.T
        x = (values - low) / (high - low)
        for step in range(self.steps):
            odds = np.mean(expit(network.answers(seen, x)), axis=0)
            x = np.clip(x + self.pace * 2.0 ** (-4.0 * step / self.steps) * (1.0 - 2.0 * odds), 0.0, 1.0)
        return low + np.round(x, 4) * (high - low)


META_TRAINING_GRID = Grid(60, 61, u=5)
"""Of the policies in meta-training: their returns are within some percent of the best."""


@dataclass(frozen=True)
class AdaptSim(Strategy):
    """Ren, Dai, Burchfiel and Majumdar, "AdaptSim: task-driven simulation adaptation for sim-to-real transfer", CoRL
    2023.

    A policy is trained at the parameters and played on the plant; an adaptation policy sees those episodes, and moves
    each parameter one step up, one down, or not at all. Again, up to `rounds` times. It was meta-trained in simulation,
    with simulated targets, for the return that follows on the target rather than for the parameters themselves.

    levels     of each parameter over its plausible range: a step leads from one to the next
    episodes   of each policy on each target in meta-training; discount: of what later steps bring
    w          of the band that is trained on

    Changed: at its smallest. The policies of meta-training are dynamic programming's, one at each pair of levels, which
    are the targets too; as the targets are known there, what a step is worth is computed on this grid, and a network
    learns it from episodes, where the source's learns both at once by Q-learning. It sees statistics of the states.
    """

    rounds: int = 5
    levels: int = 7
    episodes: int = 8
    discount: float = 0.9
    w: float = 0.1
    short: ClassVar[str] = "AdaptSim"
    source: ClassVar[str] = "Ren 2023"
    group: ClassVar[str] = "adapted"
    in_rounds: ClassVar[bool] = True

    def spend(self, situation: Situation) -> Dialogue:
        """Rounds of training, playing and one step of the adaptation policy, then training where they led."""
        values = situation.believed
        for i, share in enumerate(situation.rounds(self.rounds)):
            (agent,) = yield Train((TrainingSetup(situation.prior, Band(situation.named(values), self.w)),))
            tried = yield Try(agent, share, at_rest=False)
            whole = reads_angles(tried.records[0].theta)
            adaptation = adaptation_policy(self, situation.prior, situation.names, situation.sensor, whole)
            situation.simulated += adaptation.simulated if i == 0 else 0
            seen = np.array([statistics(situation, r.u, r.theta, r.theta_dot) for r in tried.records])
            values = adaptation.moved(seen, values)
        return TrainingSetup(situation.prior, Band(situation.named(values), self.w))

    def taught(self, situation: Situation, whole: bool) -> AdaptationPolicy:
        """The adaptation policy, meta-trained for a sensor that reads the angle always (whole) or at the start."""
        grid = Levels(situation.bounds, self.levels)
        seen, returns = self._played(situation, grid.values, whole)
        worth = grid.worth_of_steps(returns, self.discount)
        places = np.broadcast_to(grid.unit[:, None, None], (*seen.shape[:3], grid.unit.shape[1]))
        targets = np.broadcast_to(worth[:, :, None], (*seen.shape[:3], worth.shape[2]))
        policy = AdaptationPolicy(grid, situation.simulated)
        policy.fit(*(array.reshape(-1, array.shape[-1]) for array in (seen, places, targets)), situation.rng)
        return policy

    def _played(self, situation: Situation, values: Array, whole: bool) -> tuple[Array, Array]:
        """Statistics (S, S, E, F) of the policy of each of S sets of values on each other, and returns (S, S)."""
        rng, count = situation.rng, len(values)
        model = situation.model(np.repeat(values, self.episodes, axis=0))
        starts = np.tile(task.draw_start_states([rng] * self.episodes).T, (count, 1)).T
        seen, returns = [], np.empty((count, count))
        for i, parameters in enumerate(values):
            policy = solve(situation.prior.with_parameters(situation.named(parameters)), META_TRAINING_GRID)
            features, run = played(situation, policy, model, starts, whole)
            seen.append(features.reshape(count, self.episodes, -1))
            returns[i] = np.mean(run.returns.reshape(count, self.episodes), axis=1)
        return np.array(seen), returns


@cache
def adaptation_policy(
    strategy: AdaptSim, prior: Model, names: tuple[str, ...], sensor: Sensor, whole: bool
) -> AdaptationPolicy:
    """Meta-trained once for all plants and rollouts, half a minute: it has seen none of them."""
    return strategy.taught(Situation(prior, sensor, 0, 0, np.random.default_rng(0), names), whole)


@dataclass(frozen=True, eq=False)
class Levels:
    """The grid of parameters on which the adaptation policy moves: `count` levels of each of P, S = count^P in all."""

    bounds: Array
    count: int

    @cached_property
    def steps(self) -> Array:
        """The moves (A, P): each parameter down, not at all, or up."""
        return np.array(list(product((-1.0, 0.0, 1.0), repeat=len(self.bounds))))

    @cached_property
    def unit(self) -> Array:
        """The places (S, P) within the unit cube."""
        return np.array(list(product(np.linspace(0.0, 1.0, self.count), repeat=len(self.bounds))))

    @property
    def values(self) -> Array:
        """The parameters (S, P) at the places."""
        low, high = self.bounds.T
        return np.asarray(low + self.unit * (high - low))

    def stepped(self, unit: Array, step: Array) -> Array:
        """Where a step leads, within the cube."""
        return np.clip(unit + step / (self.count - 1), 0.0, 1.0)

    def worth_of_steps(self, returns: Array, discount: float) -> Array:
        """Q (S, S, A) of each step from each place, where the target is known.

            Q(i, j, a) = r(i', j) + discount max_a' Q(i', j, a'),     i' = where a leads from i

        r is the return there as a share of the target's own, (R_ij - R_jj) / |R_jj|.
        """
        own_returns = np.diag(returns)
        r = (returns - own_returns) / np.abs(own_returns)
        base = self.count ** np.arange(len(self.bounds))[::-1]
        after = np.rint(self.stepped(self.unit[:, None], self.steps) * (self.count - 1)).astype(int) @ base
        value = np.zeros_like(r)
        for _ in range(200):
            Q = np.moveaxis(r[after] + discount * value[after], 1, -1)
            value = np.max(Q, axis=-1)
        return np.asarray(Q)


class AdaptationPolicy:
    """What each step is worth, from statistics of episodes (N, F) and the place x (N, P) of their policy."""

    def __init__(self, levels: Levels, simulated: int) -> None:
        self.levels, self.simulated, self.network = levels, simulated, EpisodeNetwork(width=64, epochs=400)

    def fit(self, seen: Array, x: Array, worth: Array, rng: np.random.Generator) -> None:
        """Regression; what is learned of worth (N, A) is how far a step is from the others, not how well all do."""
        advantage = worth - np.mean(worth, axis=1, keepdims=True)
        advantage /= np.std(advantage, axis=1, keepdims=True) + 0.02
        self.network.fit(seen, x, advantage, "mse_loss", rng)

    def moved(self, seen: Array, values: Array) -> Array:
        """The values (P,) after the step that the episodes of their policy, in the mean, find worth most."""
        low, high = self.levels.bounds.T
        x = (values - low) / (high - low)
        step = self.levels.steps[int(np.argmax(np.mean(self.network.answers(seen, x), axis=0)))]
        return np.asarray(low + np.round(self.levels.stepped(x, step), 4) * (high - low))
