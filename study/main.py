"""The main job: measure, identify, train, evaluate, answer.

python -m study.main                        quick: minutes on two cores
python -m study.main --preset paper-small   the paper's grid with small networks: the one for CPUs
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from study.mismatch.plan import PLANS
from study.paper.presets import PRESETS

if TYPE_CHECKING:
    from study.pipeline.executor import Executor
    from study.pipeline.experiment import Experiment


@dataclass(frozen=True)
class Options:
    """What is the next real rollout worth, and what does a wider training band cost?

    Runs a preset end to end and writes its answer to a folder. However it is stopped, the same command resumes it.
    """

    preset: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join([*PRESETS, *PLANS])}}}")] = "quick"
    """quick: 18 small agents, minutes. paper: the paper's 250 agents, 256 x 256. paper-w0: of these the 50 that train
    at the estimate alone. paper-small: the same as paper with 64 x 64 networks, the one for CPUs. robustness: two gaps,
    two noise levels and the prior range, the table and the text of the paper. robustness-small: the same, 64 x 64.
    identifiers: n on grid, least squares and Kalman filter. longer, longer-small: the widest band with twice the steps.
    mismatch: does breadth pay when the simulator lacks an effect; mismatch-quick: two of its plants, in minutes. smoke,
    mismatch-smoke: every part once, in a minute; the numbers mean nothing."""

    quick: bool = False
    """With --preset mismatch: mismatch-quick."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: results/PRESET)")] = None
    """Folder of the results."""

    workers: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 0, one a core)")] = 0
    """Processes, each with one thread. The numbers do not depend on it."""

    executor: Annotated[str, tyro.conf.arg(metavar="{processes,ray}")] = "processes"
    """What runs them: processes of this machine, or a Ray cluster whose machines share the folder of results."""

    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="(default: made here)")] = None
    """The Ray cluster, or "auto" for the one that this machine belongs to."""

    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "cpu"
    """Where networks train, as torch names it: cpu, cuda. Anywhere but on a CPU all agents train in one population."""

    import_: Annotated[Path | None, tyro.conf.arg(name="import", metavar="FILE", help_behavior_hint="")] = None
    """Take up the finished runs in another study's results.sqlite or runs.csv."""

    published: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of the authors' per-run CSV files, to pair ours with: results/ of github.com/YTomar79/sim2real_budget."""

    checkpoint_seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0
    """Seconds between checkpoints of a population: about what a crash may cost it."""

    @property
    def command(self) -> str:
        given = {_flag(field): getattr(self, field.name) for field in dataclasses.fields(self)
                 if getattr(self, field.name) != field.default}  # fmt: skip
        return " ".join(["python -m study.main", *(f"{flag} {shlex.quote(str(own))}" for flag, own in given.items())])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code: 0 done, 1 a task failed, 2 bad input, 130 stopped."""
    from study.pipeline import versions

    problem, foreign = versions.wrong_sysid(), versions.foreign_sysid()
    if problem:
        return _fail(f"{foreign or problem}", 2)
    if foreign:
        print(f"warning: {foreign}", file=sys.stderr)

    from sysid.cli.command_line import called

    options, unknown = tyro.cli(Options, prog=called("python -m study.main"), args=arguments, return_unknown_args=True)
    if unknown:
        known = ", ".join(map(_flag, dataclasses.fields(Options)))
        return _fail(f"unknown option {unknown[0]!r}: expected {known} or --help", 2)
    if options.quick:
        if options.preset != "mismatch":
            return _fail(f"--quick with preset {options.preset!r}: expected --preset mismatch, or --preset quick", 2)
        options = dataclasses.replace(options, preset="mismatch-quick", quick=False)
    signal.signal(signal.SIGTERM, _interrupt)
    return _study(options)


def _study(options: Options) -> int:
    import sqlite3

    from rich.console import Console

    from study.pipeline.executor import WorkerFailed
    from study.pipeline.experiment import run
    from sysid.errors import InvalidInput

    console = Console(highlight=False)
    try:
        if options.preset not in {**PRESETS, **PLANS}:
            raise InvalidInput(f"unknown preset {options.preset!r}: expected one of {', '.join([*PRESETS, *PLANS])}")
        executor = _executor(options)
        if not 0.0 <= options.checkpoint_seconds < math.inf:
            raise InvalidInput(f"--checkpoint-seconds {options.checkpoint_seconds}: expected a number of seconds >= 0")
        with _experiment(options) as experiment:
            run(experiment, executor, console)
            experiment.publish(console)
    except KeyboardInterrupt:
        print(f"\nstopped; the same command goes on: {options.command}", file=sys.stderr)
        return 130
    except InvalidInput as error:
        return _fail(str(error), 2)
    except (WorkerFailed, OSError, sqlite3.Error) as error:
        return _fail(f"{error}; finished runs are kept, and the same command goes on: {options.command}", 1)
    return 0


@contextlib.contextmanager
def _experiment(options: Options) -> Iterator[Experiment]:
    """The preset's experiment, over the open folder of its results; loads what this one needs alone."""
    from sysid.data.files import place
    from sysid.errors import InvalidInput

    folder, device, seconds = options.out or Path("results", options.preset), options.device, options.checkpoint_seconds
    for path in (folder, options.import_, options.published):
        if path is not None:
            place(path, "use")
    if options.preset in PLANS:
        from study.mismatch.experiment import MismatchExperiment
        from study.mismatch.mismatch_results import MismatchResults

        for name, given in (("--import", options.import_), ("--published", options.published)):
            if given is not None:
                raise InvalidInput(f"{name} {given}: expected a preset of the paper's kind, not {options.preset}")
        plan = PLANS[options.preset]
        with MismatchResults(folder, plan, device) as kept:
            yield MismatchExperiment(plan, kept, seconds)
    else:
        from study.paper.published_runs import read_published
        from study.paper.sweep import Sweep, SweepResults

        preset = PRESETS[options.preset]
        theirs = read_published(options.published) if options.published else None
        with SweepResults(folder, preset, device) as results:
            yield Sweep(preset, results, seconds, options.import_, theirs)


def _executor(options: Options) -> Executor:
    from study.pipeline.cluster import Cluster
    from study.pipeline.processes import Processes
    from study.pipeline.settings import check_device
    from sysid.errors import InvalidInput

    if options.executor not in ("processes", "ray"):
        raise InvalidInput(f"unknown executor {options.executor!r}: expected processes or ray")
    if options.address and options.executor != "ray":
        raise InvalidInput(f"--address {options.address}: expected --executor ray with it; it is that of a Ray cluster")
    if options.address and options.workers:
        raise InvalidInput(f"--workers {options.workers}: expected none with --address, the cluster has its own")
    if options.workers < 0:
        raise InvalidInput(f"--workers {options.workers}: expected a number of processes, or 0 for one a core")
    if options.address:
        return Cluster(options.address)
    check_device(options.device)
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = options.workers or here
    return Cluster(workers=workers) if options.executor == "ray" else Processes(workers)


def _flag(field: dataclasses.Field[object]) -> str:
    return f"--{field.name.rstrip('_').replace('_', '-')}"


def _fail(sentence: str, code: int) -> int:
    print(f"error: {sentence}", file=sys.stderr)
    return code


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
