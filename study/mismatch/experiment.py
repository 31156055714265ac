"""The mismatch experiment as tasks: rollouts and fits, agents and designs on what came out, and the report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

from rich.console import Console

from study.mismatch.designs import OPTIMUM, DesignTask, model_key
from study.mismatch.mismatch_results import DESIGNS, FITS, TRAININGS, Fitted, MismatchResults
from study.mismatch.plan import STRATEGIES, Plan
from study.mismatch.strategies import training_setups
from study.mismatch.trainings import MismatchPopulation, agents_of, populations, training_setup_of
from study.pipeline.executor import Brief, Link
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
    table: ClassVar[Any] = FITS

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
        agents = f"{sum(len(task.agents) for task in training)} agents to train in {len(training)} populations"
        yield Stage([*training, *designs], f"{name}: {agents}, {len(designs)} sets of designs")

    def publish(self, console: Console) -> None:
        from study.mismatch.mismatch_report import publish_mismatch

        publish_mismatch(self.plan, self.results, console)

    def _unfitted(self) -> Iterator[FitTask]:
        known, lacking = {f.trial for f in self.results.all(FITS)}, dict[tuple[int, str], dict[str, None]]()
        for trial in self.plan.trials:
            if trial not in known:
                lacking.setdefault((trial.seed, trial.plant), {})[trial.strategy] = None
        for (seed, plant), strategies in lacking.items():
            yield FitTask(self.plan, plant, seed, tuple(strategies))

    def _untrained(self) -> Iterator[MismatchPopulation]:
        plan, results = self.plan, self.results
        place = {"folder": results.folder.resolve(), "device": results.device}
        _, agents = agents_of(plan, results.all(FITS))
        tasks = [
            MismatchPopulation(plan, together, checkpoint_seconds=self.checkpoint_seconds, **place)
            for together in populations(plan, agents, results.device)
        ]
        finished = {agent.key for agent in results.all(TRAININGS)}
        return left(tasks, finished, lambda task: results.training_seconds(task.progress_key))

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
            seeds = [seed for seed in plan.seeds if (plant.name, seed) not in known]
            for some in (tuple(seeds[i : i + TOGETHER]) for i in range(0, len(seeds), TOGETHER)):
                pairs = tuple((seed, key) for seed in some for key in wanted.get((plant.name, seed), {}))
                own = tuple((key, models[key]) for key in dict.fromkeys(key for _, key in pairs))
                yield DesignTask(plan, plant.name, some, own, pairs)
