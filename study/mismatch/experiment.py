"""The mismatch experiment as tasks: rollouts and fits, agents and designs on what came out, and the report.

Dynamic programming in the place of training says how much of a gap is structure, how much identification:

    gap             = J(optimum) - J(agent)
    structure       = J(optimum) - J(plain)        what an effect costs that the model lacks; 0 where the model has it
    identification  = J(optimum or plain) - J(fitted)
    training        = J(fitted) - J(agent)

J is the mean return on the hidden plant from the same start states. optimum: designed on the hidden plant; plain: on
the rod with the true m and l and without the effect; fitted: on the model that was trained on, at its centre where a
band is drawn.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from rich.console import Console

from policies.control.dynamic_programming import Grid
from policies.evaluation import Policy, batch_returns, fresh_start_states
from study.mismatch.ground_truth import DESIGN_SUBSTEPS, design, ground_truth, hidden_machine, oracle
from study.mismatch.mismatch_results import DESIGNS, FITS, TRAININGS, Designed, Fitted, MismatchResults
from study.mismatch.plan import STRATEGIES, Plan, TrainingPlan
from study.mismatch.strategies import training_setups
from study.mismatch.trainings import MismatchPopulation, TrainingSetup, agents_of, populations, training_setup_of
from study.pipeline.executor import Brief, Link
from study.pipeline.experiment import Stage, StudyExperiment
from study.pipeline.population_task import left
from study.pipeline.settings import digest
from sysid import InvalidInput, Model

OPTIMUM, PLAIN = "optimum", "plain"


def model_key(setup: TrainingSetup) -> str:
    """Sixteen hexadecimal digits of the model at the centre."""
    data = setup.to_json()
    return digest([data["model"], data["outside"]])


@dataclass(frozen=True)
class DesignTask(Brief):
    """Design on the models of some seeds, each once, and run on a hidden plant from the start states of their seeds.

    models   by key, as TrainingSetup.to_json; wanted: (seed, key) of what is run beside optimum and plain
    """

    plan: TrainingPlan
    plant: str
    seeds: tuple[int, ...]
    models: tuple[tuple[str, dict[str, Any]], ...]
    wanted: tuple[tuple[int, str], ...]
    activity: ClassVar[str] = "dynamic programming"
    table: ClassVar[Any] = DESIGNS

    @property
    def name(self) -> str:
        return f"designs for {self.plant}, seeds {self.seeds[0]} to {self.seeds[-1]}"

    @property
    def work(self) -> float:
        return 3.0 * (len(self.models) + 2) * (self.plan.grid / 120.0) ** 2

    def run(self, link: Link) -> list[Designed]:
        """The returns of every design; none of a model that no table can be made for."""
        begin = time.perf_counter()
        made = self._designs(link)
        pairs = [(seed, key) for seed in self.seeds for key in (OPTIMUM, PLAIN)] + list(self.wanted)
        pairs = [(seed, key) for seed, key in pairs if key in made]
        starts = [fresh_start_states(seed, self.plan.episodes) for seed, _ in pairs]
        plant = ground_truth(self.plan.plant(self.plant))
        reached = batch_returns([made[key] for _, key in pairs], plant, *map(np.array, zip(*starts, strict=True)))
        seconds = (time.perf_counter() - begin) / len(pairs)
        return [
            Designed(self.plant, key, seed, tuple(row), seconds)
            for (seed, key), row in zip(pairs, reached.tolist(), strict=True)
        ]

    def _designs(self, link: Link) -> dict[str, Policy]:
        models: list[tuple[str, Model]] = [(OPTIMUM, oracle(self.plan.plant(self.plant)))]
        models.append((PLAIN, hidden_machine(substeps=DESIGN_SUBSTEPS)))
        models += [(key, training_setup_of(data).model) for key, data in self.models]
        grid, made = Grid(theta=self.plan.grid, theta_dot=self.plan.grid + 1), dict[str, Policy]()
        for k, (key, model) in enumerate(models):
            try:
                made[key] = design(model, grid)
            except InvalidInput:  # a fitted model that no table can be made for has no row
                if key in (OPTIMUM, PLAIN):
                    raise
            link.progress((k + 1) / (len(models) + 1))
        return made


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


@dataclass(eq=False)
class MismatchExperiment(StudyExperiment):
    """A plan with its results: every strategy makes something of the rollouts, which is trained on and designed on."""

    plan: Plan
    results: MismatchResults
    checkpoint_seconds: float = 60.0

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
        _, agents = agents_of(plan, results.all(FITS))
        groups = populations(plan, agents, results.device)
        tasks = [MismatchPopulation(plan, together, **self.training) for together in groups]
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
