"""How many rollouts does naming the missing effect take, beside fitting m and l? No agent is trained.

    python -m study.mismatch.naming                                  tells what is in study/results/mismatch
    python -m study.mismatch.naming --seeds 100 --out elsewhere      measures, some hours; goes on if stopped

    error = sqrt(((m_hat - m)^2 / m^2 + (l_hat - l)^2 / l^2) / 2)

On every hidden plant of the plan, what a strategy does with its rollouts is done with 1 to 50 of them:
least squares for m and l alone, and the diagnosis with its refit. The seeds are used for nothing else. A table belongs
to the version that made it.

Right is to name the effect, alone: as itself, as one that contains it, or in a class that the log cannot tell apart
("cannot tell"). Where the catalogue lacks the effect it is right to say that something unknown is left: "unknown" or,
beside what was named, "partly". Where nothing is missing "adequate" is right.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from rich.console import Console
from rich.table import Table
from tyro.conf import arg

from study.mismatch.measured import measured_rollouts
from study.mismatch.mismatch_plan import MISMATCH_PLANS, MismatchPlan
from study.pipeline.executor import BriefTask, Processes, Task, WorkerFailed
from study.pipeline.stages import Stage, StudyExperiment, run
from study.pipeline.tables import read_table, write_table
from study.strategies.plant import SENSORS
from study.trials.ground_truth import ground_truth
from study.trials.hidden_plant import PLAIN, HiddenPlant
from study.trials.rollout_budget import Budget
from sysid import CATALOGUE, Diagnosis, Estimate, InvalidInput
from sysid.cli.command_line import answer_one, entry_point
from sysid.cli.command_options import option
from sysid.data.files import file_errors
from sysid.report.typesetting import capital

PLAN, NAMING_TABLE = MISMATCH_PLANS["mismatch"], "naming.csv"

REFUSED = "refused"
"""The verdict where the rollouts do not even allow a fit."""


@dataclass(frozen=True)
class NamingResult:
    """What n rollouts of a hidden plant led to.

    steps         what was added, in order; with "/" between the effects that the log cannot tell apart
    right         whether that is what is missing, and nothing else
    error_fitted  of m and l of the model that lacks the effect; error_mended: of that with what was added [1]
    """

    plant: str
    n: int
    seed: int
    verdict: str
    steps: tuple[str, ...]
    right: bool
    error_fitted: float
    error_mended: float


def is_right(plant: HiddenPlant, verdict: str, steps: Sequence[str]) -> bool:
    """Whether this is what the plant has, and nothing else."""
    if plant.effect is None:
        return verdict == "adequate"
    if plant.effect not in CATALOGUE:
        return verdict in ("unknown", "partly")
    return verdict in ("missing", "cannot tell") and len(steps) == 1 and names(plant, steps)


def names(plant: HiddenPlant, steps: Sequence[str]) -> bool:
    """Whether one of the steps is the plant's effect, one that contains it, or one that the log cannot tell from it."""
    wanted = {plant.effect, *(name for name, kind in CATALOGUE.items() if plant.effect in kind.contains)}
    return any(wanted & set(step.split("/")) for step in steps)


def naming_errors(rows: Iterable[NamingResult]) -> tuple[float, float]:
    """Root mean squares of the errors of m and l, fitted and mended; nan where there is no fit."""
    errors = [(row.error_fitted, row.error_mended) for row in rows if row.verdict != REFUSED]
    fitted, mended = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else (math.nan, math.nan)
    return float(fitted), float(mended)


def naming_table(rows: Sequence[NamingResult]) -> Table:
    """What was found, a line a hidden plant in the plan's order and a column a budget, all in percent.

    "93 [86, 97]" is how often the answer was right, with Wilson's interval, and "(2.1, 0.4)" below it are the errors
    of m and l without and with what was named; a cell is empty where nothing was measured.
    """
    cells: dict[tuple[str, int], list[NamingResult]] = {}
    for row in rows:
        cells.setdefault((row.plant, row.n), []).append(row)
    budgets, seeds = sorted({row.n for row in rows}), sorted({len(cell) for cell in cells.values()})
    counted = " to ".join(str(s) for s in dict.fromkeys((seeds[0], seeds[-1])))
    title = f"right [%] of {counted} seeds (errors of m and l without and with what was named [%])"
    table = Table(title=title, title_justify="left")
    for head in ("hidden plant", *(f"n = {n}" for n in budgets)):
        table.add_column(head, no_wrap=True)
    for plant in PLAN.plants:
        if any(name == plant.name for name, _ in cells):
            table.add_row(capital(plant.title), *(_cell(cells.get((plant.name, n), [])) for n in budgets))
    return table


def _cell(rows: Sequence[NamingResult]) -> str:
    from scipy.stats import binomtest  # loads for a second

    if not rows:
        return ""
    right = sum(row.right for row in rows)
    low, high = binomtest(right, len(rows)).proportion_ci(method="wilson")
    fitted, mended = (f"{100.0 * error:.2g}" for error in naming_errors(rows))
    return f"{100 * right / len(rows):.0f} [{100 * low:.0f}, {100 * high:.0f}]\n({fitted}, {mended})"


def read_naming(path: Path) -> list[NamingResult]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    known = {"plant": [plant.name for plant in PLAN.plants]}
    return read_table(NamingResult, path, "effects that were named", optional=True, known=known)


def write_naming(path: Path, rows: Iterable[NamingResult]) -> None:
    """The rows as a CSV file, in the plan's order of plants; whole or not at all. Raises InvalidInput."""
    order = [plant.name for plant in PLAN.plants]
    ordered = sorted(rows, key=lambda row: (order.index(row.plant), row.n, row.seed))
    with file_errors(path, "write"):
        write_table(NamingResult, path, ordered)


NAMING_FOLDER = Path(__file__).parents[1] / "results" / "mismatch"

BUDGETS = (1, 2, 3, 5, 10, 20, 50)
FIRST, MOST = 2000, 100
"""The first seed, and how many there are at most: others begin where these end."""


def measure(plant: HiddenPlant, n: int, seed: int, budget: Budget) -> NamingResult:
    """What the diagnosis of these rollouts says, and how far m and l are off with and without it."""
    try:
        diagnosis, fitted, mended = budget.diagnosis, budget.fitted, budget.mended
    except InvalidInput:
        return NamingResult(plant.name, n, seed, REFUSED, (), False, math.nan, math.nan)
    steps = steps_of(diagnosis)
    right = is_right(plant, diagnosis.verdict, steps)
    return NamingResult(plant.name, n, seed, diagnosis.verdict, steps, right, _error(fitted), _error(mended))


def steps_of(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The steps in a word each, those that belong to the log included."""
    return tuple("/".join(step.indistinguishable) for step in (*diagnosis.steps, *diagnosis.conventions))


def _error(estimate: Estimate) -> float:
    truth = ground_truth(PLAIN).parameters
    return math.sqrt(sum((estimate.values[k] / float(truth[k].value) - 1.0) ** 2 for k in ("m", "l")) / 2.0)


def naming_rows(
    plan: MismatchPlan, plant: str, seed: int, budgets: Sequence[int], progress: Callable[[float], None]
) -> list[NamingResult]:
    """The rows of a plant and a seed, one a budget; smaller budgets are the first rollouts of larger ones."""
    hidden, rows = plan.plant(plant), list[NamingResult]()
    records = measured_rollouts(hidden, seed, max(plan.budgets))
    for n in budgets:
        rows.append(measure(hidden, n, seed, Budget(records[:n], SENSORS["encoder"], seed)))
        progress(len(rows) / len(budgets))
    return rows


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
                    yield BriefTask(f"naming at {plant}, seed {seed}", "naming", work, None, naming_rows, arguments)

    def keep(self, task: Task, answer: Any) -> None:
        self.rows.extend(answer)
        write_naming(self.path, self.rows)

    def publish(self, console: Console) -> None:
        """Print the table."""
        console.print(naming_table(self.rows))


@dataclass(frozen=True)
class NamingOptions:
    """How many rollouts does naming the missing effect take, beside fitting m and l? No agent is trained."""

    out: Annotated[Path, option("DIR", "study/results/mismatch")] = NAMING_FOLDER
    """Folder of the table."""

    seeds: Annotated[int | None, option("N", "tell what it has")] = None
    """Measure the table up to so many seeds, from 2000 on."""

    budgets: Annotated[tuple[Literal[*BUDGETS], ...], arg(metavar="N")] = BUDGETS
    """The numbers of rollouts that are measured, out of these."""

    workers: Annotated[int, arg(metavar="N")] = 2
    """Processes."""


@entry_point
def main(arguments: Sequence[str]) -> int:
    """Run the command line.

    Returns the exit code: 0 done, 1 a task failed or nobody reads on, 2 bad input, 130 stopped.
    """
    try:
        return answer_one(NamingOptions, tell, "python -m study.mismatch.naming", arguments)
    except WorkerFailed as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 1


def tell(command: NamingOptions) -> None:
    """Print the table, after what it lacks was measured. Raises InvalidInput for bad input, and WorkerFailed."""
    seeds, workers, out = command.seeds, command.workers, command.out
    experiment = NamingExperiment(PLAN, out / NAMING_TABLE, sorted(set(command.budgets)), seeds or 0)
    if seeds is not None:
        if not 1 <= seeds <= MOST or workers < 1:
            expected = f"expected 1 to {MOST} seeds and at least 1 worker"
            raise InvalidInput(f"--seeds {seeds}, --workers {workers}: {expected}")
        with file_errors(out, "write"):
            out.mkdir(parents=True, exist_ok=True)
        run(experiment, Processes(workers), Console(highlight=False))
    if not experiment.rows:
        raise InvalidInput(f"{out} has no {NAMING_TABLE}: measure one with --seeds {MOST}")
    # a cell that is cut says nothing: the table is as wide as it must be
    experiment.publish(Console(highlight=False, width=400))


if __name__ == "__main__":
    sys.exit(main())
