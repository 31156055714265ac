"""Auto-tuned transfer: a network says of each parameter whether it is too high or too low, and a search follows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.special import expit

from policies.environments import task
from policies.environments.randomization import Band
from policies.evaluation import Policy
from study.strategies.bayes_sim import played, statistics
from study.strategies.episode_network import EpisodeNetwork
from study.strategies.readings import reads_angles
from study.strategies.strategy import Dialogue, Situation, Strategy, Train, Try
from study.trials.training_setup import TrainingSetup
from sysid.physics.ops import Array


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
        starts = np.array([task.start_state(rng) for _ in values]).T
        return played(situation, policy, situation.model(values), starts, whole)[0], values

    def taught(self, situation: Situation, seen: Array, values: Array) -> EpisodeNetwork:
        """The network, taught with random candidates for each of the episodes: log odds that one is too high."""
        low, high = situation.bounds.T
        seen, values = (np.repeat(own, self.candidates, axis=0) for own in (seen, values))
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
