"""Agents that train side by side on setups or learn on a plant, and are run on hidden plants.

Every different setup and seed is trained once. Agents train together whose machines differ in numbers alone. Which do
is a function of the setups, never of workers or of what is left.

An agent that learns on a plant moves it in the steps that every agent trains on (25 ms), an episode a rollout, with an
update a step, as in simulation. One that goes on learning begins with the actor, the critics and the temperature that
it had; its first episode fills the memory. Its policy acts on the state, as everywhere.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from policies import Population, SACPopulation, SHACPopulation, SHACSettings
from policies.environments import task
from policies.environments.randomization import Fixed
from policies.evaluation import batch_returns, fresh_start_states
from study.pipeline.population_task import PopulationTask, sac_settings
from study.pipeline.settings import digest, partition, versions
from study.pipeline.tables import ResultTable
from study.strategies.session import CRITICS
from study.strategies.trial_plan import TrialPlan
from study.trials.ground_truth import ground_truth, oracle
from study.trials.hidden_plant import HiddenPlant
from study.trials.training_setup import TrainingSetup, together, training_setup_of


@dataclass(frozen=True)
class Trained:
    """A trained agent: returns (E,) by hidden plant."""

    key: str
    returns: dict[str, tuple[float, ...]]
    versions: dict[str, str]
    seconds: float


TRAININGS = ResultTable("trainings", Trained, "key TEXT, returns TEXT, versions TEXT, seconds REAL", keys=1)


@dataclass(frozen=True)
class AgentToTrain:
    """One agent: what it trains on (TrainingSetup.to_json), and its seed."""

    key: str
    setup: dict[str, Any]
    seed: int


def populations(plan: TrialPlan, agents: Sequence[AgentToTrain], device: str = "cpu") -> list[tuple[AgentToTrain, ...]]:
    """Agents that train together: of one structure, on a CPU at most plan.agents."""
    groups: dict[str, list[AgentToTrain]] = {}
    for agent in agents:
        groups.setdefault(_structure(training_setup_of(agent.setup)), []).append(agent)
    return [population for group in groups.values() for population in partition(group, plan.agents, device)]


def _structure(setup: TrainingSetup) -> str:
    """What the machines of agents that train together share: everything but the numbers that are drawn."""
    data, drawn = setup.to_json(), sorted(setup.drawn.sample(np.random.default_rng(0), setup.model))
    numbers = {name: float(p.value) for name, p in setup.model.parameters.items() if name not in drawn}
    effects = [[e["name"], e.get("settings")] for e in data["model"]["effects"]]
    return json.dumps([effects, sorted(data["outside"]), bool(data["learned"]), numbers, drawn], sort_keys=True)


NETWORKS = "networks"
"""Folder of the critics of agents that go on learning on a plant."""

WARM_UP = 200
"""Steps before the first update of an agent that goes on learning: an episode, with its own actions."""


def networks_of(population: SACPopulation, a: int) -> dict[str, torch.Tensor]:
    """Actor, critics, targets and temperature of agent a, as they stand in the population."""
    loss = population.loss
    leaves = {f"actor{i}": leaf[a] for i, leaf in enumerate(loss.actor_leaves)}
    for name, tensors in (("critic", loss.critic_leaves), ("target", loss.target_leaves)):
        leaves |= {f"{name}{i}": leaf[:, a] for i, leaf in enumerate(tensors)}
    return {name: leaf.detach() for name, leaf in {**leaves, "log_alpha": loss.log_alpha[a]}.items()}


class GoesOnLearning(SACPopulation):
    """A population whose first steps, before any update, take its own actions and not uniform ones."""

    def _explore(self) -> None:
        self._move(self.loss.act(self._seen(noise=self._exploration.at(self._k)[:, 1:])))
        self._k.add_(1)


@dataclass(frozen=True)
class AgentPopulation(PopulationTask):
    """Agents of one structure, run on every plant of the plan; of some the networks are kept."""

    plan: TrialPlan
    agents: tuple[Any, ...]
    table: ClassVar[Any] = TRAININGS

    @property
    def name(self) -> str:
        return f"population {hashlib.sha256(' '.join(self.keys).encode()).hexdigest()[:12]}"

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(agent.key for agent in self.agents)

    @property
    def plants(self) -> tuple[HiddenPlant, ...]:
        """The hidden plants that they are run on."""
        return self.plan.plants

    def population(self) -> Population:
        """The agents on the machines and draws of their setups, before their first step."""
        setups = [training_setup_of(agent.setup) for agent in self.agents]
        drawn, seeds = [setup.drawn for setup in setups], [agent.seed for agent in self.agents]
        machine, plan = together(setups, self.device), self.plan
        if plan.algorithm == "sac":
            return SACPopulation(machine, drawn, seeds, sac_settings(plan), self.device, plan.history)
        settings = SHACSettings(hidden=plan.hidden, steps=plan.steps)
        return SHACPopulation(machine, drawn, seeds, settings, self.device, plan.history)

    def answers(self, population: Any, seconds: float) -> list[Trained]:
        """The trained agents on the hidden plants, in order."""
        for a, key in enumerate(self.keys):
            if key.endswith(CRITICS):
                (self.folder / NETWORKS).mkdir(exist_ok=True)
                _write(self.folder / NETWORKS / f"{key}.npz", networks_of(population, a))
        policies, made_with = population.policies(), versions()
        reached: list[dict[str, tuple[float, ...]]] = [{} for _ in self.agents]
        starts = [fresh_start_states(agent.seed, self.plan.episodes) for agent in self.agents]
        states = [np.array(column) for column in zip(*starts, strict=True)]
        for plant in self.plants:
            for returns, row in zip(reached, batch_returns(policies, ground_truth(plant), *states), strict=True):
                returns[plant.name] = tuple(row.tolist())
        return [Trained(key, returns, made_with, seconds) for key, returns in zip(self.keys, reached, strict=True)]


@dataclass(frozen=True)
class Learner:
    """An agent that learns on a plant; start: the key of the one whose networks it begins with, or ""."""

    key: str
    start: str
    rollouts: int
    seed: int
    plant: str


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
        return [cls(plan, tuple(group), **training) for group in groups.values()]

    @property
    def name(self) -> str:
        return f"learners {digest(self.keys)[:12]}"

    @property
    def plants(self) -> tuple[HiddenPlant, ...]:
        return (self.plan.plant(self.agents[0].plant),)

    @property
    def settings(self) -> TrialPlan:
        return dataclasses.replace(self.plan, algorithm="sac", steps=self.agents[0].rollouts * task.HORIZON)

    def population(self) -> Population:
        """The learners on their hidden plant, with the networks that they begin with."""
        model = oracle(self.plants[0])
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
