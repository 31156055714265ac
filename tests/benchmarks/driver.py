"""python -m tests.benchmarks.driver: what the driver of a study itself costs, with runs that take no time.

Tasks are answered at once with invented numbers of real size (375 training episodes, 2 x 20 evaluation episodes), so
that what is left is the driver's: progress, the store's transactions, reading everything back, runs.csv. Populations of
five and the paper's grid at as many operating points as it takes. A driver whose cost for a run grows with the number
of runs is one that sums or scans all of them again and again: the two sizes side by side show that.
"""

from __future__ import annotations

import cProfile
import dataclasses
import io
import pstats
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from study.paper.finished_runs import RUNS, Run, run_table
from study.paper.presets import PAPER, Preset
from study.paper.reference_controllers import REFERENCES, Reference
from study.paper.sweep import ESTIMATES, Estimated, Sweep, SweepPopulation, sweep_results
from study.paper.sweep_findings import PointFindings
from study.pipeline.executor import BriefTask, Heard, Task
from study.pipeline.stages import run
from study.pipeline.tables import write_rows
from tests.benchmarks import command

PROGRESS = 20
"""Messages of progress a task; more than a second apart where tasks take their time."""

EPISODES, CURVE = (-400.0,) * 20, tuple((200 * k, -1234.567890123) for k in range(375))


class Instant:
    """An executor whose tasks are done when they are asked for (a `study.pipeline.executor.Executor`)."""

    workers = 1

    def execute(self, tasks: Sequence[Task], heard: Heard) -> None:
        for task in tasks:
            for k in range(PROGRESS):
                heard(task, "progress", k / PROGRESS)
            if task.saves:
                heard(task, "saved", None)
            heard(task, "done", invented(task))


def invented(task: Task) -> list[Any]:
    """The answer of a task, with theta_hat told apart by all that it depends on."""
    if isinstance(task, BriefTask) and task.table is ESTIMATES:
        point, seed = task.arguments
        number = float(point.name)
        return [
            Estimated(point.name, n, seed, (1.0 + number + 0.001 * n, 1.0 + 0.01 * seed), 0.1) for n in point.budgets
        ]
    versions = {"torch": "0", "numpy": "0"}
    if isinstance(task, BriefTask):
        preset, controller, theta, truths = task.arguments
        return [
            Reference(controller, theta, truth, seed, -400.0, -400.0, versions, 1.0)
            for truth in truths
            for seed in preset.reference_seeds
        ]
    assert isinstance(task, SweepPopulation)
    settings = {"preset": task.plan.name, "device": task.device, "sac": dict.fromkeys("abcdefghijklmnop", 0.001)}
    return [
        Run(cell, theta, 0.5, -400.0, 0.0, -400.0, 900.0, EPISODES, EPISODES, CURVE, settings, versions)
        for cell, theta in zip(task.cells, task.estimates, strict=True)
    ]


def preset(runs: int) -> Preset:
    """The paper's grid at so many plants that there are `runs` runs (a multiple of 250)."""
    (point,) = PAPER.points
    points = tuple(
        dataclasses.replace(point, name=str(k), truth=(2.0 + 0.01 * k, 1.5)) for k in range(runs // len(PAPER.cells))
    )
    return dataclasses.replace(PAPER, name="driver", points=points, companion=None)


def measure(runs: int) -> dict[str, float]:
    """Cost by phase."""
    many, console = preset(runs), Console(file=io.StringIO())
    cost, begin = {}, time.perf_counter()

    def lap(phase: str) -> None:
        nonlocal begin
        now = time.perf_counter()
        cost[f"{phase} [ms]"], begin = 1e3 * (now - begin), now

    with tempfile.TemporaryDirectory() as folder:
        with sweep_results(Path(folder), many) as store:
            run(Sweep(many, store), Instant(), console)
            lap("run")
        with sweep_results(Path(folder), many) as store:
            run(Sweep(many, store), Instant(), console)
            lap("go on when all is done")
            kept = store.all(RUNS), store.all(REFERENCES)
            lap("read it back")
            findings = [PointFindings(many, point, *kept) for point in many.points]
            write_rows(Path(folder) / "runs.csv", *run_table(run for answer in findings for run in answer.runs))
            lap("runs.csv")
        cost["folder [kB]"] = 1e-3 * sum(path.stat().st_size for path in Path(folder).iterdir())
    return cost


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure both sizes, then profile the smaller one."""
    parser = command.parser("driver", __doc__)
    parser.add_argument("--runs", nargs="+", type=int, default=[1000, 10_000], help="multiples of 250")
    parser.add_argument("--top", type=int, default=12, help="functions of the profile")
    given = parser.parse_args(arguments)
    costs = {runs: measure(runs) for runs in given.runs}
    phases = costs[given.runs[0]]
    rows = ((phase, *(f"{cost[phase] / runs:.3f}" for runs, cost in costs.items())) for phase in phases)
    print(command.markdown(("a run of", *costs), ("---", *["---:"] * len(costs)), rows))
    profile = cProfile.Profile()
    profile.runcall(measure, given.runs[0])
    pstats.Stats(profile).strip_dirs().sort_stats("tottime").print_stats(given.top)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
