"""The results of the mismatch experiment: one SQLite file, tied to one plan, device and version.

FITS        what a strategy made of n rollouts of a hidden plant, by (plant, strategy, n, seed)
TRAININGS   returns on the hidden plants of an agent, by the key of what it was trained on; its weights lie in files
DESIGNS     returns on a hidden plant of a near-optimal policy, by the key of the model that it was designed on
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study.mismatch.plan import MISMATCH_FORMAT, TrialKey
from study.pipeline.database import Database, identity
from study.pipeline.policy_files import FOLDER
from study.pipeline.settings import StudySettings
from study.pipeline.tables import ResultTable

OUTPUTS = (
    "study.json", "trials.csv", "outcomes.csv", "contrasts.csv", "report.html", FOLDER,
    "returns.png", "ladder.png", "trajectories.png",
)  # fmt: skip
"""What the experiment writes beside its database; never over files of somebody else."""


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

    @property
    def trial(self) -> TrialKey:
        return TrialKey(self.plant, self.strategy, self.n, self.seed)


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


FITS = ResultTable(
    "fits", Fitted, "plant TEXT, strategy TEXT, n INTEGER, seed INTEGER, payload TEXT, seconds REAL", keys=4
)
TRAININGS = ResultTable("trainings", Trained, "key TEXT, returns TEXT, curve TEXT, versions TEXT, seconds REAL", keys=1)
DESIGNS = ResultTable("designs", Designed, "plant TEXT, model TEXT, seed INTEGER, returns TEXT, seconds REAL", keys=3)


class MismatchResults(Database):
    """The open results folder of a plan."""

    def __init__(self, folder: Path, plan: StudySettings, device: str = "cpu") -> None:
        self.device = device
        tied = identity(plan, f"mismatch {MISMATCH_FORMAT}", device)
        super().__init__(folder, tied, (FITS, TRAININGS, DESIGNS), OUTPUTS)
