"""What the experiment trains: what a strategy made of its rollouts, as plain data, and agents on it side by side.

Every different setup and seed is trained once. Agents train together whose machines differ in numbers alone. Which do
is a function of the setups, never of workers or of what is left.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from policies import Population
from policies.environments.randomization import Randomization, from_json
from policies.evaluation import batch_returns, fresh_start_states
from policies.training.program import population_of
from study.mismatch.ground_truth import OUT_OF_CATALOGUE, ground_truth
from study.mismatch.mismatch_results import TRAININGS, Fitted, Trained
from study.mismatch.plan import SHARED, Plan, TrainingPlan, TrialKey
from study.mismatch.residual_network import CommandFilter, ResidualNetwork, stacked
from study.pipeline.population_task import PopulationTask, training_settings
from study.pipeline.settings import device_type, digest
from study.pipeline.versions import versions
from sysid import InvalidInput, Model
from sysid.estimation.saved_model import from_dict, to_dict


@dataclass(frozen=True, eq=False)
class TrainingSetup:
    """What an agent trains on.

    model    the machine at the centre of what is drawn; drawn: the parameters of every episode
    verdict  a diagnosis' verdict, and steps: the effects that it added; "" and () where nothing was diagnosed
    about    other numbers that were found on the way
    """

    model: Model
    drawn: Randomization
    verdict: str = ""
    steps: tuple[str, ...] = ()
    about: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain data, from which `training_setup_of` makes the same setup."""
        model, learned = apart(self.model)
        model, outside = _without_outside(model)
        return {
            "model": to_dict(model),
            "outside": outside,
            "learned": _numbers(learned),
            "drawn": self.drawn.to_json(),
            "verdict": self.verdict,
            "steps": list(self.steps),
            "about": self.about,
        }

    @property
    def key(self) -> str:
        """Sixteen hexadecimal digits that change with whatever an agent's training depends on."""
        data = self.to_json()
        return digest({name: data[name] for name in ("model", "outside", "learned", "drawn")})


def training_setup_of(data: dict[str, Any]) -> TrainingSetup:
    """The setup in plain data; raises InvalidInput for other data."""
    try:
        model = from_dict(data["model"]).model
        for name, numbers in data["outside"].items():
            model = model.with_effect(OUT_OF_CATALOGUE[name](**numbers))
        if data["learned"] is not None:
            model = _with_learned(model, data["learned"])
        return TrainingSetup(model, from_json(data["drawn"]), data["verdict"], tuple(data["steps"]), data["about"])
    except (KeyError, TypeError) as error:
        raise InvalidInput(f"no training setup ({error!r}): expected what TrainingSetup.to_json gives") from None


def _without_outside(model: Model) -> tuple[Model, dict[str, dict[str, float]]]:
    """The model without the effects that the catalogue lacks, and those as numbers."""
    outside = [e for e in model.effects if e.name in OUT_OF_CATALOGUE]
    numbers = {e.name: {name: float(p.value) for name, p in e.parameters.items()} for e in outside}
    return dataclasses.replace(model, effects=tuple(e for e in model.effects if e not in outside)), numbers


def _numbers(learned: tuple[Any, ...]) -> dict[str, Any] | None:
    """What was learned as numbers."""
    if not learned:
        return None
    taps, layers = learned[0].taps, learned[1].layers
    return {"taps": taps.tolist(), "layers": [[W.tolist(), b.tolist()] for W, b in layers]}


def _with_learned(model: Model, numbers: dict[str, Any]) -> Model:
    layers = tuple((np.array(W), np.array(b)) for W, b in numbers["layers"])
    learned = CommandFilter(np.array(numbers["taps"])), ResidualNetwork(layers, drive_max=model.u_max)
    return model.with_effect(learned[0]).with_effect(learned[1])


def apart(model: Model) -> tuple[Model, tuple[Any, ...]]:
    """The model without the two learned effects, and these; () where it has none."""
    learned = tuple(e for kind in (CommandFilter, ResidualNetwork) for e in model.effects if isinstance(e, kind))
    return dataclasses.replace(model, effects=tuple(e for e in model.effects if e not in learned)), learned


def together(setups: Sequence[TrainingSetup], device: str = "cpu") -> Model:
    """One model that carries the agents of setups of one structure: the first's, with what each has learned."""
    parts = [apart(setup.model) for setup in setups]
    model = parts[0][0]
    if parts[0][1]:
        model = dataclasses.replace(model, effects=(*model.effects, *stacked([own for _, own in parts], device)))
    return model


@dataclass(frozen=True)
class AgentToTrain:
    """One agent: what it trains on (TrainingSetup.to_json), its seed, and the hidden plants that it is run on."""

    key: str
    setup: dict[str, Any]
    seed: int
    plants: tuple[str, ...]


def agents_of(plan: Plan, fits: Sequence[Fitted]) -> tuple[dict[TrialKey, str], list[AgentToTrain]]:
    """The key of the agent behind every trial, and the agents in the order of trials; equal setups share an agent."""
    made = {f.trial: f.payload for f in fits}
    keys: dict[TrialKey, str] = {}
    agents: dict[str, AgentToTrain] = {}
    for trial in plan.trials:
        payload = made[trial]
        key = keys[trial] = f"{training_setup_of(payload).key}-{trial.seed}"
        plants = tuple(p.name for p in plan.plants) if trial.strategy in SHARED else (trial.plant,)
        known = agents.get(key)
        together = plants if known is None else tuple(dict.fromkeys((*known.plants, *plants)))
        agents[key] = AgentToTrain(key, payload, trial.seed, together)
    return keys, list(agents.values())


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
class MismatchPopulation(PopulationTask):
    """Agents of one structure."""

    plan: TrainingPlan
    agents: tuple[AgentToTrain, ...]
    table: ClassVar[Any] = TRAININGS

    @property
    def name(self) -> str:
        return f"population {hashlib.sha256(' '.join(self.keys).encode()).hexdigest()[:12]}"

    @property
    def progress_key(self) -> str:
        return self.name

    @property
    def stem(self) -> str:
        return self.name.replace(" ", "_")

    @property
    def settings(self) -> TrainingPlan:
        return self.plan

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
