"""The strategies experiment as tasks: rounds of dialogues, and of populations with the agents that they wait for.

In a round every case that is not finished goes on until it waits for agents, and then all of these train, one
population a structure. Which agents train together is a function of the plan and of the rounds before, never of workers
or interruptions.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from rich.console import Console

from policies.network_policy import NetworkPolicy
from study.mismatch.experiment import OPTIMUM, TOGETHER, DesignTask
from study.mismatch.ground_truth import PRIOR, ground_truth
from study.mismatch.mismatch_results import DESIGNS, TRAININGS
from study.mismatch.trainings import AgentToTrain as Trainee
from study.mismatch.trainings import populations
from study.pipeline.executor import Brief, Link, Task
from study.pipeline.experiment import Stage, StudyExperiment
from study.pipeline.policy_files import FOLDER, read_policies
from study.pipeline.population_task import PopulationTask, left
from study.pipeline.settings import digest
from study.strategies.catalogue import strategy_class
from study.strategies.on_plant import Learner, PlantPopulation, StrategyPopulation
from study.strategies.plan import Case, StrategiesPlan
from study.strategies.plant import BudgetedPlant
from study.strategies.session import CRITICS, Finished, Waiting, advance, key_of
from study.strategies.strategies_results import STEPS, CaseRound, StrategiesResults
from study.strategies.strategy import Situation, TrainedAgent
from sysid import InvalidInput

Kept = tuple[tuple[str, str], ...]
"""Keys of agents, and the stem of the file of policies that each is in."""


@dataclass(frozen=True)
class StepTask(Brief):
    """A round of the cases of one seed on one plant; agents: what these have waited for so far."""

    plan: StrategiesPlan
    round: int
    cases: tuple[Case, ...]
    agents: Kept
    folder: Path
    activity: ClassVar[str] = "strategies"
    table: ClassVar[Any] = STEPS

    @property
    def name(self) -> str:
        plant, sensing, _, _, seed = self.cases[0]
        return f"round {self.round} on {plant} ({sensing}), seed {seed}"

    @property
    def work(self) -> float:
        return sum(0.5 + 0.3 * case.n for case in self.cases)

    def run(self, link: Link) -> list[CaseRound]:
        policies = _Policies(self.folder, dict(self.agents))
        found = []
        for case in self.cases:
            begin = time.perf_counter()
            payload = payload_of(self.plan, case, reached(self.plan, case, policies.get))
            found.append(CaseRound(*case, self.round, payload, time.perf_counter() - begin))
            link.progress(len(found) / len(self.cases))
        return found


class _Policies:
    """Policies by key, each file read once."""

    def __init__(self, folder: Path, stems: dict[str, str]) -> None:
        self.folder, self.stems, self.read = folder, stems, dict[str, NetworkPolicy]()

    def get(self, key: str) -> NetworkPolicy | None:
        if key not in self.read and key in self.stems:
            self.read |= read_policies(self.folder / FOLDER / f"{self.stems[key]}.npz")  # type: ignore[arg-type]
        return self.read.get(key)


def reached(plan: StrategiesPlan, case: Case, found: Any) -> Waiting | Finished:
    """How far a case's dialogue comes with the agents that are found. Raises InvalidInput as `advance` does."""
    kind = strategy_class(case.strategy)
    kind.check(case.strategy, case.n, case.sensing)
    plant = BudgetedPlant(ground_truth(plan.plant(case.plant)), case.sensing, case.n, case.seed)
    rng = np.random.default_rng([case.seed, int(digest(case.strategy), 16)])
    situation = Situation(PRIOR, plant.sensor, case.n, case.seed, rng)
    try:
        return advance(kind(), situation, plant, found, case.plant)
    except InvalidInput as error:
        raise InvalidInput(f"strategy {case.strategy!r} on {case.plant}, seed {case.seed}: {error}") from None


def payload_of(plan: StrategiesPlan, case: Case, came: Waiting | Finished) -> dict[str, Any]:
    """A step as plain data."""
    if isinstance(came, Waiting):
        setups = {key: setup.to_json() for key, setup in came.setups.items()}
        return {"setups": setups, "learn": came.learn}
    deployed, best = came.choice.deployed, came.choice.best
    own = deployed.key if isinstance(deployed, TrainedAgent) else key_of(deployed, case.seed)
    setups = {} if isinstance(deployed, TrainedAgent) else {own: deployed.to_json()}
    trained = {*came.keys, *setups}
    learners = sum(key.endswith(CRITICS) for key in trained)
    answer = {
        "deployed": own,
        "best": best.key if best else None,
        "observed": came.choice.observed if best else None,
        "rollouts": came.rollouts,
        "simulated": came.simulated + (len(trained) - learners) * plan.steps + learners * plan.learner_steps,
    }
    return {"setups": setups, "learn": None, "answer": answer}


@dataclass(eq=False)
class StrategiesExperiment(StudyExperiment):
    """A plan with its results."""

    plan: StrategiesPlan
    results: StrategiesResults
    checkpoint_seconds: float = 60.0

    def stages(self, console: Console) -> Iterator[Stage]:
        """Rounds of dialogues and of populations; in the first also what the optimum returns."""
        name, cases, current = f"[bold]{self.plan.name}[/]", self.plan.cases, 0
        stems: dict[str, str] = {}
        while True:
            steps = list(self._steps(current, stems))
            about = f"{name}: {len(cases)} cases, round {current + 1}"
            yield Stage(steps, f"{about}: {len(steps)} dialogues to go on with" if steps else "")
            waited = self._round(current)
            if not waited:
                return
            tasks = self._populations(waited, stems)
            stems |= {key: task.stem for task in tasks for key in task.keys}
            finished = {agent.key for agent in self.results.all(TRAININGS)}
            training = list(left(tasks, finished, lambda task: self.results.training_seconds(task.progress_key)))
            more: list[Task] = [*training, *(self._designs() if current == 0 else ())]
            agents = sum(len(task.keys) for task in training)
            yield Stage(more, f"{about}: {agents} agents to train in {len(training)} populations" if more else "")
            current += 1

    def publish(self, console: Console) -> None:
        from study.strategies.report import publish_strategies

        publish_strategies(self.plan, self.results, console)

    def _round(self, current: int) -> list[CaseRound]:
        """What was reached in that round, in the plan's order."""
        found = {step.case: step for step in self.results.all(STEPS) if step.round == current}
        return [found[case] for case in self.plan.cases if case in found]

    def _steps(self, current: int, stems: dict[str, str]) -> Iterator[StepTask]:
        """The dialogues of a round that are not known yet, of a plant and a seed together."""
        groups: dict[tuple[str, str, int], list[Case]] = defaultdict(list)
        own: dict[Case, set[str]] = defaultdict(set)
        known, answered = set(), set()
        for step in self.results.all(STEPS):
            if step.round == current:
                known.add(step.case)
            elif step.round < current:
                own[step.case] |= {*step.payload["setups"], *(step.payload["learn"] or ())[:1]}
                answered |= {step.case} if "answer" in step.payload else set()
        for case in self.plan.cases:
            if case not in known | answered:
                groups[case.plant, case.sensing, case.seed].append(case)
        for cases in groups.values():
            keys = sorted(set().union(*(own[case] for case in cases)))
            kept = tuple((key, stems[key]) for key in keys)
            yield StepTask(self.plan, current, tuple(cases), kept, self.results.folder.resolve())

    def _populations(self, waited: Sequence[CaseRound], known: dict[str, str]) -> list[PopulationTask]:
        """Of the agents that no round before waited for, each of which is run on every plant."""
        setups: dict[str, tuple[dict[str, Any], int]] = {}
        learners: dict[str, Learner] = {}
        for step in waited:
            for key, setup in step.payload["setups"].items():
                setups.setdefault(key, (setup, step.seed))
            if step.payload["learn"]:
                key, start, rollouts = step.payload["learn"]
                learners.setdefault(key, Learner(key, start, rollouts, step.seed, step.plant))
        plants = tuple(plant.name for plant in self.plan.plants)
        trainees = [Trainee(key, own, seed, plants) for key, (own, seed) in setups.items() if key not in known]
        tasks = list[PopulationTask]()
        for goes_on, plan in ((False, self.plan), (True, self.plan.of_learners)):
            own = [trainee for trainee in trainees if trainee.key.endswith(CRITICS) == goes_on]
            tasks += [StrategyPopulation(plan, g, **self.training) for g in populations(plan, own, self.results.device)]
        fresh = [learner for key, learner in learners.items() if key not in known]
        return tasks + PlantPopulation.tasks(self.plan, fresh, **self.training)

    def _designs(self) -> list[DesignTask]:
        known = {(d.plant, d.seed) for d in self.results.all(DESIGNS) if d.model == OPTIMUM}
        tasks = []
        for plant in self.plan.plants:
            seeds = [seed for seed in self.plan.seeds if (plant.name, seed) not in known]
            for i in range(0, len(seeds), TOGETHER):
                tasks.append(DesignTask(self.plan, plant.name, tuple(seeds[i : i + TOGETHER]), (), ()))
        return tasks
