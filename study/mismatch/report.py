"""Publishes the experiment: tables, what made them, and the answers in words."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from study import rows
from study.mismatch.answer import Answer, answer
from study.mismatch.plan import Plan
from study.mismatch.results import Results
from study.mismatch.words import sentences
from study.versions import all_versions
from sysid.files import write_whole


@dataclass(frozen=True)
class OutcomeRow:
    """A way at a plant and a budget: returns over seeds, with Student's interval, and the parts of the gap."""

    plant: str
    way: str
    n: int
    seeds: int
    mean: float
    low: float
    high: float
    median: float
    optimum: float
    structure: float
    identification: float
    training: float


@dataclass(frozen=True)
class ContrastRow:
    """A pre-registered contrast a - b; p is Holm's over the family."""

    plant: str
    n: int
    a: str
    b: str
    mean: float
    low: float
    high: float
    median: float
    seeds: int
    p: float


@dataclass(frozen=True)
class TrialRow:
    """The mean return of one agent on a hidden plant."""

    plant: str
    way: str
    n: int
    seed: int
    mean: float


def publish(plan: Plan, results: Results, console: Console) -> Answer:
    """Write the tables into the results' folder and say the answers; returns them."""
    found = answer(plan, results.fits(), results.trainings(), results.designs())
    write_tables(found, results.folder)
    versions = all_versions([agent.versions for agent in results.trainings()])
    record = {
        "command": f"python -m study.main --preset {plan.name}",
        "device": results.device,
        "trials": len(plan.trials),
        "agents": len(results.trainings()),
        "worker_hours": round(found.hours, 3),
        "versions": versions,
        "fingerprint": plan.fingerprint,
        "settings": plan.to_dict(),
    }
    write_whole(results.folder / "study.json", json.dumps(record, indent=1) + "\n")
    for sentence in sentences(found):
        console.print(sentence.replace("[", r"\["))
        console.print()
    return found


def write_tables(found: Answer, folder: Path) -> None:
    """trials.csv, outcomes.csv, contrasts.csv."""
    trials, outcomes = [], []
    for spot, own in found.outcomes.items():
        trials += [TrialRow(*spot, seed, float(mean)) for seed, mean in zip(own.seeds, own.returns, strict=True)]
        mean, split = own.mean, own.split
        parts = (split.structure, split.identification, split.training) if split else (float("nan"),) * 3
        optimum = found.optima[spot.plant]
        outcomes.append(OutcomeRow(*spot, len(own.seeds), mean.mean, mean.low, mean.high, own.median, optimum, *parts))
    contrasts = [
        ContrastRow(
            c.plant, c.n, c.a, c.b, c.contrast.mean, c.contrast.low, c.contrast.high, c.median, c.contrast.seeds, c.p
        )
        for c in found.compared
    ]
    rows.write(TrialRow, folder / "trials.csv", trials)
    rows.write(OutcomeRow, folder / "outcomes.csv", outcomes)
    rows.write(ContrastRow, folder / "contrasts.csv", contrasts)
