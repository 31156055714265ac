"""The main job: measure, identify, train, evaluate, answer.

python -m study.main                        quick: minutes on two cores
python -m study.main --preset paper-small   the paper's grid with small networks: the one for CPUs
"""

from __future__ import annotations

import math
import os
import shlex
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from study.presets import ABOUT, PRESETS
from sysid.cli.command_line import called, entry_point

if TYPE_CHECKING:
    from study.pipeline.executor import Executor
    from study.pipeline.settings import RunOptions


@dataclass(frozen=True)
class Options:
    """What is the next real rollout worth, and what does a wider training band cost?

    Runs a preset end to end and writes its answer to a folder. However it is stopped, the same command resumes it.
    """

    preset: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(PRESETS)}}}", help=ABOUT)] = "quick"

    strategies: Annotated[str, tyro.conf.arg(metavar="NAME,...", help_behavior_hint="(default: all)")] = ""
    """Of a preset that compares strategies these alone: names, or FILE.py:CLASS for one of your own."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="(default: results/PRESET)")] = None
    """Folder of the results."""

    workers: Annotated[int, tyro.conf.arg(metavar="N", help_behavior_hint="(default: 0, one a core)")] = 0
    """Processes, each with one thread. The numbers do not depend on it."""

    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT", help_behavior_hint="")] = None
    """A Ray cluster that runs the study in place of processes of this machine, or "auto" for the one that this machine
    belongs to. Its machines share the folder of results."""

    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "cpu"
    """Where networks train, as torch names it: cpu, cuda. Anywhere but on a CPU up to 500 agents train together."""

    import_: Annotated[Path | None, tyro.conf.arg(name="import", metavar="FILE", help_behavior_hint="")] = None
    """Take up the finished runs in another study's runs.csv, or of strategies its cases.csv."""

    published: Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Folder of the authors' per-run CSV files, to pair ours with: results/ of github.com/YTomar79/sim2real_budget."""

    checkpoint_seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0
    """Seconds between checkpoints of a population: about what a crash may cost it."""


@entry_point
def main(arguments: Sequence[str]) -> int:
    """Run the command line.

    Returns the exit code: 0 done, 1 a task failed or nobody reads on, 2 bad input, 130 stopped.
    """
    program = called("python -m study.main")
    options = tyro.cli(Options, prog=program, args=arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    return _study(options, f"{program} {shlex.join(arguments)}".strip())


def _study(options: Options, command: str) -> int:
    """Run the study; command: what goes on with it."""
    import sqlite3

    from rich.console import Console

    from study.pipeline.executor import WorkerFailed
    from study.pipeline.stages import run
    from study.presets import open_experiment
    from sysid.errors import InvalidInput

    console = Console(highlight=False)
    try:
        if options.preset not in PRESETS:
            raise InvalidInput(f"unknown preset {options.preset!r}: expected one of {', '.join(PRESETS)}")
        executor = _executor(options)
        if not 0.0 <= options.checkpoint_seconds < math.inf:
            raise InvalidInput(f"--checkpoint-seconds {options.checkpoint_seconds}: expected a number of seconds >= 0")
        with open_experiment(PRESETS[options.preset], _run_options(options)) as experiment:
            run(experiment, executor, console)
            experiment.publish(console)
    except KeyboardInterrupt:
        print(f"\nstopped; the same command goes on: {command}", file=sys.stderr)
        return 130
    except InvalidInput as error:
        return _fail(str(error), 2)
    except BrokenPipeError:
        raise
    except (WorkerFailed, OSError, sqlite3.Error) as error:
        return _fail(f"{error}; finished runs are kept, and the same command goes on: {command}", 1)
    return 0


def _run_options(options: Options) -> RunOptions:
    """Raises InvalidInput for a path that the system refuses."""
    from study.pipeline.settings import RunOptions
    from sysid.data.files import full_path

    folder = options.out or Path("results", options.preset)
    for path in (folder, options.import_, options.published):
        if path is not None:
            full_path(path, "use")
    chosen = tuple(filter(None, options.strategies.split(",")))
    return RunOptions(folder, options.device, options.checkpoint_seconds, options.import_, options.published, chosen)


def _executor(options: Options) -> Executor:
    from study.pipeline.cluster import Cluster
    from study.pipeline.executor import Processes
    from study.pipeline.settings import check_device
    from sysid.errors import InvalidInput

    if options.address and options.workers:
        raise InvalidInput(f"--workers {options.workers}: expected none with --address, the cluster has its own")
    if options.workers < 0:
        raise InvalidInput(f"--workers {options.workers}: expected a number of processes, or 0 for one a core")
    if options.address:
        return Cluster(options.address)
    check_device(options.device)
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Processes(options.workers or here)


def _fail(sentence: str, code: int) -> int:
    print(f"error: {sentence}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
