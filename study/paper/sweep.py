"""The paper's sweep as an experiment: measure and identify, train and rate references, publish.

One (point, n, w, seed) measures a hidden plant, identifies it, trains on the estimate and is evaluated on the plant:

    rng(seed) -> n rollouts of the plant -> theta_hat = (m [kg], l [m])
              -> agent trained on U(theta_hat (1 - w), theta_hat (1 + w)) -> mean return of 20 episodes on the plant

Cells of a point that share n and seed share the estimate, and all identifiers of a plant, a noise and a seed see the
same rollouts; cells that share a seed share training streams and start states.

First every point is measured and identified, then populations train, and references follow on whatever core is free.
An unfinished population leaves a checkpoint in the folder of the results, which is tied to one preset, device and
version.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from rich.console import Console

from policies.evaluation import evaluate, fresh_start_states, start_states
from study.paper.finished_runs import RUNS, Outcomes, Run, read_import, read_published, taken_up
from study.paper.identification_scatter import scatter
from study.paper.presets import PAPER, Cell, Estimates, Point, Preset, Theta
from study.paper.protocol import PaperRollout, averaged_sensor, paper_model, paper_rollouts, transitions
from study.paper.reference_controllers import REFERENCES, reference_tasks
from study.paper.reproduction import reproduce
from study.paper.sweep_findings import PointFindings
from study.paper.sweep_page import outputs, sweep_account
from study.pipeline.database import Database
from study.pipeline.executor import BriefTask, Task
from study.pipeline.population_task import PopulationTask, sac_settings
from study.pipeline.publication import PUBLISHED, Account, publish
from study.pipeline.settings import RunOptions, versions
from study.pipeline.stages import Stage, StudyExperiment
from study.pipeline.tables import ResultTable
from sysid import Estimate, GridSearch, InvalidInput, LeastSquares, UnscentedKalman

if TYPE_CHECKING:
    from policies import Population


WHOLE_ROLLOUTS = {"least_squares": LeastSquares, "unscented": UnscentedKalman}


class Estimated(NamedTuple):
    """theta_hat (m [kg], l [m]) of a point, a budget and a seed, and what it took [s]."""

    point: str
    n: int
    seed: int
    theta: Theta
    seconds: float


ESTIMATES = ResultTable(
    "estimates", Estimated, "point TEXT, n INTEGER, seed INTEGER, m REAL, l REAL, seconds REAL", keys=3
)


def identify(point: Point, n: int, seed: int) -> Theta:
    """theta_hat from n rollouts of the point's hidden plant; the prior for n = 0.

    grid            the paper's grid search over single steps; every angle enters it, without noise, as a regressor
    least_squares   whole rollouts: the speeds, and of every rollout the first angle alone
    unscented       the same readings, by a Kalman filter

    All begin at the model's own (1, 1) and stay within the paper's bounds [0.3, 3.0], which the model's parameters
    carry; a training band that reaches beyond them is clipped where it is sampled. Raises InvalidInput for an unknown
    identifier.
    """
    if n == 0:
        return point.prior
    rollouts = paper_rollouts(paper_model(*point.truth), n, np.random.default_rng(seed), sigma=point.sigma)
    values = _estimate(point, rollouts).values
    return values["m"], values["l"]


def _estimate(point: Point, rollouts: list[PaperRollout]) -> Estimate:
    if point.identifier == "grid":
        return GridSearch().fit(paper_model(), transitions(rollouts))
    if point.identifier not in WHOLE_ROLLOUTS:
        known = ", ".join(("grid", *WHOLE_ROLLOUTS))
        raise InvalidInput(f"identifier {point.identifier!r}: expected one of {known}")
    identifier = WHOLE_ROLLOUTS[point.identifier](("m", "l"), sensor=averaged_sensor(point.sigma))
    return identifier.fit(paper_model(), [rollout.averaged for rollout in rollouts])


def identification_task(point: Point, seed: int) -> BriefTask:
    rollout = {"grid": 0.007, "least_squares": 0.03, "unscented": 0.2}.get(point.identifier, 0.1)
    name, work = f"identification at {point.name}, seed {seed}", 1.0 + rollout * sum(point.budgets)
    return BriefTask(name, "identification", work, ESTIMATES, identified, (point, seed))


def identified(point: Point, seed: int, progress: Callable[[float], None]) -> list[Estimated]:
    """The estimates of all budgets of an operating point, for one seed."""
    answer = []
    for k, n in enumerate(point.budgets):
        begin = time.monotonic()
        theta = identify(point, n, seed)
        answer.append(Estimated(point.name, n, seed, theta, time.monotonic() - begin))
        progress((k + 1) / len(point.budgets))
    return answer


@dataclass(frozen=True)
class SweepPopulation(PopulationTask):
    """The cells of one population: the runs it makes, with their estimates theta_hat; index: which population it is."""

    plan: Preset
    index: int
    cells: tuple[Cell, ...]
    estimates: tuple[Theta, ...]
    table: ClassVar[Any] = RUNS

    @property
    def name(self) -> str:
        return f"population {self.index + 1}"

    @property
    def keys(self) -> tuple[Cell, ...]:
        return self.cells

    def population(self) -> Population:
        """The agents of the cells, each on its band about its estimate, before their first step."""
        from policies import SACPopulation

        points = [self.plan.point(cell.point) for cell in self.cells]
        drawn = [_randomization(*arguments) for arguments in zip(points, self.cells, self.estimates, strict=True)]
        seeds = [cell.seed for cell in self.cells]
        return SACPopulation(paper_model(), drawn, seeds, sac_settings(self.plan), self.device)

    def answers(self, population: Population, seconds: float) -> list[Run]:
        """The finished runs, in the order of the cells."""
        made_with, curves = versions(), population.curves
        runs = []
        for a, (cell, policy) in enumerate(zip(self.cells, population.policies(), strict=True)):
            point, theta = self.plan.point(cell.point), self.estimates[a]
            plant = paper_model(*point.truth)
            answer = evaluate(policy, plant, *start_states(cell.seed, self.plan.episodes))
            fresh = evaluate(policy, plant, *fresh_start_states(cell.seed, self.plan.episodes))
            settings = {
                "preset": self.plan.name,
                "device": self.device,
                "sac": dataclasses.asdict(population.settings),
                "randomization": population.env.randomizations[a].to_json(),
                "identifier": point.identifier,
                "sigma": point.sigma,
                "truth": list(point.truth),
            }
            curve = tuple((int(step), float(value)) for step, value in curves[a])
            returns, fresh_returns = (tuple(evaluation.returns.tolist()) for evaluation in (answer, fresh))
            made = returns, fresh_returns, curve, settings, made_with
            reached = answer.mean, answer.std, fresh.mean
            runs.append(Run(cell, theta, math.dist(theta, point.truth), *reached, seconds, *made))
        return runs


def _randomization(point: Point, cell: Cell, theta: Theta) -> Any:
    from policies import Band, Ranges

    if point.randomization == "prior_range":
        return Ranges.of(paper_model(), ("m", "l"))
    if point.randomization != "band":
        raise InvalidInput(f"randomization {point.randomization!r}: expected one of band, prior_range")
    return Band(dict(zip(("m", "l"), theta, strict=True)), w=cell.w)


def sweep_results(folder: Path, preset: Preset, device: str = "cpu") -> Database:
    """The open results folder of a preset."""
    return Database(folder, preset, (ESTIMATES, RUNS, REFERENCES), (*outputs(preset), *PUBLISHED), device)


@contextlib.contextmanager
def open_experiment(preset: Preset, options: RunOptions) -> Iterator[StudyExperiment]:
    """The experiment over the open folder of its results."""
    theirs = read_published(options.published) if options.published else None
    with sweep_results(options.folder, preset, options.device) as results:
        yield Sweep(preset, results, options.checkpoint_seconds, options.imported, theirs)


@dataclass(eq=False)
class Sweep(StudyExperiment):
    """A preset with its results; imported: a file whose finished runs are taken up; theirs: the authors' runs, which
    ours are paired with in the report."""

    preset: Preset
    results: Database
    checkpoint_seconds: float = 60.0
    imported: Path | None = None
    theirs: Outcomes | None = None

    def stages(self, console: Console) -> Iterator[Stage]:
        """Identification; then training and references, after the runs in `imported` were taken up."""
        imported = read_import(self.imported, self.preset) if self.imported else []
        yield Stage(list(self._unidentified()))
        if self.imported:
            there = self.results.keys(RUNS)
            new = [run for run in taken_up(imported, self.preset, self.estimates()) if run.cell not in there]
            self.results.add(RUNS, new)
            console.print(f"{len(new)} runs taken up from {self.imported}", soft_wrap=True)
        known = {key[:-1] for key in self.results.keys(REFERENCES)}
        tasks: list[Task] = [*self._untrained(), *reference_tasks(self.preset, self.estimates(), known)]
        yield Stage(tasks, self._about(tasks))

    def publish(self, console: Console) -> None:
        publish(self.results, self._account, console)

    def _account(self) -> Account:
        runs, references = self.results.all(RUNS), self.results.all(REFERENCES)
        answers = [PointFindings(self.preset, point, runs, references) for point in self.preset.points]
        full = self.preset.episodes == PAPER.episodes  # else evaluations are not as published
        identified = scatter(np.random.default_rng(0)) if full else None
        return sweep_account(answers, reproduce(answers, self.results.folder, self.theirs, identified))

    def estimates(self) -> Estimates:
        """theta_hat by (point, n, seed)."""
        return {(e.point, e.n, e.seed): e.theta for e in self.results.all(ESTIMATES)}

    def _unidentified(self) -> Iterator[BriefTask]:
        known = self.results.keys(ESTIMATES)
        for point in self.preset.points:
            for seed in point.seeds:
                if not all((point.name, n, seed) in known for n in point.budgets):
                    yield identification_task(point, seed)

    def _untrained(self) -> list[SweepPopulation]:
        estimates, tasks = self.estimates(), []
        for index, cells in enumerate(self.preset.populations(self.results.device)):
            theta = tuple(estimates[cell.point, cell.n, cell.seed] for cell in cells)
            tasks.append(SweepPopulation(self.preset, index, cells, theta, **self.training))
        return self.unfinished(tasks, RUNS)

    def _about(self, tasks: Sequence[Task]) -> str:
        training = [t for t in tasks if isinstance(t, SweepPopulation)]
        resumed = sum(t.checkpoint.exists() for t in training)
        begun = f", {resumed} from a checkpoint" if resumed else ""
        return (
            f"preset [bold]{self.preset.name}[/]: {len(self.preset.cells)} runs, {len(self.results.keys(RUNS))} "
            f"finished; {len(training)} populations to train{begun}, {len(tasks) - len(training)} references"
        )
