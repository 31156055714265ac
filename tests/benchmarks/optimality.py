"""python -m tests.benchmarks.optimality: what it costs until agents are near the optimum.

On three plants (the paper's rod of 2 kg and 1.5 m: plain, with dry friction of 1.5 N m, with a delay of 0.155 s) agents
train with settings that are given by name. Some times a training their policies play 100 start states; the answer is
the processor time and the steps after which their median return is within 5 % and 2 % of the optimum, which dynamic
programming finds on the same plant with the commands under way in its state.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from policies import Fixed, Population, SACSettings, fresh_start_states, tune_cpu
from policies.control.references import references
from policies.environments.machine import past_commands_needed
from policies.evaluation import batch_returns
from study.paper.protocol import paper_model
from sysid import Coulomb, Delay, Model

PLANTS = {"plain": (), "friction": (Coulomb(tau_c=1.5),), "delay": (Delay(T=0.155),)}
WITHIN = (0.05, 0.02)
COLUMNS = ("plant", "settings", "history", "agents", "steps", "cpu_seconds", "median", "lowest", "highest", "optimum")
STARTS = 100


def plant(name: str) -> Model:
    """The machine of that name."""
    return dataclasses.replace(paper_model(m=2.0, l=1.5), effects=PLANTS[name])


def settings_of(changes: Sequence[str], hidden: int, steps: int) -> SACSettings:
    """Those of `policies train` for such networks, but for changes as "polyak=0.01"."""
    changed = {
        name: type(getattr(SACSettings(), name))(value) for name, _, value in (c.partition("=") for c in changes)
    }
    return dataclasses.replace(SACSettings(hidden=(hidden, hidden), steps=steps), **changed)


def curve(model: Model, settings: SACSettings, history: int, agents: int, looks: int) -> Iterator[tuple]:
    """(steps, CPU seconds, returns (agents,)) some times a training; judging them is not counted."""
    starts, spent = fresh_start_states(0, STARTS), 0.0
    population = Population(model, [Fixed()] * agents, range(agents), settings, history=history)
    for look in range(1, looks + 1):
        begin = time.process_time()
        population.train(math.ceil(look * settings.steps / looks) - population.steps_done)
        spent += time.process_time() - begin
        yield population.steps_done, spent, batch_returns(population.policies(), model, *starts).mean(1)


def reached(rows: Sequence[dict], within: float) -> str:
    """When the median was first so near."""
    near = [row for row in rows if row["median"] >= row["optimum"] * (1.0 + within)]
    return f"{near[0]['cpu_seconds']:.0f} s, {near[0]['steps']:,} steps" if near else "never"


def main(arguments: Sequence[str] | None = None) -> int:
    """Train, print a line a plant, and append what was measured to a table."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.optimality", description=__doc__.splitlines()[0])
    parser.add_argument("--plants", nargs="+", choices=PLANTS, default=list(PLANTS))
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="fields of SACSettings")
    parser.add_argument("--history", type=int, help="past commands observed; by default as many as the delay needs")
    parser.add_argument("--hidden", type=int, default=64)
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--steps", type=int, default=75_000)
    parser.add_argument("--looks", type=int, default=15)
    parser.add_argument("--csv", type=Path, help="a table to append to")
    given = parser.parse_args(arguments)
    known = [field.name for field in dataclasses.fields(SACSettings)]
    unknown = [change for change in given.set if change.partition("=")[0] not in known]
    if unknown:
        parser.error(f"--set {unknown[0]}: expected a field of SACSettings: {', '.join(known)}")
    tune_cpu(threads=1)
    settings = settings_of(given.set, given.hidden, given.steps)
    for name in given.plants:
        model = plant(name)
        optimum = references(model, *fresh_start_states(0, STARTS))[0].evaluation.mean
        history = past_commands_needed(model) if given.history is None else given.history
        rows = []
        for steps, spent, returns in curve(model, settings, history, given.agents, given.looks):
            named = (name, " ".join(given.set) or "default", history, given.agents, steps, round(spent, 1))
            numbers = (float(np.median(returns)), returns.min(), returns.max(), optimum)
            rows.append(dict(zip(COLUMNS, (*named, *(round(float(x), 1) for x in numbers)), strict=True)))
            print("  ".join(f"{key} {value}" for key, value in rows[-1].items()), flush=True)
            if given.csv:
                _append(given.csv, rows[-1])
        print(f"{name}: " + "; ".join(f"within {100 * w:.0f} %: {reached(rows, w)}" for w in WITHIN), flush=True)
    return 0


def _append(file: Path, row: dict) -> None:
    new = not file.exists()
    with file.open("a", newline="") as opened:
        table = csv.DictWriter(opened, COLUMNS, lineterminator="\n")
        if new:
            table.writeheader()
        table.writerow(row)


if __name__ == "__main__":
    raise SystemExit(main())
