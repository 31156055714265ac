"""Populations of the experiment: agents on setups, some of whose critics are kept, and agents that learn on a plant.

An agent that learns on a plant moves it in the steps that every agent trains on (25 ms), an episode a rollout, with an
update a step, as in simulation. One that goes on learning begins with the actor, the critics and the temperature that
it had; its first episode fills the memory. Its policy acts on the state, as everywhere.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from policies import Population, SACPopulation
from policies.environments import task
from policies.environments.randomization import Fixed
from study.pipeline.population_task import PopulationTask, sac_settings
from study.pipeline.settings import digest
from study.strategies.session import CRITICS
from study.strategies.trial_plan import TrialPlan
from study.trials.ground_truth import oracle
from study.trials.populations import AgentPopulation, Trained

NETWORKS = "networks"
"""Folder of the critics of agents that go on learning on a plant."""

WARM_UP = 200
"""Steps before the first update of an agent that goes on learning: an episode, with its own actions."""


def networks_of(population: SACPopulation, a: int) -> dict[str, torch.Tensor]:
    """Actor, critics, targets and temperature of agent a, as they stand in the population."""
    loss = population.loss
    leaves = {f"actor{i}": leaf[a] for i, leaf in enumerate(loss.actor_leaves)}
    for name, own in (("critic", loss.critic_leaves), ("target", loss.target_leaves)):
        leaves |= {f"{name}{i}": leaf[:, a] for i, leaf in enumerate(own)}
    return {name: leaf.detach() for name, leaf in {**leaves, "log_alpha": loss.log_alpha[a]}.items()}


class GoesOnLearning(SACPopulation):
    """A population whose first steps, before any update, take its own actions and not uniform ones."""

    def _explore(self) -> None:
        self._move(self.policy(self._seen(noise=self._exploration.at(self._k)[:, 1:])))
        self._k.add_(1)


@dataclass(frozen=True)
class StrategyPopulation(AgentPopulation):
    """Agents of one structure, some of whose networks are kept."""

    def answers(self, population: Any, seconds: float) -> list[Trained]:
        for a, key in enumerate(self.keys):
            if key.endswith(CRITICS):
                (self.folder / NETWORKS).mkdir(exist_ok=True)
                _write(self.folder / NETWORKS / f"{key}.npz", networks_of(population, a))
        return super().answers(population, seconds)


@dataclass(frozen=True)
class Learner:
    """An agent that learns on a plant; start: the key of the one whose networks it begins with, or ""."""

    key: str
    start: str
    rollouts: int
    seed: int
    plant: str

    @property
    def plants(self) -> tuple[str, ...]:
        return (self.plant,)


@dataclass(frozen=True)
class PlantPopulation(AgentPopulation):
    """Learners on the same plant, in as many rollouts."""

    activity: ClassVar[str] = "learning on the plant"

    @classmethod
    def tasks(cls, plan: TrialPlan, learners: Sequence[Learner], **training: Any) -> list[PopulationTask]:
        """A population a plant, a number of rollouts and a kind of start."""
        groups: dict[tuple[str, int, bool], list[Learner]] = {}
        for learner in learners:
            groups.setdefault((learner.plant, learner.rollouts, bool(learner.start)), []).append(learner)
        return [cls(plan, tuple(own), **training) for own in groups.values()]

    @property
    def name(self) -> str:
        return f"learners {digest(self.keys)[:12]}"

    @property
    def settings(self) -> TrialPlan:
        return dataclasses.replace(self.plan, algorithm="sac", steps=self.agents[0].rollouts * task.HORIZON)

    def population(self) -> Population:
        model = oracle(self.plan.plant(self.agents[0].plant))
        seeds, drawn = [agent.seed for agent in self.agents], [Fixed()] * len(self.agents)
        settings = sac_settings(self.settings)
        if not self.agents[0].start:
            settings = dataclasses.replace(settings, random_steps=min(settings.random_steps, settings.steps // 2))
            return SACPopulation(model, drawn, seeds, settings, self.device, self.plan.history)
        settings = dataclasses.replace(settings, random_steps=WARM_UP)
        population = GoesOnLearning(model, drawn, seeds, settings, self.device, self.plan.history)
        for a, agent in enumerate(self.agents):
            _read(self.folder / NETWORKS / f"{agent.start}.npz", networks_of(population, a))
        return population


def _write(path: Path, networks: dict[str, torch.Tensor]) -> None:
    np.savez(path, **{name: leaf.cpu().numpy() for name, leaf in networks.items()})


def _read(path: Path, networks: dict[str, torch.Tensor]) -> None:
    """Write what was stored into networks."""
    with np.load(path, allow_pickle=False) as stored:
        for name, leaf in networks.items():
            leaf.copy_(torch.from_numpy(stored[name]))
