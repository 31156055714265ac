"""The mismatch experiment as tasks: rollouts and fits, agents and designs on what came out, and the report."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from study.mismatch.mismatch_page import publish_mismatch
from study.mismatch.mismatch_plan import STRATEGIES, Plan
from study.mismatch.trial_setups import FITS, agents_of, fitted
from study.pipeline.database import Database
from study.pipeline.executor import BriefTask
from study.pipeline.policy_files import FOLDER
from study.pipeline.settings import RunOptions
from study.pipeline.stages import Stage, StudyExperiment
from study.trials.designs import DESIGNS, design_tasks
from study.trials.populations import TRAININGS, AgentPopulation, populations

OUTPUTS = (
    "study.json", "trials.csv", "outcomes.csv", "contrasts.csv", "report.html", FOLDER,
    "returns.png", "ladder.png", "trajectories.png",
)  # fmt: skip
"""What the experiment writes beside its database; never over files of somebody else."""


def mismatch_results(folder: Path, plan: Plan, device: str = "cpu") -> Database:
    """The open results folder of a plan."""
    return Database(folder, plan, (FITS, TRAININGS, DESIGNS), OUTPUTS, device)


@contextlib.contextmanager
def open_experiment(plan: Plan, options: RunOptions) -> Iterator[StudyExperiment]:
    """The experiment over the open folder of its results."""
    with mismatch_results(options.folder, plan, options.device) as results:
        yield MismatchExperiment(plan, results, options.checkpoint_seconds)


@dataclass(eq=False)
class MismatchExperiment(StudyExperiment):
    """A plan with its results: every strategy makes something of the rollouts, which is trained on and designed on."""

    plan: Plan
    results: Database
    checkpoint_seconds: float = 60.0

    def stages(self, console: Console) -> Iterator[Stage]:
        plan, results, name = self.plan, self.results, f"[bold]{self.plan.name}[/]"
        fits = list(self._unfitted())
        yield Stage(fits, f"{name}: {len(plan.trials)} trials; {len(fits)} sets of rollouts to make something of")
        _, agents = agents_of(plan, results.all(FITS))
        groups = populations(plan, agents, results.device)
        training = self.unfinished((AgentPopulation(plan, own, **self.training) for own in groups), TRAININGS)
        tables = (
            (f.plant, f.seed, f.payload) for f in results.all(FITS) if STRATEGIES[f.strategy].center == f.strategy
        )
        designs = list(design_tasks(plan, results, tables))
        count = f"{sum(len(task.agents) for task in training)} agents to train in {len(training)} populations"
        yield Stage([*training, *designs], f"{name}: {count}, {len(designs)} sets of designs")

    def publish(self, console: Console) -> None:
        publish_mismatch(self.plan, self.results, console)

    def _unfitted(self) -> Iterator[BriefTask]:
        plan, known, lacking = self.plan, self.results.keys(FITS), dict[tuple[int, str], list[str]]()
        for trial in plan.trials:
            own = lacking.setdefault((trial.seed, trial.plant), [])
            if trial not in known and trial.strategy not in own:
                own.append(trial.strategy)
        for (seed, plant), strategies in lacking.items():
            if strategies:
                work, arguments = 0.3 * len(strategies) * sum(plan.budgets), (plan, plant, seed, tuple(strategies))
                yield BriefTask(f"fits to {plant}, seed {seed}", "identification", work, FITS, fitted, arguments)
