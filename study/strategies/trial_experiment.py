"""An experiment of strategies as tasks: rounds of dialogues, and of populations with the agents that they wait for.

In a round every case that is not finished goes on until it waits for agents, and then all of these train, one
population a structure. Which agents train together is a function of the plan and of the rounds before, never of workers
or interruptions.
"""

from __future__ import annotations

import contextlib
import importlib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from study.pipeline.database import Database
from study.pipeline.executor import BriefTask, Task
from study.pipeline.population_task import PopulationTask
from study.pipeline.publication import PUBLISHED, publish
from study.pipeline.settings import RunOptions
from study.pipeline.stages import Stage, StudyExperiment
from study.strategies.designs import DESIGNS, design_tasks
from study.strategies.finished_cases import take_up
from study.strategies.populations import (
    NETWORKS,
    TRAININGS,
    AgentPopulation,
    AgentToTrain,
    Learner,
    PlantPopulation,
    populations,
)
from study.strategies.session import CRITICS, STEPS, CaseRound, case_rounds
from study.strategies.strategies_plan import StrategiesPlan
from study.strategies.trial_findings import FIGURE, TABLES, TrialResults
from study.strategies.trial_plan import Case, TrialPlan


@contextlib.contextmanager
def open_experiment(plan: TrialPlan, options: RunOptions) -> Iterator[StudyExperiment]:
    """The experiment over the open folder of its results, of all the plan's strategies or those that were chosen."""
    if options.strategies and isinstance(plan, StrategiesPlan):
        plan = plan.with_strategies(options.strategies)
    with trial_results(options.folder, plan, options.device) as results:
        if options.imported:
            take_up(options.imported, plan, results)
        yield TrialExperiment(plan, results, options.checkpoint_seconds)


def trial_results(folder: Path, plan: TrialPlan, device: str = "cpu") -> Database:
    """The open results folder of a plan."""
    return Database(folder, plan, (STEPS, TRAININGS, DESIGNS), (*PUBLISHED, NETWORKS, *TABLES, FIGURE), device)


@dataclass(eq=False)
class TrialExperiment(StudyExperiment):
    """A plan with its results."""

    plan: TrialPlan
    results: Database
    checkpoint_seconds: float = 60.0

    def stages(self, console: Console) -> Iterator[Stage]:
        """Rounds of dialogues and of populations; in the first also what the optimum returns."""
        name, current, known = f"[bold]{self.plan.name}[/]: {len(self.plan.cases)} cases", 0, set[str]()
        while True:
            dialogues, about = list(self._dialogues(current)), f"{name}, round {current + 1}"
            yield Stage(dialogues, f"{about}: {len(dialogues)} dialogues to go on with" if dialogues else "")
            waited = self._round(current)
            if not waited:
                return
            tasks = self._populations(waited, known)
            known |= {key for task in tasks for key in task.keys}
            training = self.unfinished(tasks, TRAININGS)
            more: list[Task] = [*training, *(self._designs(waited) if current == 0 else ())]
            agents = sum(len(task.keys) for task in training)
            yield Stage(more, f"{about}: {agents} agents to train in {len(training)} populations" if more else "")
            current += 1

    def publish(self, console: Console) -> None:
        account, results = importlib.import_module(self.plan.page).account, self.results
        publish(results, lambda: account(self.plan, TrialResults.of(results)), console)

    def _designs(self, waited: Sequence[CaseRound]) -> Iterator[BriefTask]:
        """What the optimum returns, and what is designed on the models of the plan's centers."""
        models = (
            (step.case.plant, step.case.seed, step.payload["setups"][step.payload["answer"]["deployed"]])
            for step in waited
            if step.case.strategy in self.plan.centers and "answer" in step.payload
        )
        return design_tasks(self.plan, self.results, models)

    def _round(self, current: int) -> list[CaseRound]:
        """What was reached in that round, in the plan's order."""
        steps = {step.case: step for step in self.results.all(STEPS) if step.round == current}
        return [steps[case] for case in self.plan.cases if case in steps]

    def _dialogues(self, current: int) -> Iterator[BriefTask]:
        """The dialogues of a round that are not known yet, of a plant and a seed together."""
        groups: dict[tuple[str, str, int], list[Case]] = defaultdict(list)
        before = [step for step in self.results.all(STEPS) if step.round <= current]
        known = {step.case for step in before if step.round == current or "answer" in step.payload}
        for case in self.plan.cases:
            if case not in known:
                groups[case.plant, case.sensing, case.seed].append(case)
        for (plant, sensing, seed), cases in groups.items():
            name = f"round {current} on {plant} ({sensing}), seed {seed}"
            work = sum(0.5 + 0.3 * case.n for case in cases)
            arguments = (self.plan, current, tuple(cases), self.results.folder.resolve())
            yield BriefTask(name, "strategies", work, STEPS, case_rounds, arguments)

    def _populations(self, waited: Sequence[CaseRound], known: set[str]) -> list[PopulationTask]:
        """Of the agents that no round before waited for."""
        setups: dict[str, tuple[dict[str, Any], int]] = {}
        learners: dict[str, Learner] = {}
        for step in waited:
            for key, setup in step.payload["setups"].items():
                setups.setdefault(key, (setup, step.case.seed))
            if step.payload["learn"]:
                key, start, rollouts = step.payload["learn"]
                learners.setdefault(key, Learner(key, start, rollouts, step.case.seed, step.case.plant))
        agents = [AgentToTrain(key, payload, seed) for key, (payload, seed) in setups.items() if key not in known]
        tasks = list[PopulationTask]()
        for goes_on, plan in ((False, self.plan), (True, self.plan.of_learners)):
            selected = [agent for agent in agents if agent.key.endswith(CRITICS) == goes_on]
            tasks += [
                AgentPopulation(plan, g, **self.training) for g in populations(plan, selected, self.results.device)
            ]
        fresh = [learner for key, learner in learners.items() if key not in known]
        return tasks + PlantPopulation.tasks(self.plan, fresh, **self.training)
