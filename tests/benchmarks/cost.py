"""python -m tests.benchmarks.cost: what `python -m sysid diagnose` takes, from 3,200 to 200,000 samples.

Eight rollouts of the machine with dry friction go through files and a process of its own, as a user runs it: wall time,
processor time and peak memory of that process, its start included. The slope is that of log time, and of log memory,
over log samples from one size to the next: 1 is linear. A log at 1 kHz is thinned by the command, unless --keep-rate.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from sysid import write_csv
from tests.benchmarks import command
from tests.benchmarks.experiments import ENCODER, Log, World, move, plan, write

VERDICTS = ("adequate", "missing", "partly", "unknown", "cannot tell")
HIDDEN = {"coulomb.tau_c": 0.12}  # [N m]
SIZES = {  # samples: how a rig logs that many
    3_200: Log(rate=50.0, seconds=8.0),
    20_000: Log(rate=100.0, seconds=25.0),
    200_000: Log(rate=1000.0, seconds=25.0, theta=0.0005, angle_step=ENCODER),
}

# The system counts in a process's peak memory what its parent held as it was started, so its parent is a small one.
STARTER = """
import json, os, sys
process = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ)
_, status, used = os.wait4(process, 0)
print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss]))
sys.exit(os.waitstatus_to_exitcode(status))
"""


@dataclass(frozen=True)
class Cost:
    """Of a process: wall and processor time [s], peak memory [MB], and its verdict."""

    samples: int
    rate: float
    wall: float
    processor: float
    memory: float
    said: str


def logged(log: Log, folder: Path, seed: int = 0) -> list[Path]:
    """The files of a log of the machine with dry friction."""
    rng = np.random.default_rng(seed)
    world = World(plan("steps", log, rng), HIDDEN, 0.0, log)
    (motion,) = move([world])
    files = [folder / f"swing{k}.csv" for k in range(log.rollouts)]
    for record, file in zip(write(motion, world.plan, log, rng), files, strict=True):
        write_csv(record, file)
    return files


def cost(log: Log, keep_rate: bool = False) -> Cost:
    """What a diagnosis of a log takes. Raises CalledProcessError where it fails."""
    with TemporaryDirectory() as folder:
        files = logged(log, Path(folder))
        rate = ["--dt", f"{log.dt:g}"] if keep_rate else []
        words = [sys.executable, "-m", "sysid", "diagnose", *map(str, files), *rate]
        began = time.perf_counter()
        starter = [sys.executable, "-I", "-S", "-c", STARTER, *words]
        done = subprocess.run(starter, check=False, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8")
        wall = time.perf_counter() - began
    text, _, used = done.stdout.rstrip().rpartition("\n")
    if done.returncode:
        raise subprocess.CalledProcessError(done.returncode, words, text)
    processor, memory = json.loads(used)
    verdict = next((line for line in text.splitlines() if line.startswith(VERDICTS)), text)
    per_mb = 1e6 if sys.platform == "darwin" else 1e3  # the unit of ru_maxrss differs
    samples = log.rollouts * log.samples
    return Cost(samples, log.rate, wall, processor, memory / per_mb, verdict)


def table(costs: Sequence[Cost]) -> str:
    """In Markdown, a size a row."""
    head = "samples", "rate", "wall time", "processor time", "slope", "peak memory", "slope"
    rows = []
    for before, now in zip((None, *costs[:-1]), costs, strict=True):
        slopes = ("", "") if before is None else (_slope(before, now, "processor"), _slope(before, now, "memory"))
        times = f"{now.wall:.1f} s", f"{now.processor:.1f} s"
        rows.append((f"{now.samples:,}", f"{now.rate:g} Hz", *times, slopes[0], f"{now.memory:.0f} MB", slopes[1]))
    return command.markdown(head, ["---:"] * len(head), rows)


def _slope(before: Cost, now: Cost, what: str) -> str:
    grown = math.log(getattr(now, what) / getattr(before, what))
    return f"{grown / math.log(now.samples / before.samples):.2f}"


def main(arguments: list[str] | None = None) -> int:
    """Run, then print."""
    parser = command.parser("cost", __doc__)
    parser.add_argument("--samples", nargs="+", type=int, choices=tuple(SIZES), default=list(SIZES), metavar="SAMPLES")
    parser.add_argument("--keep-rate", action="store_true", help="a fast log is not thinned")
    given = parser.parse_args(arguments)
    costs = []
    for samples in given.samples:
        costs.append(cost(SIZES[samples], given.keep_rate))
        print(f"{samples:,}: {costs[-1].said}", file=sys.stderr, flush=True)
    print(table(costs))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
