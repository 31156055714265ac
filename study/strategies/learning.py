"""Strategies that learn on the plant itself, an episode a rollout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from policies.environments.randomization import Ranges
from study.strategies.strategy import Dialogue, Learn, Situation, Strategy, Train
from study.trials.training_setup import TrainingSetup


@dataclass(frozen=True)
class FineTuning(Strategy):
    """An agent that was trained over the whole prior range goes on learning on the plant. Shakerimov, Alizadeh and
    Varol, "Efficient sim-to-real transfer in reinforcement learning through domain randomization and domain
    adaptation", IEEE Access 2023, who take 20 to 50 episodes.

    Changed: SAC goes on with its actor, critics and temperature, and with the memory of the plant alone. A plant has no
    gradient, so the agent is SAC's from the beginning, of `learner_steps`; with no rollout it is deployed as it is.
    """

    short: ClassVar[str] = "fine-tuning"
    source: ClassVar[str] = "Shakerimov 2023"
    group: ClassVar[str] = "plant"
    least: ClassVar[int] = 0

    def spend(self, situation: Situation) -> Dialogue:
        setup = TrainingSetup(situation.prior, Ranges.of(situation.prior, situation.names))
        (agent,) = yield Train((setup,), critics=True)
        return (yield Learn(situation.budget, agent)) if situation.budget else agent


@dataclass(frozen=True)
class FromScratch(Strategy):
    """No simulator: every rollout is an episode of training, by SAC with the settings of the agents in simulation."""

    short: ClassVar[str] = "from scratch"
    group: ClassVar[str] = "plant"

    def spend(self, situation: Situation) -> Dialogue:
        return (yield Learn(situation.budget))
