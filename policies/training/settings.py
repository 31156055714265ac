"""What the settings of every algorithm have, and what is refused in each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from sysid import InvalidInput


class TrainingSettings(ABC):
    """How agents train, as a frozen dataclass of plain numbers.

    algorithm     its short name
    hidden        sizes of the hidden layers
    steps         environment steps of each agent, random_steps of them before the first update
    environments  pendulums of each agent, None where an agent has one and no axis for it
    """

    algorithm: ClassVar[str]
    positive: ClassVar[tuple[str, ...]]
    """Names of the numbers that have to be."""
    shares: ClassVar[tuple[str, ...]]
    """Names of those in [0, 1]."""
    hidden: tuple[int, ...]
    steps: int
    random_steps: int
    environments: int | None

    @abstractmethod
    def memory(self, agents: int, observation_size: int) -> float:
        """About how many bytes so many agents take."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(self.hidden))
        if not self.hidden or min(self.hidden) < 1:
            raise InvalidInput(f"hidden = {self.hidden}: expected one or more layer sizes >= 1")
        for name in self.positive:
            if not getattr(self, name) > 0:
                raise InvalidInput(f"{name} = {getattr(self, name)}: expected a positive number")
        for name in self.shares:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InvalidInput(f"{name} = {getattr(self, name)}: expected a number in [0, 1]")
