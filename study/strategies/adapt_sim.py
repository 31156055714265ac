"""AdaptSim: an adaptation policy, learned in simulation, moves the simulator to where policies do better."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product
from typing import ClassVar

import numpy as np

from policies.control.dynamic_programming import Grid, solve
from policies.environments import task
from policies.environments.randomization import Band
from study.strategies.bayes_sim import played, statistics
from study.strategies.episode_network import EpisodeNetwork
from study.strategies.readings import reads_angles
from study.strategies.strategy import Dialogue, Situation, Strategy, Train, Try
from study.trials.training_setup import TrainingSetup
from sysid import Model, Sensor
from sysid.physics.ops import Array

TABLE = Grid(60, 61, u=5)
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
        policy.fit(*(own.reshape(-1, own.shape[-1]) for own in (seen, places, targets)), situation.rng)
        return policy

    def _played(self, situation: Situation, values: Array, whole: bool) -> tuple[Array, Array]:
        """Statistics (S, S, E, F) of the policy of each of S sets of values on each other, and returns (S, S)."""
        rng, count = situation.rng, len(values)
        model = situation.model(np.repeat(values, self.episodes, axis=0))
        starts = np.tile([task.start_state(rng) for _ in range(self.episodes)], (count, 1)).T
        seen, returns = [], np.empty((count, count))
        for i, own in enumerate(values):
            policy = solve(situation.prior.with_parameters(situation.named(own)), TABLE)
            found, run = played(situation, policy, model, starts, whole)
            seen.append(found.reshape(count, self.episodes, -1))
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
        own = np.diag(returns)
        r = (returns - own) / np.abs(own)
        base = self.count ** np.arange(len(self.bounds))[::-1]
        after = np.rint(self.stepped(self.unit[:, None], self.steps) * (self.count - 1)).astype(int) @ base
        value = np.zeros_like(r)
        for _ in range(200):
            Q = np.moveaxis(r[after] + discount * value[after], 1, -1)
            value = np.max(Q, axis=-1)
        return np.asarray(Q)


class AdaptationPolicy:
    """What each step is worth, from statistics of episodes (N, F) and the place x (N, P) of their policy."""

    def __init__(self, levels: Levels, simulated: int, width: int = 64, epochs: int = 400) -> None:
        self.levels, self.simulated, self.network = levels, simulated, EpisodeNetwork(width, epochs)

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
