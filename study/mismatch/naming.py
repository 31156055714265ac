"""How many rollouts does naming the missing effect take, beside fitting m and l? No agent is trained.

    python -m study.mismatch.naming                                  tells what is in study/results/mismatch
    python -m study.mismatch.naming --seeds 100 --out elsewhere      measures, some hours; goes on if stopped

    error = sqrt(((m_hat - m)^2 / m^2 + (l_hat - l)^2 / l^2) / 2)

On every hidden plant of the plan, what a strategy does with its rollouts is done with 1 to 50 of them:
least squares for m and l alone, and the diagnosis with its refit. What is right says `naming_results`. The seeds are
used for nothing else. A table belongs to the version that made it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from study.mismatch.measured import rollouts
from study.mismatch.mismatch_plan import MismatchPlan
from study.mismatch.naming_results import (
    NAMING_TABLE,
    PLAN,
    REFUSED,
    NamingResult,
    is_right,
    naming_table,
    read_naming,
    write_naming,
)
from study.pipeline.executor import BriefTask, Task, WorkerFailed
from study.pipeline.processes import Processes
from study.pipeline.stages import Stage, StudyExperiment, run
from study.strategies.plant import SENSORS
from study.trials.ground_truth import ground_truth
from study.trials.hidden_plant import PLAIN, HiddenPlant
from study.trials.rollout_budget import Budget
from sysid import Diagnosis, Estimate, InvalidInput

NAMING_FOLDER = Path(__file__).parents[1] / "results" / "mismatch"

BUDGETS = (1, 2, 3, 5, 10, 20, 50)
FIRST, MOST = 2000, 100
"""The first seed, and how many there are at most: others begin where these end."""


def measure(plant: HiddenPlant, n: int, seed: int, budget: Budget) -> NamingResult:
    """What the diagnosis of these rollouts says, and how far m and l are off with and without it."""
    try:
        found, fitted, mended = budget.diagnosis, budget.fitted, budget.mended
    except InvalidInput:
        return NamingResult(plant.name, n, seed, REFUSED, (), False, math.nan, math.nan)
    steps = steps_of(found)
    right = is_right(plant, found.verdict, steps)
    return NamingResult(plant.name, n, seed, found.verdict, steps, right, _error(fitted), _error(mended))


def steps_of(found: Diagnosis) -> tuple[str, ...]:
    """The steps in a word each, those that belong to the log included."""
    return tuple("/".join(step.alike) for step in (*found.steps, *found.conventions))


def _error(estimate: Estimate) -> float:
    truth = ground_truth(PLAIN).parameters
    return math.sqrt(sum((estimate.values[k] / float(truth[k].value) - 1.0) ** 2 for k in ("m", "l")) / 2.0)


def named(
    plan: MismatchPlan, plant: str, seed: int, budgets: Sequence[int], progress: Callable[[float], None]
) -> list[NamingResult]:
    """The rows of a plant and a seed, one a budget; smaller budgets are the first rollouts of larger ones."""
    hidden, found = plan.plant(plant), list[NamingResult]()
    records = rollouts(hidden, seed, max(plan.budgets))
    for n in budgets:
        found.append(measure(hidden, n, seed, Budget(records[:n], SENSORS["encoder"], seed)))
        progress(len(found) / len(budgets))
    return found


class NamingExperiment(StudyExperiment):
    """The rows of a table that are measured up to so many seeds, each kept as soon as it is known."""

    def __init__(self, plan: MismatchPlan, path: Path, budgets: Sequence[int], seeds: int) -> None:
        self.plan, self.path, self.budgets, self.seeds = plan, path, budgets, seeds
        self.rows = read_naming(path)

    def stages(self, console: Console) -> Iterator[Stage]:
        left = list(self.left())
        yield Stage(left, f"{sum(len(task.arguments[-1]) for task in left)} diagnoses")

    def left(self) -> Iterator[BriefTask]:
        """What is not known yet; seeds vary slowest, so that what is there after a while is balanced."""
        done = {(row.plant, row.n, row.seed) for row in self.rows}
        for seed in range(FIRST, FIRST + self.seeds):
            for plant in (plant.name for plant in self.plan.plants):
                left = tuple(n for n in self.budgets if (plant, n, seed) not in done)
                if left:
                    work, arguments = 3.0 + sum(0.7 + 0.5 * n for n in left), (self.plan, plant, seed, left)
                    yield BriefTask(f"naming at {plant}, seed {seed}", "naming", work, None, named, arguments)

    def keep(self, task: Task, answer: Any) -> None:
        self.rows.extend(answer)
        write_naming(self.path, self.rows)

    def publish(self, console: Console) -> None:
        """Print the table."""
        console.print(naming_table(self.rows))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 done, 1 a task failed, 2 bad input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], prog="python -m study.mismatch.naming")
    parser.add_argument("--out", type=Path, default=NAMING_FOLDER, metavar="DIR", help="folder of the table")
    told = f"measure the table up to so many seeds, from {FIRST} on (default: tell what it has)"
    parser.add_argument("--seeds", type=int, metavar="N", help=told)
    parser.add_argument("--budgets", type=int, nargs="+", default=list(BUDGETS), choices=BUDGETS, metavar="N")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (default 2)")
    options = parser.parse_args(arguments)

    seeds, workers, out = options.seeds, options.workers, options.out
    try:
        experiment = NamingExperiment(PLAN, out / NAMING_TABLE, sorted(set(options.budgets)), seeds or 0)
        if seeds is not None:
            if not 1 <= seeds <= MOST or workers < 1:
                expected = f"expected 1 to {MOST} seeds and at least 1 worker"
                raise InvalidInput(f"--seeds {seeds}, --workers {workers}: {expected}")
            out.mkdir(parents=True, exist_ok=True)
            run(experiment, Processes(workers), Console(highlight=False))
        if not experiment.rows:
            raise InvalidInput(f"{out} has no {NAMING_TABLE}: measure one with --seeds {MOST}")
        # a cell that is cut says nothing: the table is as wide as it must be
        experiment.publish(Console(highlight=False, width=400))
    except (InvalidInput, OSError, WorkerFailed) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 1 if isinstance(error, WorkerFailed) else 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
