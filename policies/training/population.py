"""A agents trained side by side in one process: each with its own pendulum, randomization, memory, networks and seed.

    population = Population(model, [Band({"m": 2.0, "l": 1.5}, w=0.1)] * 3, seeds=[0, 1, 2])
    population.train(75_000)
    evaluate(population.policies()[0], machine, *start_states(seed=0))

A TorchRL program: an environment of batch size (A,), a replay buffer, a loss, two optimisers and a target update, with
TensorDicts between them. What an agent becomes depends on its own seed and randomization, not on its neighbours.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from policies.environments.batched_pendulums import BatchedPendulums
from policies.environments.random_streams import Purpose
from policies.environments.randomization import Randomization
from policies.limits import TRAINING_MEMORY
from policies.network_policy import NetworkPolicy
from policies.training.checkpoint import read_checkpoint, write_checkpoint
from policies.training.cuda_graph import CudaGraph
from policies.training.networks import ExploringPolicy, layers_of
from policies.training.optimization import FastSoftUpdate, FusedAdam
from policies.training.random_blocks import BLOCK_LENGTH, RandomBlocks
from policies.training.replay import replay_buffer
from policies.training.sac import LOSSES, SACSettings
from sysid import InvalidInput, Model
from sysid.limits import check_size

CHECKPOINT_VERSION = 3


class Population:
    """Soft actor-critic agents, trained together; `train` advances all, `save` and `resume` interrupt and go on.

    model: the pendulum whose parameters the randomizations draw; randomizations (A,), seeds (A,); history: how many
    past commands the agents observe.
    """

    def __init__(
        self,
        model: Model,
        randomizations: Sequence[Randomization],
        seeds: Sequence[int],
        settings: SACSettings | None = None,
        device: str = "cpu",
        history: int = 0,
    ) -> None:
        self.settings = settings = SACSettings() if settings is None else settings
        memory = settings.memory(len(seeds), 3 + history)
        check_size("bytes of memory for this training:", memory, TRAINING_MEMORY, "with fewer agents or smaller layers")
        self.seeds, self.device = tuple(int(s) for s in seeds), torch.device(device)
        self.agents, self.steps_done, self._block = len(self.seeds), 0, -1
        self._k = torch.zeros(1, dtype=torch.long, device=self.device)
        self._blocks = _random_blocks(self.seeds, settings.batch, device)
        self._exploration, self._uniform, self._normal = self._blocks

        self.env = BatchedPendulums(model, randomizations, self.seeds, device=device, history=history)
        self.replay = replay_buffer(
            min(settings.capacity, settings.steps),
            settings.batch,
            self.env.fake_tensordict(),
            lambda: self._uniform.at(self._k),
        )
        with self.device:
            self.loss = LOSSES[settings.loss](self.seeds, settings, 3 + history)
        self.policy = ExploringPolicy(self.loss.actor_leaves)
        self.critic_optimizer = FusedAdam(self.loss.critic_leaves, settings.learning_rate)
        self.actor_optimizer = FusedAdam([*self.loss.actor_leaves, self.loss.log_alpha], settings.learning_rate)
        self.target_update = FastSoftUpdate(self.loss, tau=settings.polyak)

        self._observation = self.env.reset()["observation"]
        self._return = torch.zeros(self.agents, dtype=torch.float64, device=self.device)
        self._curve: list[tuple[int, torch.Tensor]] = []
        self._learning_step = CudaGraph(self._learn, self.device)

    @property
    def curves(self) -> list[list[tuple[int, float]]]:
        """Of each agent: (env steps done, return) of every training episode that ended."""
        table = [(step, returns.tolist()) for step, returns in self._curve]
        return [[(step, returns[a]) for step, returns in table] for a in range(self.agents)]

    def train(self, steps: int) -> None:
        """Advance every agent by `steps` environment steps, but not beyond settings.steps."""
        for _ in range(min(steps, self.settings.steps - self.steps_done)):
            self._step()

    def _step(self) -> None:
        block, k = divmod(self.steps_done, BLOCK_LENGTH)
        if block != self._block:
            self._load(block, k)
        if self.steps_done >= self.settings.random_steps:
            self._learning_step()
        else:
            self._explore()
        self.steps_done += 1
        if self.steps_done % self.env.horizon == 0:
            self._curve.append((self.steps_done, self._return.clone()))
            self._return.zero_()
            self._observation.copy_(self.env.reset()["observation"])

    def _load(self, block: int, k: int) -> None:
        """Take up the random numbers of a block, from its step k on."""
        for numbers in self._blocks:
            numbers.load(block)
        self._block = block
        self._k.fill_(k)

    def _explore(self) -> None:
        """A step with uniform actions."""
        self._move(self._seen(action=self._exploration.at(self._k)[:, :1]))
        self._k.add_(1)

    def _learn(self) -> None:
        """A step with the policy's actions and an update. Nothing in it waits for the device or depends on the host."""
        self._move(self.policy(self._seen(noise=self._exploration.at(self._k)[:, 1:])))
        batch = self.replay.sample()
        noise, next_noise = self._normal.at(self._k).unbind(1)
        self._update(batch.set("noise", noise).set(("next", "noise"), next_noise))
        self._k.add_(1)

    def _seen(self, **more: Tensor) -> TensorDict:
        return TensorDict({"observation": self._observation, **more}, self.env.batch_size)

    def _move(self, acted: TensorDictBase) -> None:
        """One step of every pendulum, remembered. A time limit is no terminal state."""
        moved = self.env.step(acted)
        self.replay.extend(moved.unsqueeze(0))
        after = moved.get("next")
        self._observation.copy_(after.get("observation"))
        self._return.add_(after.get("reward").squeeze(1))

    def _update(self, batch: TensorDictBase) -> None:
        """A step of the critics, then of actor and temperature, then of the targets."""
        self.critic_optimizer.descend(self.loss.critic_gradients(batch))
        self.actor_optimizer.descend(self.loss.actor_gradients(batch))
        self.target_update.step()

    def policies(self) -> list[NetworkPolicy]:
        """The deterministic policy of every agent as it stands now."""
        *hidden, (weight, bias) = layers_of(leaf.detach().cpu().numpy().copy() for leaf in self.loss.actor_leaves)
        means = [*hidden, (weight[..., :1], bias[..., :1])]
        u_max, history = self.env.base_model.u_max, self.env.history
        return [NetworkPolicy(tuple((w[a], b[a, 0]) for w, b in means), u_max, history) for a in range(self.agents)]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, whole or not at all: the file is replaced only when the new one is on the disk."""
        write_checkpoint(Path(path), {**self._identity(), **self._progress()})

    def resume(self, path: str | os.PathLike[str]) -> None:
        """Go on from a checkpoint of this very population: the same numbers follow as without the interruption.

        Raises InvalidInput for a file that is no checkpoint, or one of another population or version; nothing has
        changed then.
        """
        stored = read_checkpoint(Path(path))
        settings = stored.get("settings")
        was = {**stored, **(settings if isinstance(settings, dict) else {})}
        for name, expected in {"version": CHECKPOINT_VERSION, **asdict(self.settings), **self._identity()}.items():
            if was.get(name) != expected:
                raise InvalidInput(
                    f"{path} is a checkpoint with {name} = {was.get(name)}; this population has {name} = {expected}"
                )
        for name, part in self._parts.items():
            part.load_state_dict(stored[name])
        self.steps_done, self._block = stored["steps_done"], -1
        self._observation.copy_(stored["observation"])
        self._return.copy_(stored["return"])
        self._curve = [(step, torch.tensor(returns, dtype=torch.float64)) for step, returns in stored["curve"]]
        self._learning_step = CudaGraph(self._learn, self.device)

    @property
    def _parts(self) -> dict[str, Any]:
        """What a checkpoint holds the state of."""
        names = ("env", "replay", "loss", "critic_optimizer", "actor_optimizer")
        return {name: getattr(self, name) for name in names}

    def _identity(self) -> dict[str, Any]:
        """What makes this population the one it is."""
        model = self.env.base_model
        return {
            "version": CHECKPOINT_VERSION,
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
            **{name: part.state_dict() for name, part in self._parts.items()},
            "steps_done": self.steps_done,
            "observation": self._observation,
            "return": self._return,
            "curve": [[step, returns.tolist()] for step, returns in self._curve],
        }


def _random_blocks(seeds: Sequence[int], batch: int, device: str) -> tuple[RandomBlocks, RandomBlocks, RandomBlocks]:
    """Exploration (A, 2), draws from the memory (A, B) and the noise of the losses (A, 2, B, 1), for every step."""

    def uniform(rng: np.random.Generator, length: int) -> NDArray:
        return rng.random((length, batch))

    def normal(rng: np.random.Generator, length: int) -> NDArray:
        return rng.standard_normal((length, 2, batch, 1), dtype=np.float32)

    return (
        RandomBlocks(seeds, Purpose.EXPLORATION, _exploration, device),
        RandomBlocks(seeds, Purpose.REPLAY, uniform, device),
        RandomBlocks(seeds, Purpose.LOSS, normal, device),
    )


def _exploration(rng: np.random.Generator, length: int) -> NDArray[np.float32]:
    """(length, 2): a uniform action in [-1, 1] and the normal noise of the policy's action, for each step."""
    uniform = rng.uniform(-1.0, 1.0, length)
    return np.stack((uniform, rng.standard_normal(length)), 1).astype(np.float32)
