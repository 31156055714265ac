"""Agents that train side by side on setups, and are run on hidden plants.

Every different setup and seed is trained once. Agents train together whose machines differ in numbers alone. Which do
is a function of the setups, never of workers or of what is left.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from policies import Population
from policies.evaluation import batch_returns, fresh_start_states
from policies.training.program import population_of
from study.pipeline.population_task import PopulationTask, training_settings
from study.pipeline.settings import device_type
from study.pipeline.tables import ResultTable
from study.pipeline.versions import versions
from study.trials.ground_truth import ground_truth
from study.trials.hidden_plant import TrainingPlan
from study.trials.training_setup import TrainingSetup, together, training_setup_of


@dataclass(frozen=True)
class Trained:
    """A trained agent: returns (E,) by hidden plant; curve: (env steps done, return) of the training episodes."""

    key: str
    returns: dict[str, tuple[float, ...]]
    curve: tuple[tuple[int, float], ...]
    versions: dict[str, str]
    seconds: float


TRAININGS = ResultTable("trainings", Trained, "key TEXT, returns TEXT, curve TEXT, versions TEXT, seconds REAL", keys=1)


@dataclass(frozen=True)
class AgentToTrain:
    """One agent: what it trains on (TrainingSetup.to_json), its seed, and the hidden plants that it is run on."""

    key: str
    setup: dict[str, Any]
    seed: int
    plants: tuple[str, ...]


def populations(
    plan: TrainingPlan, agents: Sequence[AgentToTrain], device: str = "cpu"
) -> list[tuple[AgentToTrain, ...]]:
    """Agents that train together: of one structure, on a CPU at most plan.agents."""
    groups: dict[str, list[AgentToTrain]] = {}
    for agent in agents:
        groups.setdefault(_structure(training_setup_of(agent.setup)), []).append(agent)
    size = plan.agents if device_type(device) == "cpu" else len(agents)
    return [tuple(group[i : i + size]) for group in groups.values() for i in range(0, len(group), size)]


def _structure(setup: TrainingSetup) -> str:
    """What the machines of agents that train together share: everything but the numbers that are drawn."""
    data, drawn = setup.to_json(), sorted(setup.drawn.sample(np.random.default_rng(0), setup.model))
    numbers = {name: float(p.value) for name, p in setup.model.parameters.items() if name not in drawn}
    effects = [[e["name"], e.get("settings")] for e in data["model"]["effects"]]
    return json.dumps([effects, sorted(data["outside"]), bool(data["learned"]), numbers, drawn], sort_keys=True)


@dataclass(frozen=True)
class AgentPopulation(PopulationTask):
    """Agents of one structure."""

    plan: TrainingPlan
    agents: tuple[Any, ...]
    table: ClassVar[Any] = TRAININGS

    @property
    def name(self) -> str:
        return f"population {hashlib.sha256(' '.join(self.keys).encode()).hexdigest()[:12]}"

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(agent.key for agent in self.agents)

    def population(self) -> Population:
        setups = [training_setup_of(agent.setup) for agent in self.agents]
        drawn, seeds = [setup.drawn for setup in setups], [agent.seed for agent in self.agents]
        machine = together(setups, self.device)
        return population_of(machine, drawn, seeds, training_settings(self.plan), self.device, self.plan.history)

    def answers(self, population: Population, seconds: float) -> list[Trained]:
        """The trained agents on the hidden plants, in order."""
        policies, found = population.policies(), versions()
        reached: list[dict[str, tuple[float, ...]]] = [{} for _ in self.agents]
        for plant in self.plan.plants:
            there = [a for a, agent in enumerate(self.agents) if plant.name in agent.plants]
            if not there:
                continue
            starts = [fresh_start_states(self.agents[a].seed, self.plan.episodes) for a in there]
            own, machine = [policies[a] for a in there], ground_truth(plant)
            rows = batch_returns(own, machine, *map(np.array, zip(*starts, strict=True)))
            for a, row in zip(there, rows, strict=True):
                reached[a][plant.name] = tuple(row.tolist())
        return [
            Trained(agent.key, own, tuple((int(step), float(value)) for step, value in curve), found, seconds)
            for agent, own, curve in zip(self.agents, reached, population.curves, strict=True)
        ]
