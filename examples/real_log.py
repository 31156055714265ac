"""The loop on a log of a real rig: fit, compare, diagnose, compare again; with the commands that do it.

    python examples/real_log.py LOG.csv [--plant point] [--out DIR] [--from 0 --to 4.6 ...]

Columns are found by their names (time_s, angle_rad, velocity_rad_s, torque_meas_Nm ...). Where a LOG.json lies beside
the log and says that angle 0 hangs down, that is heeded. Without --plant it is a joint of inertia J and gravity torque
G, of which a pendulum of any shape shows no more. A log without a torque but with a duty cycle is read with that: J, G
and all torques then come in units of the torque at full duty.
"""

from __future__ import annotations

import csv
import json
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import Positional, arg

from sysid.__main__ import main as command_line

NAMES = {
    "t": ("t", "time_s", "time", "timestamp"),
    "theta": ("theta", "angle_rad", "angle", "pos"),
    "theta_dot": ("theta_dot", "velocity_rad_s", "velocity", "vel"),
    "torque": ("torque", "torque_meas_Nm", "u", "tau", "torque_cmd_Nm", "duty_meas"),
}


def columns(log: Path) -> str:
    """The first of each kind of column that holds numbers, as --columns takes them."""
    with open(log, newline="", encoding="utf-8-sig") as file:
        rows = list(csv.DictReader(file))
    filled = [name for name in (rows[0] if rows else {}) if name and any((row[name] or "").strip() for row in rows)]
    chosen = {ours: next((name for name in theirs if name in filled), "") for ours, theirs in NAMES.items()}
    return ",".join(f"{ours}={theirs}" for ours, theirs in chosen.items() if theirs)


def hangs(log: Path) -> bool:
    """Whether a description beside the log says that its angle 0 is the hanging position."""
    beside = log.with_suffix(".json")
    return beside.is_file() and "hanging" in str(json.loads(beside.read_text(encoding="utf-8")).get("sign_convention"))


def run(*arguments: str) -> int:
    """One command, said and done."""
    print(f"\n$ python -m sysid {shlex.join(arguments)}", flush=True)
    return command_line(arguments)


def walk(log: Path, out: Path, reading: list[str], plant: str) -> int:
    """The loop; returns the exit code of the first command that fails."""
    out.mkdir(parents=True, exist_ok=True)
    model, better = str(out / "model.json"), str(out / "better.json")
    reading = [str(log), "--columns", columns(log), *(["--zero", "hanging"] if hangs(log) else []), *reading]
    return (
        run("fit", *reading, "--plant", plant, "-o", model)
        or run("compare", *reading, "--model", model, "--figure", str(out / "before.png"))
        or run("diagnose", *reading, "--model", model, "--json", str(out / "diagnosis.json"), "-o", better)
        or run("compare", *reading, "--model", better, "--figure", str(out / "after.png"))
    )


@dataclass(frozen=True)
class Options:
    """The loop on a log of a real rig: fit, compare, diagnose, compare again.

    Any option about the log that `python -m sysid fit --help` lists may follow, such as --from 0 --to 4.6.
    """

    log: Annotated[Positional[Path], arg(metavar="LOG.csv")]
    """The log; a LOG.json beside it may say that its angle 0 hangs down."""

    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: results/LOG)")] = None
    """Folder for models, answers and figures."""

    plant: Annotated[str, arg(metavar="{rod,point,joint,axis}")] = "joint"
    """What kind of machine it is."""


def main() -> int:
    """Run the example; returns the exit code: 0 done, 2 bad input."""
    options, reading = tyro.cli(Options, return_unknown_args=True)
    if not options.log.is_file():
        print(f"error: no such file: {options.log}", file=sys.stderr)
        return 2
    return walk(options.log, options.out or Path("results") / options.log.stem, reading, options.plant)


if __name__ == "__main__":
    sys.exit(main())
