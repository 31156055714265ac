"""Runs the mismatch experiment to its end, from wherever an earlier attempt left it.

First every way makes something of the rollouts, then what came out is trained on and designed on. Every finished task
goes into the results at once; nothing a number depends on is decided here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

from rich.console import Console

from study.executors.executor import Brief, Executor, Link, Task
from study.mismatch.designs import OPTIMUM, DesignTask, model_key
from study.mismatch.plan import WAYS, Plan, Trial
from study.mismatch.recipe import recipe_of
from study.mismatch.results import Fitted, Results
from study.mismatch.trainings import TrainingTask, agents_of, populations
from study.mismatch.ways import recipes
from study.runner import announce, execute
from study.training import left

TOGETHER = 5
"""Seeds whose models are designed on in one task: what they share, the optimum above all, is designed once."""


@dataclass(frozen=True)
class FitTask(Brief):
    """What every way makes of the rollouts that a seed draws on a hidden plant."""

    plan: Plan
    plant: str
    seed: int
    ways: tuple[str, ...]
    activity: ClassVar[str] = "identification"

    @property
    def name(self) -> str:
        return f"fits to {self.plant}, seed {self.seed}"

    @property
    def work(self) -> float:
        """About how many seconds it takes on one core; only the time left is computed from it."""
        return 0.3 * len(self.ways) * sum(self.plan.budgets)

    def run(self, link: Link) -> list[Fitted]:
        """One answer a way and budget."""
        made = recipes(self.plan, self.plan.plant(self.plant), self.seed, self.ways)
        return [
            Fitted(self.plant, way, n, self.seed, recipe.to_json(), seconds)
            for (way, n), (recipe, seconds) in made.items()
        ]


def run(plan: Plan, results: Results, executor: Executor, console: Console, checkpoint_seconds: float = 60.0) -> None:
    """Finish every trial that the results lack. Raises WorkerFailed where a task fails; what is finished stays."""
    keep, note = partial(_keep, results=results), partial(_note, results=results)
    fits = list(_unfitted(plan, results))
    if fits:
        about = f"[bold]{plan.name}[/]: {len(plan.trials)} trials; {len(fits)} sets of rollouts to make something of"
        announce(console, fits, executor.workers, about)
    execute(fits, executor, console, keep, note)
    tasks = [*_untrained(plan, results, checkpoint_seconds), *_undesigned(plan, results)]
    if tasks:
        training = [task for task in tasks if isinstance(task, TrainingTask)]
        about = (
            f"[bold]{plan.name}[/]: {sum(len(task.agents) for task in training)} agents to train in {len(training)} "
            f"populations, {len(tasks) - len(training)} sets of designs"
        )
        announce(console, tasks, executor.workers, about)
    execute(tasks, executor, console, keep, note)


def _keep(task: Task, payload: Any, results: Results) -> None:
    if isinstance(task, FitTask):
        results.add_fits(payload)
    elif isinstance(task, TrainingTask):
        results.add_trainings(payload, task.name)
        task.discard()
    else:
        results.add_designs(payload)


def _note(task: Task, seconds: float, results: Results) -> None:
    results.note_training(task.name, seconds)


def _unfitted(plan: Plan, results: Results) -> Iterator[FitTask]:
    known = {Trial(f.plant, f.way, f.n, f.seed) for f in results.fits()}
    for seed in plan.seeds:
        for plant in plan.plants:
            trials = [t for t in plan.trials if t.plant == plant.name and t.seed == seed and t not in known]
            if trials:
                yield FitTask(plan, plant.name, seed, tuple(dict.fromkeys(t.way for t in trials)))


def _untrained(plan: Plan, results: Results, checkpoint_seconds: float) -> Iterator[TrainingTask]:
    about = {"folder": results.folder.resolve(), "checkpoint_seconds": checkpoint_seconds, "device": results.device}
    _, agents = agents_of(plan, results.fits())
    tasks = [TrainingTask(plan, together, **about) for together in populations(plan, agents, results.device)]
    finished = {agent.key for agent in results.trainings()}
    return left(tasks, finished, lambda task: results.training_seconds(task.name))


def _undesigned(plan: Plan, results: Results) -> Iterator[DesignTask]:
    known = {(d.plant, d.seed) for d in results.designs() if d.model == OPTIMUM}
    models: dict[str, dict[str, Any]] = {}
    wanted: dict[tuple[str, int], dict[str, None]] = {}
    for f in results.fits():
        if WAYS[f.way].center == f.way:
            key = model_key(recipe_of(f.payload))
            models[key] = f.payload
            wanted.setdefault((f.plant, f.seed), {})[key] = None
    for plant in plan.plants:
        left = [seed for seed in plan.seeds if (plant.name, seed) not in known]
        for seeds in (tuple(left[i : i + TOGETHER]) for i in range(0, len(left), TOGETHER)):
            pairs = tuple((seed, key) for seed in seeds for key in wanted.get((plant.name, seed), {}))
            own = tuple((key, models[key]) for key in dict.fromkeys(key for _, key in pairs))
            yield DesignTask(plan, plant.name, seeds, own, pairs)
