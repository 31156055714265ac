"""The results of the strategies experiment: one SQLite file, tied to one plan, device and version.

STEPS       how far each case's dialogue came in each round: what it asked for, or what it gave back in the end
TRAININGS   returns on the hidden plants of an agent, as in the mismatch experiment; policies lie in files
DESIGNS     returns of the near-optimal policy, as there
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from study.mismatch.mismatch_results import DESIGNS, TRAININGS
from study.pipeline.database import Database, identity
from study.pipeline.policy_files import FOLDER
from study.pipeline.settings import StudySettings
from study.pipeline.tables import ResultTable
from study.strategies.plan import STRATEGIES_FORMAT, Case

NETWORKS = "networks"
"""Folder of the critics of agents that go on learning on a plant."""

OUTPUTS = (
    "study.json",
    "cases.csv",
    "outcomes.csv",
    "contrasts.csv",
    "report.html",
    "returns.png",
    "simulated.png",
    FOLDER,
    NETWORKS,
)
"""What the experiment writes beside its database; never over files of somebody else."""


@dataclass(frozen=True)
class CaseRound:
    """A round of a case. payload, plain data:

    setups   by key, TrainingSetups to train on (TrainingSetup.to_json)
    learn    (key, start's key or "", rollouts) of an agent that learns on the plant; None without one
    answer   what the strategy gave back, with what it spent (`experiment.payload_of`): it is the last round
    """

    plant: str
    sensing: str
    strategy: str
    n: int
    seed: int
    round: int
    payload: dict[str, Any]
    seconds: float

    @property
    def case(self) -> Case:
        return Case(self.plant, self.sensing, self.strategy, self.n, self.seed)


STEPS = ResultTable(
    "steps", CaseRound,
    "plant TEXT, sensing TEXT, strategy TEXT, n INTEGER, seed INTEGER, round INTEGER, payload TEXT, seconds REAL",
    keys=6,
)  # fmt: skip


class StrategiesResults(Database):
    """The open results folder of a plan."""

    def __init__(self, folder: Path, plan: StudySettings, device: str = "cpu") -> None:
        self.device = device
        tied = identity(plan, f"strategies {STRATEGIES_FORMAT}", device)
        super().__init__(folder, tied, (STEPS, TRAININGS, DESIGNS), OUTPUTS)
