"""What is the model missing? A log with hidden effects, and the way from "the model is off" to the mended model.

    python examples/hidden_effect.py                      about 20 s; draws results/hidden_effect.png
    python examples/hidden_effect.py --html report.html   also the report that `sysid diagnose --html` writes
    python examples/hidden_effect.py --only-log           only writes the log, for commands of your own

A rod is swung by random steps of torque. Its joint has dry friction of 0.15 N m and its drive is 2.5 samples late; the
model knows neither. The truth is integrated in steps of 1 ms, the model's in steps of 10 ms. What happens then is what
happens to a log of yours: it is read from CSV files, a model is fitted, compared with rollouts that the fit never saw,
diagnosed, mended. The command line does the same:

    python -m sysid diagnose results/hidden_effect/swing*.csv
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sysid import Diagnosis, Log, Record

DT = 0.02  # [s]
HIDDEN = {"coulomb.tau_c": 0.15, "delay.T": 2.5 * DT}  # [N m], [s]
ROLLOUTS, SAMPLES = 8, 400


def swings(seed: int) -> list[Record]:
    """What the rig logs: angle with 0.003 rad and speed with 0.05 rad/s of noise, at 50 Hz."""
    import numpy as np

    import sysid
    from sysid.planning.excitation import steps

    rng = np.random.default_rng(seed)
    effects = (sysid.Coulomb(HIDDEN["coulomb.tau_c"]), sysid.Delay(HIDDEN["delay.T"]))
    truth = sysid.Model(sysid.RodPendulum(m=1.04, l=0.97, g=9.81), effects, sysid.RK4(substeps=20), dt=DT)
    u = np.stack([steps(rng, SAMPLES, DT, 2.0, 0.4) for _ in range(ROLLOUTS)])
    theta = math.pi + rng.uniform(-0.8, 0.8, ROLLOUTS)
    return sysid.Sensor(0.003, 0.05).measure(sysid.simulate(truth, u, theta, np.zeros(ROLLOUTS)), rng)


def walk(files: Sequence[Path]) -> tuple[Log, Diagnosis]:
    """Read, fit, compare, diagnose; each answer is printed."""
    import sysid

    say("read", log := sysid.read(files))
    say("noise", noise := sysid.sensor_noise(log))
    training, held_out = sysid.split(log)
    model = sysid.Model(sysid.RodPendulum(g=9.81), integrator=sysid.RK4(substeps=2), dt=log.dt)
    say("fit", estimate := sysid.fit(model, training, noise.sensor))
    say("compare", sysid.compare(estimate, held_out))
    say("diagnose", diagnosis := sysid.diagnose(estimate, log))
    say("better", better := diagnosis.estimate)
    for name, truth in HIDDEN.items():
        low, high = better.interval().get(name, (math.nan, math.nan))
        print(f"  hidden: {name} = {truth:g}, found: 95 % [{low:.4g}, {high:.4g}]")
    return log, diagnosis


def say(question: str, answer: object) -> None:
    """A question and its answer."""
    print(f"--- {question} {'-' * (114 - len(question))}\n{answer}\n", flush=True)


def draw(diagnosis: Diagnosis, log: Log, path: Path) -> None:
    """The error falling to the noise, and a rollout that no fit has seen, before and after."""
    import matplotlib
    from matplotlib.figure import Figure

    from sysid.report.figure_style import STYLE
    from sysid.report.figures import course_in, fall_in, residual_in

    paths = diagnosis.predictions
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 4.0), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=[1.0, 1.25])
        axes = left.subplots()
        fall_in(axes, diagnosis)
        axes.set_title("The error on rollouts that no fit has seen")
        above, below = right.subplots(2, 1, sharex=True, height_ratios=[1.6, 1.0])
        course_in(above, paths, "theta", ("as it came", "mended"))
        above.legend(ncols=3, loc="lower left", bbox_to_anchor=(-0.02, 1.0), fontsize=9.0)
        residual_in(below, paths, "theta", diagnosis.sensor.theta)
        below.set_xlabel("time [s]")
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; exit code 2 with one sentence where a file cannot be written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="of torques, starts and noise (default: %(default)s)")
    parser.add_argument(
        "--log", type=Path, default=Path("results/hidden_effect"), metavar="FOLDER", help="default: %(default)s"
    )
    parser.add_argument(
        "--figure", type=Path, default=Path("results/hidden_effect.png"), metavar="FILE", help="default: %(default)s"
    )
    parser.add_argument("--only-log", action="store_true", help="write the log, and ask nothing of it")
    parser.add_argument("--html", type=Path, metavar="FILE", help="also write the report, which opens offline")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the diagnosis as JSON")
    options = parser.parse_args(arguments)
    from sysid.data.files import full_path
    from sysid.errors import InvalidInput

    try:
        for path in filter(None, (options.log, options.json, options.html, options.figure)):
            full_path(path, "write")
    except InvalidInput as error:
        parser.error(str(error))
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: expected 0 or more")
    if options.figure.suffix.lower() not in (".png", ".pdf", ".svg"):
        parser.error(f"--figure {options.figure}: expected a file name that ends in .png, .pdf or .svg")
    for path in (options.json, options.html, options.figure):
        if path is not None and (path.is_dir() or not _writable(path)):
            parser.error(f"cannot write {path}: expected the name of a file in a folder that can be written")
    if options.log.is_file() or not _writable(options.log):
        parser.error(f"cannot write {options.log}: expected a folder that can be written")

    import sysid

    options.log.mkdir(parents=True, exist_ok=True)
    files = [options.log / f"swing{k}.csv" for k in range(1, ROLLOUTS + 1)]
    for record, file in zip(swings(options.seed), files, strict=True):
        sysid.write_csv(record, file)
    if options.only_log:
        print(f"log: {options.log}/swing1.csv to swing{ROLLOUTS}.csv")
        return 0
    log, diagnosis = walk(files)
    draw(diagnosis, log, options.figure)
    print(f"\nlog: {options.log}\nfigure: {options.figure}")
    if options.html is not None:
        from sysid.report.write import write_report

        options.html.parent.mkdir(parents=True, exist_ok=True)
        write_report(diagnosis, options.html)
        print(f"report: {options.html}")
    if options.json is not None:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(diagnosis.to_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
        print(f"numbers: {options.json}")
    return 0


def _writable(path: Path) -> bool:
    existing = next(p for p in (path, *path.absolute().parents) if p.exists())
    return (existing.is_dir() or existing == path) and os.access(existing, os.W_OK)


if __name__ == "__main__":
    sys.exit(main())
