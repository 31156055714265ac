"""Three identifiers on the same rollouts of the paper's pendulum, against the Cramer-Rao bound.

    python examples/compare_sysid.py                          100 seeds, n up to 50 (UKF: 25 seeds)
    python examples/compare_sysid.py --quick --json out.json  20 seeds, n up to 10 (UKF: 5 seeds)

Two sensor settings: `paper`, the speed with sd 1.0 rad/s and the first angle with sd 0.001 rad (later angles are a
noise-free regressor for the grid only); `encoder`, angles with sd 0.01 rad and the speed with sd 1.0 rad/s.

The paper's protocol reads the speed before and after every step, so each interior instant has two independent
readings. All three identifiers use both, and the bound counts both. The grid takes a pair of them a step;
least squares and the Kalman filter take their mean, along the whole rollout.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process a core; threads inside would only fight

import numpy as np

from study.paper.protocol import averaged_sensor, paper_model, paper_rollouts
from sysid import (
    GridSearch,
    Identifier,
    LeastSquares,
    Record,
    UnscentedKalman,
    fisher_information,
)
from sysid.data.files import full_path
from sysid.errors import InvalidInput
from sysid.limits import check_size

MOST_SEEDS = 10_000

NAMES = ("m", "l")
TRUTH = np.array([2.0, 1.5])
SENSORS = {"paper": averaged_sensor(1.0), "encoder": dataclasses.replace(averaged_sensor(1.0), theta=0.01)}


class Method(NamedTuple):
    """An identifier to compare, its colour and marker, and the share 1 / one_in of the seeds that it runs."""

    label: str
    make: Callable[..., Identifier]
    colour: str
    marker: str
    one_in: int = 1


METHODS = {
    "grid": Method("grid (paper)", GridSearch, "#b5651d", "s"),
    "least_squares": Method("least squares", LeastSquares, "#1b6ca8", "o"),
    "ukf": Method("UKF", UnscentedKalman, "#5a9a5a", "^", one_in=4),
}


@dataclass(frozen=True)
class Task:
    """One fit: sensor setting, identifier, n rollouts, seed."""

    setting: str
    method: str
    n: int
    seed: int


@dataclass(frozen=True)
class Outcome:
    """What a fit gave: error (2,), information (2, 2) of its data, whether the 95 % intervals held (2,), seconds.

    same_optimum: whether a fit that starts at the truth ends at the same cost (None: not asked of this identifier).
    """

    task: Task
    error: np.ndarray
    information: np.ndarray
    covered: np.ndarray
    seconds: float
    same_optimum: bool | None


def measure(setting: str, n: int, seed: int) -> tuple[list[Record], list[Record]]:
    """n rollouts of the true pendulum as the setting's sensor reads them, step by step for the grid, and whole."""
    rollouts = paper_rollouts(paper_model(*TRUTH), n, np.random.default_rng(seed))
    rng, steps, whole = np.random.default_rng([seed, 1]), list[Record](), list[Record]()
    for rollout in rollouts:
        if setting == "encoder":
            theta = rollout.theta + 0.01 * rng.standard_normal(len(rollout.theta))
            steps += dataclasses.replace(rollout, theta=theta).transitions
        else:
            theta = rollout.theta[:1] + 0.001 * rng.standard_normal()
            steps += rollout.transitions
        whole.append(dataclasses.replace(rollout.averaged, theta=theta))
    return steps, whole


def run(task: Task) -> Outcome:
    """Fit from the prior (1, 1), and weigh the error by the information that the same readings carry."""
    steps, records = measure(task.setting, task.n, task.seed)
    method = METHODS[task.method].make(NAMES, sensor=SENSORS[task.setting])
    begin = time.perf_counter()
    estimate = method.fit(paper_model(), steps if task.method == "grid" else records)
    seconds = time.perf_counter() - begin
    same = None
    if isinstance(method, LeastSquares):
        from_truth = dataclasses.replace(method, starts=1).fit(paper_model(*TRUTH), records)
        same = estimate.success and estimate.cost <= from_truth.cost + 0.01
    clean = paper_rollouts(paper_model(*TRUTH), task.n, np.random.default_rng(task.seed), sigma=0.0)
    starts = np.array([[r.theta[0], r.before[0]] for r in clean])
    low, high = np.array([estimate.interval()[name] for name in NAMES]).T
    return Outcome(
        task=task,
        error=np.array([estimate.values[name] for name in NAMES]) - TRUTH,
        information=fisher_information(paper_model(*TRUTH), NAMES, records, SENSORS[task.setting], starts),
        covered=(low <= TRUTH) & (high >= TRUTH),
        seconds=seconds,
        same_optimum=same,
    )


@dataclass(frozen=True)
class Row:
    """The statistics of one identifier at one n over seeds; rms and crb are of m [kg] and l [m], crb by the bound."""

    setting: str
    method: str
    n: int
    seeds: int
    rms: np.ndarray
    crb: np.ndarray
    ratio: float
    coverage: float
    seconds: float
    same_optimum: float | None


def summarise(outcomes: Sequence[Outcome]) -> Row:
    """RMS errors, bound, ratio = sqrt(mean(e' F e) / 2), coverage over both parameters, median seconds."""
    task = outcomes[0].task
    error = np.array([o.error for o in outcomes])
    information = np.array([o.information for o in outcomes])
    bound = np.linalg.inv(information)
    same = [o.same_optimum for o in outcomes if o.same_optimum is not None]
    return Row(
        setting=task.setting,
        method=task.method,
        n=task.n,
        seeds=len(outcomes),
        rms=np.sqrt(np.mean(error**2, axis=0)),
        crb=np.sqrt(np.mean(np.diagonal(bound, axis1=1, axis2=2), axis=0)),
        ratio=float(np.sqrt(np.mean(np.einsum("si,sij,sj->s", error, information, error)) / 2.0)),
        coverage=float(np.mean([o.covered for o in outcomes])),
        seconds=float(np.median([o.seconds for o in outcomes])),
        same_optimum=float(np.mean(same)) if same else None,
    )


def compare(tasks: Sequence[Task], workers: int) -> Iterator[Row]:
    """Rows in the order of the tasks, each as soon as its seeds are done."""
    groups: dict[tuple[str, str, int], list[Outcome]] = {}
    expected: dict[tuple[str, str, int], int] = {}
    for task in tasks:
        key = (task.setting, task.method, task.n)
        expected[key] = expected.get(key, 0) + 1
    with ProcessPoolExecutor(workers) as pool:
        for outcome in pool.map(run, tasks):
            key = (outcome.task.setting, outcome.task.method, outcome.task.n)
            groups.setdefault(key, []).append(outcome)
            if len(groups[key]) == expected[key]:
                yield summarise(groups.pop(key))


HEADER = (
    f"{'sensing':8} {'identifier':14} {'n':>3} {'seeds':>5}  {'RMS m [kg]':>10} {'bound':>8}"
    f"  {'RMS l [m]':>10} {'bound':>8}  {'ratio':>7}  {'coverage':>8}  {'s / fit':>7}  {'as from truth':>13}"
)


def line(row: Row) -> str:
    """One line of the table."""
    same, label = "" if row.same_optimum is None else f"{row.same_optimum:.0%}", METHODS[row.method].label
    return (
        f"{row.setting:8} {label:14} {row.n:3d} {row.seeds:5d}  {row.rms[0]:10.5f} {row.crb[0]:8.5f}"
        f"  {row.rms[1]:10.5f} {row.crb[1]:8.5f}  {row.ratio:7.2f}  {row.coverage:8.0%}  {row.seconds:7.3f}  {same:>13}"
    )


def to_json(rows: Sequence[Row]) -> dict[str, dict[str, dict[str, list[float | None]]]]:
    """{setting: {method: {n, rms_error, crb, ratio, coverage, seconds, ...}}}; rms_error and crb are Euclidean."""
    by_setting: dict[str, dict[str, dict[str, list[float | None]]]] = {}
    for row in rows:
        entry = by_setting.setdefault(row.setting, {}).setdefault(row.method, {})
        numbers = {
            "n": row.n,
            "seeds": row.seeds,
            "rms_error": float(np.linalg.norm(row.rms)),
            "crb": float(np.linalg.norm(row.crb)),
            "ratio": row.ratio,
            "coverage": row.coverage,
            "seconds": row.seconds,
            "as_from_truth": row.same_optimum,
        }
        for name, number in numbers.items():
            entry.setdefault(name, []).append(number)
    return by_setting


def draw(rows: Sequence[Row], path: Path) -> None:
    """RMS error of m and l over n, with the bound, for both settings."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(9, 6.5), sharex=True, sharey="row", layout="constrained")
    ticks = sorted({row.n for row in rows})
    for j, setting in enumerate(SENSORS):
        for i, (parameter, unit) in enumerate((("m", "kg"), ("l", "m"))):
            ax = axes[i, j]
            for name, method in METHODS.items():
                chosen = [r for r in rows if (r.setting, r.method) == (setting, name)]
                ax.plot([r.n for r in chosen], [r.rms[i] for r in chosen], color=method.colour, marker=method.marker,
                        label=method.label)  # fmt: skip
                if name == "least_squares":
                    bound = [r.crb[i] for r in chosen]
                    ax.plot(ticks, bound, color="black", linestyle="--", label="Cramér-Rao bound", zorder=5)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_xticks(ticks, [str(n) for n in ticks])
            ax.minorticks_off()
            ax.grid(alpha=0.25)
            ax.spines[["top", "right"]].set_visible(False)
            if j == 0:
                ax.set_ylabel(f"RMS error of {parameter} [{unit}]")
            if i == 0:
                ax.set_title(
                    "paper's sensing: speed only (sd 1 rad/s)" if j == 0 else "encoder: angle too (sd 0.01 rad)"
                )
            else:
                ax.set_xlabel("rollouts n")
    axes[0, 0].legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _writable(path: Path) -> bool:
    existing = next(p for p in (path.parent, *path.absolute().parents) if p.exists())
    return existing.is_dir() and os.access(existing, os.W_OK)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; exit code 2 with one sentence where a file cannot be written."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0], epilog="Figures of merit are explained in the docstring."
    )
    parser.add_argument("--quick", action="store_true", help="n = 1, 5, 10 with 20 seeds")
    parser.add_argument("--seeds", type=int, metavar="N", help="other than 100 or, quick, 20; the UKF runs a quarter")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers as JSON")
    parser.add_argument(
        "--figure", type=Path, default=Path("results/compare_sysid.png"), metavar="FILE", help="default: %(default)s"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: %(default)s)")
    options = parser.parse_args(arguments)
    count = (20 if options.quick else 100) if options.seeds is None else options.seeds
    if options.workers < 1 or count < 1:
        parser.error(f"--workers {options.workers}, --seeds {count}: expected at least 1")
    try:
        check_size("--seeds", count, MOST_SEEDS)
        for path in filter(None, (options.json, options.figure)):
            full_path(path, "write")
    except InvalidInput as error:
        parser.error(str(error))
    if options.figure.suffix.lower() not in (".png", ".pdf", ".svg"):
        parser.error(f"--figure {options.figure}: expected a file name that ends in .png, .pdf or .svg")
    for path in (options.json, options.figure):
        if path is not None and (path.is_dir() or not _writable(path)):
            parser.error(f"cannot write {path}: expected the name of a file in a folder that can be written")

    ns = (1, 5, 10) if options.quick else (1, 2, 5, 10, 25, 50)
    seeds = {name: max(1, count // method.one_in) for name, method in METHODS.items()}
    tasks = [Task(s, m, n, k) for s in SENSORS for m in METHODS for n in ns for k in range(seeds[m])]
    print(HEADER)
    rows = []
    for row in compare(tasks, options.workers):
        rows.append(row)
        print(line(row), flush=True)
    print(
        "ratio = sqrt(mean(e' F e) / 2): 1 is the Cramer-Rao bound of the same readings.  "
        f"coverage: of the 95 % intervals.\nThe UKF runs {seeds['ukf']} seeds, the others {seeds['grid']}.  "
        "as from truth: fits from (1, 1) that end at the optimum of a fit from the truth."
    )
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(to_json(rows), indent=1) + "\n", encoding="utf-8")
        print(f"numbers: {options.json}")
    draw(rows, options.figure)
    print(f"figure: {options.figure}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
