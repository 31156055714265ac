"""How many rollouts does naming the missing effect take, beside fitting m and l? No agent is trained.

    python -m study.mismatch.naming                    draws what was measured: study/results/mismatch
    python -m study.mismatch.naming --out elsewhere    measures again, some hours, and goes on if stopped

    error = sqrt(((m_hat - m)^2 / m^2 + (l_hat - l)^2 / l^2) / 2)

On every hidden plant of the plan, what a way of the experiment does with its rollouts is done with 1 to 50 of them:
least squares for m and l alone, and the diagnosis with its refit. Right is to name the effect, or one that contains it,
and nothing else; "unknown" where the catalogue lacks the effect, "adequate" where nothing is missing. The seeds are
used for nothing else. A table belongs to the version that made it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from study import rows as table
from study.executors.executor import Brief
from study.mismatch.plan import PLANS, HiddenPlant, Plan
from study.statistics import wilson
from sysid import CATALOGUE, Diagnosis, InvalidInput

if TYPE_CHECKING:
    from study.executors.executor import Link, Task
    from study.mismatch.ways import Spending
    from sysid import Estimate

SHIPPED = Path(__file__).parents[1] / "results" / "mismatch"
TABLE, FIGURE = "naming.csv", "naming.png"

BUDGETS = (1, 2, 3, 5, 10, 20, 50)
FIRST, SEEDS = 2000, 100
"""The first seed, and how many."""

CONTAINS = {"coulomb": ("stribeck", "asymmetric_coulomb")}
"""Larger effects that are the effect at some of their numbers: to name one of them is right, too."""

REFUSED = "refused"
"""The verdict where the rollouts do not even allow a fit."""


@dataclass(frozen=True)
class Named:
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


@dataclass(frozen=True)
class Rate:
    """How often, of so many seeds, the naming was right, with Wilson's 95 % interval.

    accompanied   how often the effect was named, but with another, or with something left that nothing explains
    """

    right: int
    accompanied: int
    seeds: int

    @property
    def share(self) -> float:
        """Of the seeds that were right."""
        return self.right / self.seeds

    @property
    def interval(self) -> tuple[float, float]:
        """Of that share."""
        return wilson(self.right, self.seeds)


def is_right(plant: HiddenPlant, verdict: str, steps: Sequence[str]) -> bool:
    """Whether this is what the plant has, and nothing else."""
    if plant.effect is None:
        return verdict == "adequate"
    if plant.effect not in CATALOGUE:
        return verdict == "unknown"
    return verdict in ("missing", "cannot tell") and len(steps) == 1 and names(plant, steps)


def names(plant: HiddenPlant, steps: Sequence[str]) -> bool:
    """Whether one of the steps is the plant's effect, one that contains it, or one that the log cannot tell from it."""
    wanted = {plant.effect, *CONTAINS.get(plant.effect or "", ())}
    return any(wanted & set(step.split("/")) for step in steps)


def rates(rows: Iterable[Named]) -> dict[tuple[str, int], Rate]:
    """The rates by (plant, n)."""
    plants = {plant.name: plant for plant in PLANS["mismatch"].plants}
    groups: dict[tuple[str, int], list[Named]] = {}
    for row in rows:
        groups.setdefault((row.plant, row.n), []).append(row)
    found = {}
    for key, own in groups.items():
        accompanied = [row for row in own if not row.right and names(plants[row.plant], row.steps)]
        found[key] = Rate(sum(row.right for row in own), len(accompanied), len(own))
    return found


def enough(rows: Iterable[Named], plant: str, share: float = 0.9) -> int | None:
    """The least measured number of rollouts from which on such a share is right; None where even the most are few."""
    found, least = rates(rows), None
    for n in sorted((n for name, n in found if name == plant), reverse=True):
        if found[plant, n].share < share:
            break
        least = n
    return least


def errors(rows: Iterable[Named], plant: str, n: int) -> tuple[float, float]:
    """Root mean squares over seeds of the errors of m and l, fitted and mended; nan where there is no row."""
    own = [(r.error_fitted, r.error_mended) for r in rows if (r.plant, r.n) == (plant, n) and r.verdict != REFUSED]
    fitted, mended = np.sqrt(np.mean(np.square(own), axis=0)) if own else (math.nan, math.nan)
    return float(fitted), float(mended)


def measure(plant: HiddenPlant, n: int, seed: int, spending: Spending) -> Named:
    """What the diagnosis of these rollouts says, and how far m and l are off with and without it."""
    try:
        found, fitted, mended = spending.diagnosis, spending.fitted, spending.mended
    except InvalidInput:
        return Named(plant.name, n, seed, REFUSED, (), False, math.nan, math.nan)
    steps = steps_of(found)
    right = is_right(plant, found.verdict, steps)
    return Named(plant.name, n, seed, found.verdict, steps, right, _error(fitted), _error(mended))


def steps_of(found: Diagnosis) -> tuple[str, ...]:
    """The steps in a word each, those that belong to the log included."""
    return tuple("/".join(step.alike) for step in (*found.steps, *found.conventions))


def _error(estimate: Estimate) -> float:
    from study.mismatch.hidden import hidden_machine

    truth = hidden_machine(HiddenPlant("plain")).parameters
    return math.sqrt(sum((estimate.values[k] / float(truth[k].value) - 1.0) ** 2 for k in ("m", "l")) / 2.0)


@dataclass(frozen=True)
class NamingTask(Brief):
    """The rows of a plant and a seed."""

    plan: Plan
    plant: str
    seed: int
    budgets: tuple[int, ...]
    activity: ClassVar[str] = "naming"

    @property
    def name(self) -> str:
        return f"naming at {self.plant}, seed {self.seed}"

    @property
    def work(self) -> float:
        """About how many seconds it takes on one core; only the time left is computed from it."""
        return 3.0 + sum(0.7 + 0.25 * n for n in self.budgets)

    def run(self, link: Link) -> list[Named]:
        """One row a budget; smaller budgets are the first rollouts of larger ones."""
        from study.mismatch.hidden import rollouts
        from study.mismatch.ways import Spending

        plant = self.plan.plant(self.plant)
        records = rollouts(self.plan, plant, self.seed)
        found = []
        for n in self.budgets:
            found.append(measure(plant, n, self.seed, Spending(self.plan, records[:n], self.seed)))
            link.progress(len(found) / len(self.budgets))
        return found


def tasks(plan: Plan, known: Iterable[Named], budgets: Sequence[int], seeds: int) -> Iterator[NamingTask]:
    """What is not known yet; seeds vary slowest, so that what is there after a while is balanced."""
    done = {(row.plant, row.n, row.seed) for row in known}
    for seed in range(FIRST, FIRST + seeds):
        for plant in plan.plants:
            left = tuple(n for n in budgets if (plant.name, n, seed) not in done)
            if left:
                yield NamingTask(plan, plant.name, seed, left)


def read(path: Path) -> list[Named]:
    """The rows of a table; none where there is no file. Raises InvalidInput for a file of another kind."""
    return table.read(Named, path, "effects that were named")


def write(path: Path, rows: Iterable[Named]) -> None:
    """The rows as a CSV file, in the plan's order of plants; whole or not at all."""
    order = {plant.name: i for i, plant in enumerate(PLANS["mismatch"].plants)}
    table.write(Named, path, sorted(rows, key=lambda row: (order[row.plant], row.n, row.seed)))


def draw(rows: Sequence[Named], folder: Path) -> Path:
    """Draw the rates and errors into a folder; returns the file."""
    from study.figures.naming import naming
    from study.figures.style import save

    return save(lambda: naming(rows), folder / FIGURE)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 done, 1 a task failed, 2 bad input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], prog="python -m study.mismatch.naming")
    parser.add_argument("--out", type=Path, default=SHIPPED, metavar="DIR", help="folder of table and figure")
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N", help=f"how many, from {FIRST} on")
    parser.add_argument("--budgets", type=int, nargs="+", default=list(BUDGETS), choices=BUDGETS, metavar="N")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (default 2)")
    options = parser.parse_args(arguments)

    from study.executors.executor import WorkerFailed

    try:
        if options.seeds < 1 or options.workers < 1:
            raise InvalidInput("--seeds and --workers: expected at least 1")
        options.out.mkdir(parents=True, exist_ok=True)
        rows = _measured(options.out / TABLE, sorted(set(options.budgets)), options.seeds, options.workers)
        draw(rows, options.out)
    except (InvalidInput, OSError, WorkerFailed) as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return 1 if isinstance(error, WorkerFailed) else 2
    return 0


def _measured(path: Path, budgets: Sequence[int], seeds: int, workers: int) -> list[Named]:
    """The rows of the table, after those that it lacks were measured; kept as soon as they are known."""
    from rich.console import Console

    from study.executors.processes import Processes
    from study.runner import announce, execute

    rows, console = read(path), Console(highlight=False)
    left = list(tasks(PLANS["mismatch"], rows, budgets, seeds))
    if left:
        announce(console, left, workers, f"{sum(len(task.budgets) for task in left)} diagnoses")
    execute(left, Processes(workers), console, partial(_keep, path=path, rows=rows), lambda task, seconds: None)
    return rows


def _keep(task: Task, found: Any, path: Path, rows: list[Named]) -> None:
    rows.extend(found)
    write(path, rows)


if __name__ == "__main__":
    sys.exit(main())
