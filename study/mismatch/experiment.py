"""The mismatch experiment as tasks: rollouts and fits, agents and designs on what came out, and the report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from rich.console import Console

from study.mismatch.designs import OPTIMUM, DesignTask, model_key
from study.mismatch.mismatch_results import DESIGNS, FITS, TRAININGS, Fitted, MismatchResults
from study.mismatch.plan import STRATEGIES, Plan, Trial
from study.mismatch.strategies import training_setups
from study.mismatch.training_setup import training_setup_of
from study.mismatch.trainings import MismatchPopulation, agents_of, populations
from study.pipeline.executor import Brief, Link, Task
from study.pipeline.experiment import Experiment, Stage
from study.pipeline.population_task import left

TOGETHER = 5
"""Seeds whose models are designed on in one task: what they share, the optimum above all, is designed once."""


@dataclass(frozen=True)
class FitTask(Brief):
    """What every strategy makes of the rollouts that a seed draws on a hidden plant."""

    plan: Plan
    plant: str
    seed: int
    strategies: tuple[str, ...]
    activity: ClassVar[str] = "identification"

    @property
    def name(self) -> str:
        return f"fits to {self.plant}, seed {self.seed}"

    @property
    def work(self) -> float:
        return 0.3 * len(self.strategies) * sum(self.plan.budgets)

    def run(self, link: Link) -> list[Fitted]:
        made = training_setups(self.plan, self.plan.plant(self.plant), self.seed, self.strategies)
        return [
            Fitted(self.plant, strategy, n, self.seed, setup.to_json(), seconds)
            for (strategy, n), (setup, seconds) in made.items()
        ]


class MismatchExperiment(Experiment):
    """A plan with its results: every strategy makes something of the rollouts, which is trained on and designed on."""

    def __init__(self, plan: Plan, results: MismatchResults, checkpoint_seconds: float = 60.0) -> None:
        self.plan, self.results, self.checkpoint_seconds = plan, results, checkpoint_seconds

    def stages(self, console: Console) -> Iterator[Stage]:
        """Fits; then training and designs."""
        name = f"[bold]{self.plan.name}[/]"
        fits = list(self._unfitted())
        yield Stage(fits, f"{name}: {len(self.plan.trials)} trials; {len(fits)} sets of rollouts to make something of")
        training, designs = list(self._untrained()), list(self._undesigned())
        agents = sum(len(task.agents) for task in training)
        yield Stage(
            [*training, *designs],
            f"{name}: {agents} agents to train in {len(training)} populations, {len(designs)} sets of designs",
        )

    def keep(self, task: Task, answer: Any) -> None:
        if isinstance(task, FitTask):
            self.results.add(FITS, answer)
        elif isinstance(task, MismatchPopulation):
            self.results.add(TRAININGS, answer, [task.name])
            task.discard()
        else:
            self.results.add(DESIGNS, answer)

    def note(self, task: Task, seconds: float) -> None:
        self.results.note_training(task.name, seconds)

    def publish(self, console: Console) -> None:
        from study.mismatch.mismatch_report import publish_mismatch

        publish_mismatch(self.plan, self.results, console)

    def _unfitted(self) -> Iterator[FitTask]:
        plan, known = self.plan, {Trial(f.plant, f.strategy, f.n, f.seed) for f in self.results.all(FITS)}
        for seed in plan.seeds:
            for plant in plan.plants:
                trials = [t for t in plan.trials if t.plant == plant.name and t.seed == seed and t not in known]
                if trials:
                    yield FitTask(plan, plant.name, seed, tuple(dict.fromkeys(t.strategy for t in trials)))

    def _untrained(self) -> Iterator[MismatchPopulation]:
        plan, results = self.plan, self.results
        about = {
            "folder": results.folder.resolve(), "checkpoint_seconds": self.checkpoint_seconds, "device": results.device
        }  # fmt: skip
        _, agents = agents_of(plan, results.all(FITS))
        tasks = [MismatchPopulation(plan, together, **about) for together in populations(plan, agents, results.device)]
        finished = {agent.key for agent in results.all(TRAININGS)}
        return left(tasks, finished, lambda task: results.training_seconds(task.name))

    def _undesigned(self) -> Iterator[DesignTask]:
        plan, known = self.plan, {(d.plant, d.seed) for d in self.results.all(DESIGNS) if d.model == OPTIMUM}
        models: dict[str, dict[str, Any]] = {}
        wanted: dict[tuple[str, int], dict[str, None]] = {}
        for f in self.results.all(FITS):
            if STRATEGIES[f.strategy].center == f.strategy:
                key = model_key(training_setup_of(f.payload))
                models[key] = f.payload
                wanted.setdefault((f.plant, f.seed), {})[key] = None
        for plant in plan.plants:
            left = [seed for seed in plan.seeds if (plant.name, seed) not in known]
            for seeds in (tuple(left[i : i + TOGETHER]) for i in range(0, len(left), TOGETHER)):
                pairs = tuple((seed, key) for seed in seeds for key in wanted.get((plant.name, seed), {}))
                own = tuple((key, models[key]) for key in dict.fromkeys(key for _, key in pairs))
                yield DesignTask(plan, plant.name, seeds, own, pairs)
