"""The strategies experiment as tasks: rounds of dialogues, and of populations with the agents that they wait for.

In a round every case that is not finished goes on until it waits for agents, and then all of these train, one
population a structure. Which agents train together is a function of the plan and of the rounds before, never of workers
or interruptions.
"""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console

from study.pipeline.database import Database
from study.pipeline.executor import BriefTask, Task
from study.pipeline.policy_files import FOLDER
from study.pipeline.population_task import PopulationTask
from study.pipeline.settings import RunOptions
from study.pipeline.stages import Stage, StudyExperiment
from study.strategies.on_plant import NETWORKS, Learner, PlantPopulation, StrategyPopulation
from study.strategies.rounds import STEPS, CaseRound, steps
from study.strategies.session import CRITICS
from study.strategies.strategies_page import publish_strategies
from study.strategies.strategies_plan import Case, StrategiesPlan
from study.trials.designs import DESIGNS, design_tasks
from study.trials.populations import TRAININGS, AgentToTrain, populations

OUTPUTS = (
    "study.json", "cases.csv", "outcomes.csv", "contrasts.csv", "report.html", "returns.png", "simulated.png",
    FOLDER, NETWORKS,
)  # fmt: skip
"""What the experiment writes beside its database; never over files of somebody else."""


@contextlib.contextmanager
def open_experiment(plan: StrategiesPlan, options: RunOptions) -> Iterator[StudyExperiment]:
    """The experiment over the open folder of its results, of all the plan's strategies or those that were chosen."""
    plan = plan.with_strategies(options.strategies) if options.strategies else plan
    with Database(options.folder, plan, (STEPS, TRAININGS, DESIGNS), OUTPUTS, options.device) as results:
        yield StrategiesExperiment(plan, results, options.checkpoint_seconds)


@dataclass(eq=False)
class StrategiesExperiment(StudyExperiment):
    """A plan with its results."""

    plan: StrategiesPlan
    results: Database
    checkpoint_seconds: float = 60.0

    def stages(self, console: Console) -> Iterator[Stage]:
        """Rounds of dialogues and of populations; in the first also what the optimum returns."""
        name, current, stems = f"[bold]{self.plan.name}[/]: {len(self.plan.cases)} cases", 0, dict[str, str]()
        while True:
            dialogues, about = list(self._dialogues(current, stems)), f"{name}, round {current + 1}"
            yield Stage(dialogues, f"{about}: {len(dialogues)} dialogues to go on with" if dialogues else "")
            waited = self._round(current)
            if not waited:
                return
            tasks = self._populations(waited, stems)
            stems |= {key: task.stem for task in tasks for key in task.keys}
            training = self.unfinished(tasks, TRAININGS)
            more: list[Task] = [*training, *(design_tasks(self.plan, self.results) if current == 0 else ())]
            agents = sum(len(task.keys) for task in training)
            yield Stage(more, f"{about}: {agents} agents to train in {len(training)} populations" if more else "")
            current += 1

    def publish(self, console: Console) -> None:
        publish_strategies(self.plan, self.results, console)

    def _round(self, current: int) -> list[CaseRound]:
        """What was reached in that round, in the plan's order."""
        found = {step.case: step for step in self.results.all(STEPS) if step.round == current}
        return [found[case] for case in self.plan.cases if case in found]

    def _dialogues(self, current: int, stems: dict[str, str]) -> Iterator[BriefTask]:
        """The dialogues of a round that are not known yet, of a plant and a seed together."""
        groups: dict[tuple[str, str, int], list[Case]] = defaultdict(list)
        own: dict[Case, set[str]] = defaultdict(set)
        known = set()
        for step in self.results.all(STEPS):
            if step.round == current or (step.round < current and "answer" in step.payload):
                known.add(step.case)
            if step.round < current:
                own[step.case] |= {*step.payload["setups"], *(step.payload["learn"] or ())[:1]}
        for case in self.plan.cases:
            if case not in known:
                groups[case.plant, case.sensing, case.seed].append(case)
        for (plant, sensing, seed), cases in groups.items():
            kept = {key: stems[key] for key in sorted(set().union(*(own[case] for case in cases)))}
            name, work = (
                f"round {current} on {plant} ({sensing}), seed {seed}",
                sum(0.5 + 0.3 * case.n for case in cases),
            )
            arguments = (self.plan, current, tuple(cases), kept, self.results.folder.resolve())
            yield BriefTask(name, "strategies", work, STEPS, steps, arguments)

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
        agents = [AgentToTrain(key, own, seed, plants) for key, (own, seed) in setups.items() if key not in known]
        tasks = list[PopulationTask]()
        for goes_on, plan in ((False, self.plan), (True, self.plan.of_learners)):
            own = [agent for agent in agents if agent.key.endswith(CRITICS) == goes_on]
            tasks += [StrategyPopulation(plan, g, **self.training) for g in populations(plan, own, self.results.device)]
        fresh = [learner for key, learner in learners.items() if key not in known]
        return tasks + PlantPopulation.tasks(self.plan, fresh, **self.training)
