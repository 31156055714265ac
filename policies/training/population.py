"""Agents trained side by side in one process: each with its own pendulum, randomization, networks and seed.

    population = SHACPopulation(model, [Band({"m": 2.0, "l": 1.5}, w=0.1)] * 3, [0, 1, 2], SHACSettings())
    population.train(population.settings.steps)
    evaluate(population.policies()[0], machine, *start_states(seed=0))

What an agent becomes depends on its own seed and randomization, not on its neighbours.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, ClassVar
from zipfile import BadZipFile, ZipFile

import torch
from torch import Tensor
from torchrl.objectives import LossModule, SoftUpdate

from policies.environments.batched_pendulums import BatchedPendulums
from policies.environments.randomization import Randomization
from policies.limits import TRAINING_MEMORY
from policies.network_policy import NetworkPolicy
from policies.training.networks import layers_of
from sysid import InvalidInput, Model
from sysid.data.files import whole
from sysid.limits import check_size

CHECKPOINT_VERSION = 5


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
        """About how many bytes a training takes.

        Parameters
        ----------
        agents : int
            The number of agents.
        observation_size : int
            The numbers in an observation.

        Returns
        -------
        float
            The bytes.
        """

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


class Population(ABC):
    """Agents trained together, each with pendulums, a randomization, networks and a seed of its own.

    Parameters
    ----------
    model : Model
        The pendulum whose parameters the randomizations draw.
    randomizations : sequence of Randomization (A,)
        What each agent's episodes draw.
    seeds : sequence of int (A,)
        The seed of each agent.
    settings : SACSettings or SHACSettings, optional
        Those of the algorithm; by default as they come.
    device : str, optional
        Where the tensors lie.
    history : int, optional
        How many past commands the agents observe.

    Attributes
    ----------
    settings : SACSettings or SHACSettings
        The settings of the algorithm.
    env : BatchedPendulums
        The pendulums.
    loss : LossModule
        The losses, a module of TorchRL.
    steps_done : int
        The environment steps of each agent.
    seconds : float
        The time [s] that these took, as far as whoever trains has added it up.

    Raises
    ------
    InvalidInput
        For a training that takes too much memory, and as `BatchedPendulums` does.

    Notes
    -----
    `train` advances all agents, `save` and `resume` interrupt and go on. What an agent becomes depends on its own seed
    and randomization, not on its neighbours.
    """

    parts: ClassVar[tuple[str, ...]]
    """Names of what a checkpoint holds the state of."""
    settings_of: ClassVar[type[TrainingSettings]]
    """The algorithm's."""
    differentiable: ClassVar[bool] = False
    """Whether gradients flow through the pendulums."""

    def __init__(
        self,
        model: Model,
        randomizations: Sequence[Randomization],
        seeds: Sequence[int],
        settings: TrainingSettings | None = None,
        device: str = "cpu",
        history: int = 0,
    ) -> None:
        self.settings = settings = self.settings_of() if settings is None else settings
        self.seeds, self.device = tuple(int(s) for s in seeds), torch.device(device)
        self.agents, self.steps_done, self.seconds = len(self.seeds), 0, 0.0
        memory = settings.memory(self.agents, 3 + history)
        check_size("bytes of memory for this training:", memory, TRAINING_MEMORY, "with fewer agents or smaller layers")
        self.env = BatchedPendulums(
            model, randomizations, self.seeds, None, device, history, settings.environments, self.differentiable
        )
        self.observation = self.env.reset()["observation"]
        self.returns = torch.zeros(self.env.batch_size, dtype=torch.float64, device=self.device)
        self._curve: list[tuple[int, Tensor]] = []
        with self.device:
            self.loss = self._loss(3 + history)
        self.target_update = SoftUpdate(self.loss, tau=settings.polyak)
        self._prepare()

    @abstractmethod
    def _loss(self, observation_size: int) -> LossModule:
        """That of the algorithm."""

    @abstractmethod
    def _prepare(self) -> None:
        """Make what else the algorithm trains with."""

    @abstractmethod
    def train(self, steps: int) -> None:
        """Advance every agent by `steps` environment steps, or a few more, but not beyond settings.steps.

        Parameters
        ----------
        steps : int
            The environment steps of each agent.
        """

    @property
    def curves(self) -> list[list[tuple[int, float]]]:
        """Of each agent: (environment steps done, return) of every training episode of its first pendulum."""
        table = [(step, returns.tolist()) for step, returns in self._curve]
        return [[(step, returns[a]) for step, returns in table] for a in range(self.agents)]

    def policies(self) -> list[NetworkPolicy]:
        """The deterministic policy of every agent as it stands now.

        Returns
        -------
        list of NetworkPolicy (A,)
            The policies, in the order of the seeds.
        """
        *hidden, (weight, bias) = layers_of(leaf.detach().cpu().numpy().copy() for leaf in self.loss.actor_leaves)
        means = [*hidden, (weight[..., :1], bias[..., :1])]
        u_max, history = self.env.base_model.u_max, self.env.history
        return [NetworkPolicy(tuple((w[a], b[a, 0]) for w, b in means), u_max, history) for a in range(self.agents)]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, whole or not at all: the file is replaced only when the new one is on the disk.

        Parameters
        ----------
        path : str or path
            The file.

        Raises
        ------
        OSError
            Where it cannot be written, with what the system says of it, be that behind the writer's error.
        """
        try:
            with whole(Path(path)) as file:
                torch.save({**self._identity(), **self._progress()}, file)
        except (OSError, RuntimeError) as error:
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, OSError):
                cause = cause.__context__
            raise OSError(f"the checkpoint {path} cannot be written ({cause.strerror if cause else error})") from error

    def resume(self, path: str | os.PathLike[str]) -> None:
        """Go on from a checkpoint of this very population: the same numbers follow as without the interruption.

        Parameters
        ----------
        path : str or path
            The file that `save` wrote.

        Raises
        ------
        InvalidInput
            For a file that is no checkpoint, or one of another population or version; nothing has changed then.
        """
        stored = read_checkpoint(Path(path))
        settings = stored.get("settings")
        was = {**stored, **(settings if isinstance(settings, dict) else {})}
        first = {"version": CHECKPOINT_VERSION, "algorithm": self.settings.algorithm}
        for name, expected in {**first, **asdict(self.settings), **self._identity()}.items():
            if was.get(name) != expected:
                raise InvalidInput(
                    f"{path} is a checkpoint with {name} = {was.get(name)}; this population has {name} = {expected}"
                )
        for name in self.parts:
            getattr(self, name).load_state_dict(stored[name])
        self.steps_done, self.seconds = stored["steps_done"], stored["seconds"]
        self.observation.copy_(stored["observation"])
        self.returns.copy_(stored["return"])
        self._curve = [(step, torch.tensor(returns, dtype=torch.float64)) for step, returns in stored["curve"]]
        self.resumed()

    def resumed(self) -> None:  # noqa: B027
        """Called when a checkpoint was taken up."""

    def _identity(self) -> dict[str, Any]:
        """What makes this population the one it is."""
        model = self.env.base_model
        return {
            "version": CHECKPOINT_VERSION,
            "algorithm": self.settings.algorithm,
            "seeds": list(self.seeds),
            "settings": asdict(self.settings),
            "history": self.env.history,
            "randomizations": [r.to_json() for r in self.env.randomizations],
            "model": {
                "plant": type(model.plant).__name__,
                "parameters": {name: float(p.value) for name, p in model.parameters.items()},
                "integrator": repr(model.integrator),
                "dt": model.dt,
                "u_max": model.u_max,
            },
        }

    def _progress(self) -> dict[str, Any]:
        """What training has changed. Random streams are functions of seed and step, so they need no place here."""
        return {
            **{name: getattr(self, name).state_dict() for name in self.parts},
            "steps_done": self.steps_done,
            "seconds": self.seconds,
            "observation": self.observation,
            "return": self.returns,
            "curve": [[step, returns.tolist()] for step, returns in self._curve],
        }


def read_checkpoint(path: Path) -> dict[str, Any]:
    """What a checkpoint holds; raises InvalidInput for another file.

    torch.load does not look at the checksums that torch.save writes: zipfile does.
    """
    try:
        with ZipFile(path) as archive:
            damaged = archive.testzip()
        stored = torch.load(path, map_location="cpu", weights_only=True) if damaged is None else {}
    except (RuntimeError, OSError, EOFError, ValueError, KeyError, UnpicklingError, BadZipFile) as error:
        raise InvalidInput(f"{path} is not a checkpoint: expected a file that Population.save wrote") from error
    if damaged is not None:
        raise InvalidInput(f"{path} is damaged ({damaged}): expected a checkpoint as Population.save wrote it")
    if not isinstance(stored, dict):
        raise InvalidInput(f"{path} is not a checkpoint: it holds a {type(stored).__name__}")
    return stored
