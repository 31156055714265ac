"""The results of the mismatch experiment: one SQLite file, tied to one plan, device and version.

fits        what a strategy (in the column `way`) made of n rollouts of a hidden plant, by (plant, strategy, n, seed)
trainings   returns on the hidden plants of an agent, by the key of what it was trained on; its weights lie in files
designs     returns on a hidden plant of a near-optimal policy, by the key of the model that it was designed on
progress    seconds spent on each unfinished population, as of its last checkpoint
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study.mismatch.plan import MISMATCH_FORMAT
from study.pipeline.database import Database, identity
from study.pipeline.policy_files import FOLDER
from study.pipeline.settings import StudySettings

MISMATCH_FIGURES = ("returns", "ladder", "trajectories")
OUTPUTS = (
    "study.json", "trials.csv", "outcomes.csv", "contrasts.csv", "report.html", FOLDER,
    *(f"{name}.png" for name in MISMATCH_FIGURES),
)  # fmt: skip
"""What the experiment writes beside its database; never over files of somebody else."""

MISMATCH_SCHEMA = """
CREATE TABLE fits (
    plant TEXT, way TEXT, n INTEGER, seed INTEGER, payload TEXT, seconds REAL, PRIMARY KEY (plant, way, n, seed));
CREATE TABLE trainings (key TEXT PRIMARY KEY, returns TEXT, curve TEXT, versions TEXT, seconds REAL);
CREATE TABLE designs (
    plant TEXT, model TEXT, seed INTEGER, returns TEXT, seconds REAL, PRIMARY KEY (plant, model, seed));
CREATE TABLE progress (population TEXT PRIMARY KEY, seconds REAL);
"""


@dataclass(frozen=True)
class Fitted:
    """What a strategy made of the n rollouts that a seed draws on a hidden plant.

    payload: the model, the randomization, the verdict, the steps that led there ... as plain data of JSON: its
    containers are lists and dicts of text keys.
    """

    plant: str
    strategy: str
    n: int
    seed: int
    payload: dict[str, Any]
    seconds: float


@dataclass(frozen=True)
class Trained:
    """A trained agent: returns (E,) by hidden plant; curve: (env steps done, return) of the training episodes."""

    key: str
    returns: dict[str, tuple[float, ...]]
    curve: tuple[tuple[int, float], ...]
    versions: dict[str, str]
    seconds: float


@dataclass(frozen=True)
class Designed:
    """Returns (E,) on a hidden plant, from a seed's start states, of dynamic programming on the model of that key."""

    plant: str
    model: str
    seed: int
    returns: tuple[float, ...]
    seconds: float


class MismatchResults(Database):
    """The open results folder of a plan; a context manager that holds the folder's lock.

    What is added takes the place of what stood there under the same key, all of it or nothing.

    Raises InvalidInput where the folder cannot be used, also where it holds foreign files of the names in OUTPUTS;
    adding raises OSError where the file is full, locked or read-only.
    """

    def __init__(self, folder: Path, plan: StudySettings, device: str = "cpu") -> None:
        self.device = device
        super().__init__(folder, MISMATCH_SCHEMA, identity(plan, f"mismatch {MISMATCH_FORMAT}", device), OUTPUTS)

    def add_fits(self, fits: Sequence[Fitted]) -> None:
        """Keep what strategies made of rollouts."""
        self.put("fits", [(f.plant, f.strategy, f.n, f.seed, json.dumps(f.payload), f.seconds) for f in fits])

    def fits(self) -> list[Fitted]:
        """What strategies made of rollouts, sorted by plant, strategy, n, seed."""
        return [
            Fitted(plant, strategy, n, seed, json.loads(payload), seconds)
            for plant, strategy, n, seed, payload, seconds in self.db.execute(
                "SELECT * FROM fits ORDER BY plant, way, n, seed"
            )
        ]

    def add_trainings(self, trainings: Sequence[Trained], population: str | None = None) -> None:
        """Keep trained agents, and forget the progress of the population that they finish."""
        rows = [
            (t.key, json.dumps(t.returns), json.dumps(t.curve), json.dumps(t.versions), t.seconds) for t in trainings
        ]
        self.put("trainings", rows, () if population is None else (population,))

    def trainings(self) -> list[Trained]:
        """The trained agents, sorted by key."""
        return [
            Trained(
                key=key,
                returns={plant: tuple(values) for plant, values in json.loads(returns).items()},
                curve=tuple((step, value) for step, value in json.loads(curve)),
                versions=json.loads(found),
                seconds=seconds,
            )
            for key, returns, curve, found, seconds in self.db.execute("SELECT * FROM trainings ORDER BY key")
        ]

    def add_designs(self, designs: Sequence[Designed]) -> None:
        """Keep what near-optimal policies returned."""
        self.put("designs", [(d.plant, d.model, d.seed, json.dumps(d.returns), d.seconds) for d in designs])

    def designs(self) -> list[Designed]:
        """What near-optimal policies returned, sorted by plant, model, seed."""
        return [
            Designed(plant, model, seed, tuple(json.loads(returns)), seconds)
            for plant, model, seed, returns, seconds in self.db.execute(
                "SELECT * FROM designs ORDER BY plant, model, seed"
            )
        ]
