"""A pendulum an agent, all moved at once, as a TorchRL environment: what a population trains on.

The parameters of the model are tensors (A,), one number an agent, so one `model.advance` moves all pendulums. Agent a's
episode e (start state, then parameters, then random torques where it has them) is drawn from a generator made from
(seeds[a], e) alone. An agent may have E pendulums; they share its episodes out among them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from policies.environments import task
from policies.environments.random_streams import Purpose, generator
from policies.environments.randomization import RandomForce, Randomization
from sysid import InvalidInput, Joint, JointEffect, Model, Reading, State
from sysid.physics.effects.effect import Memory
from sysid.physics.ops import Value
from sysid.physics.parameters import parameter


@dataclass(frozen=True, eq=False)
class RandomTorque(JointEffect):
    """tau [N m], whatever the joint does: where `RandomForce` acts. No effect of a machine, so not in the catalogue."""

    formula: ClassVar[str] = "tau = d_k"
    tau: Value = parameter(0.0, unit="N m", neutral=0.0)

    def torque(self, joint: Joint) -> Value:
        return self.tau


FLAGS = ("done", "truncated", "terminated")


class BatchedPendulums(EnvBase):
    """A pendulum for each of A agents, all moved at once, as a TorchRL environment of batch size (A,).

        observation = [cos theta, sin theta, theta_dot, past_actions]   (A, 3 + history)    action = u / u_max   (A, 1)

    Observations are float32 and actions lie in [-1, 1]. Observed is what the model's sensors show, and the last
    `history` actions. The reward is of the state.

    Parameters
    ----------
    model : Model
        The pendulum whose parameters the randomizations draw.
    randomizations : sequence of Randomization (A,)
        What each agent's episodes draw, all of them the same parameters.
    seeds : sequence of int (A,)
        The seed of each agent.
    horizon : int, optional
        The steps after which an episode ends, by truncation; by default those of 10 s. Nothing terminates an episode.
    device : str, optional
        Where the tensors lie.
    history : int, optional
        How many past actions are observed.
    environments : int, optional
        The pendulums E of each agent; the batch size is (A, E) then. Pendulum e of an agent has its episodes e, e + E,
        ...
    differentiable : bool, optional
        What changes is replaced in place of written to, so that gradients flow back through steps, from rewards and
        observations to actions, until `detach_state` cuts them and writes what it is now to where it was before: steps
        between two calls of it can be replayed as a graph.

    Raises
    ------
    InvalidInput
        If there are not as many seeds as randomizations, if the model has no u_max, if the history is longer than an
        episode, or if the randomizations draw different parameters.

    Notes
    -----
    What changes is written to in place, unless it is differentiable, so that a step can be replayed as a graph. Where
    an agent has a random force, `model` has a random torque beyond base_model, zero for agents that have none; past the
    horizon the last one stays.
    """

    def __init__(
        self,
        model: Model,
        randomizations: Sequence[Randomization],
        seeds: Sequence[int],
        horizon: int | None = None,
        device: str = "cpu",
        history: int = 0,
        environments: int | None = None,
        differentiable: bool = False,
    ) -> None:
        if not randomizations or len(randomizations) != len(seeds):
            raise InvalidInput(
                f"{len(randomizations)} randomizations and {len(seeds)} seeds: expected one of each an agent"
            )
        if not math.isfinite(model.u_max):
            raise InvalidInput(f"the model has u_max = {model.u_max}: expected a finite torque limit [N m]")
        task.check_history(history, model.dt)
        names = {frozenset(r.sample(generator(0, Purpose.EPISODES), model)) for r in randomizations}
        if len(names) > 1:
            raise InvalidInput(
                f"the randomizations draw different parameters: {sorted(map(sorted, names))}; expected the same"
            )
        shape = (len(seeds),) if environments is None else (len(seeds), environments)
        super().__init__(device=device, batch_size=torch.Size(shape))
        self.environments, self.differentiable = environments or 1, differentiable
        self.base_model, self.randomizations, self.history = model, tuple(randomizations), history
        self.horizon = task.horizon(model.dt) if horizon is None else horizon
        self.seeds = tuple(seeds)
        self.agents = len(self.seeds)
        self.has_random_force = any(isinstance(r, RandomForce) for r in randomizations)
        self._make_specs()
        self.forget()

    def _make_specs(self) -> None:
        shape, device = (*self.batch_size, 1), self.device
        seen = Unbounded((*self.batch_size, 3 + self.history), dtype=torch.float32, device=device)
        self.observation_spec = Composite(observation=seen, shape=self.batch_size, device=device)
        self.action_spec = Bounded(-1.0, 1.0, shape, dtype=torch.float32, device=device)
        self.reward_spec = Unbounded(shape, dtype=torch.float32, device=device)
        flags = {name: Binary(1, shape, dtype=torch.bool, device=device) for name in FLAGS}
        self.done_spec = Composite(**flags, shape=self.batch_size, device=device)

    def forget(self) -> None:
        """Before the first episode of every agent."""
        self.episodes = [e for _ in range(self.agents) for e in range(self.environments)]
        self.steps = torch.zeros(self.batch_size, dtype=torch.long, device=self.device)
        drawn = self.randomizations[0].sample(generator(0, Purpose.EPISODES), self.base_model)
        ones = torch.ones(self.batch_size, dtype=torch.float64, device=self.device)
        self.parameters_now = {name: ones.clone() for name in drawn}
        self.model = self.base_model.with_parameters(self.parameters_now)
        if self.has_random_force:
            self._torques = ones.new_zeros(*self.batch_size, self.horizon)
            self._torque = 0.0 * ones
            self.model = self.model.with_effect(RandomTorque(self._torque))
        state = self.model.initial_state(0.0 * ones, 0.0 * ones)
        sensing = self.model.sensing(state.theta, state.theta_dot) if self.model.output_effects else ()
        self._memories = [len(memory) for memory in state.memory], [len(memory) for memory in sensing]
        sensed = [0.0, 0.0] if self.model.output_effects else []
        numbers = [*_leaves(state), *sensed, *(v for memory in sensing for v in memory), *[0.0] * self.history]
        self._tensors = [0.0 * ones + number for number in numbers]
        self._take_up(self._tensors)

    def _take_up(self, numbers: list[Any]) -> None:
        """State, sensors and past commands are views of these from here on."""
        self._kept, rest = numbers, iter(numbers)
        of_state, of_sensors = self._memories
        self.state = State(next(rest), next(rest), _split(rest, of_state))
        self.seen = Reading(self.state.theta, self.state.theta_dot)
        if self.model.output_effects:
            self.seen = Reading(next(rest), next(rest))
        self.sensing = _split(rest, of_sensors)
        self.past_actions = tuple(rest)

    def _keep(self, numbers: Sequence[Any]) -> None:
        """Go on from these."""
        if self.differentiable:
            self._take_up(list(numbers))
        else:
            self._write(numbers)

    def _write(self, numbers: Sequence[Any]) -> None:
        """Go on from these, in the tensors that hold the state between windows."""
        # apart first: a delay's line passes the very tensors on that are written to
        for tensor, new in zip(self._tensors, [number.detach().clone() for number in numbers], strict=True):
            tensor.copy_(new)
        self._take_up(self._tensors)

    def detach_state(self) -> None:
        """Gradients end here: what follows does not depend on what was before. Backward passes through what was before
        have to be over."""
        self._write(self._kept)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        """Begin a new episode for the pendulums in the mask "_reset" (A, 1), or for all."""
        which = None if tensordict is None else tensordict.get("_reset", None)
        mask = torch.ones_like(self.steps, dtype=torch.bool) if which is None else which.reshape(self.batch_size)
        pendulums = len(self.episodes)
        drawn = {name: np.ones(pendulums) for name in ("theta", "theta_dot", *self.parameters_now)}
        torques = np.zeros((pendulums, self.horizon))
        begun: dict[tuple[int, int], tuple[np.random.Generator, tuple[float, float], Any]] = {}
        for i in torch.nonzero(mask.flatten()).flatten().tolist():
            a = i // self.environments
            episode = self.seeds[a], self.episodes[i]
            if episode not in begun:  # agents that share a seed share its start states
                rng = generator(episode[0], Purpose.EPISODES, episode[1])
                begun[episode] = rng, task.start_state(rng), rng.bit_generator.state
            rng, (drawn["theta"][i], drawn["theta_dot"][i]), after_start = begun[episode]
            rng.bit_generator.state = after_start
            randomization = self.randomizations[a]
            for name, value in randomization.sample(rng, self.base_model).items():
                drawn[name][i] = value
            if isinstance(randomization, RandomForce):
                torques[i] = randomization.torques(rng, self.horizon, self.base_model.dt)
            self.episodes[i] += self.environments
        there = {name: self._laid_out(numbers) for name, numbers in drawn.items()}
        for name, values in self.parameters_now.items():
            values.copy_(torch.where(mask, there[name], values))
        if self.has_random_force:
            self._torques.copy_(torch.where(mask.unsqueeze(-1), self._laid_out(torques), self._torques))
        fresh = self.model.initial_state(there["theta"], there["theta_dot"])
        shown = self._sensors(*self._read(fresh, self.model.sensing(fresh.theta, fresh.theta_dot), 0.0))
        begun = (*_leaves(fresh), *shown, *map(torch.zeros_like, self.past_actions))
        self._keep([torch.where(mask, new, kept) for kept, new in zip(self._kept, begun, strict=True)])
        self.steps.masked_fill_(mask, 0)
        flags = {name: torch.zeros_like(mask).unsqueeze(-1) for name in FLAGS}
        return TensorDict({"observation": self._observe(), **flags}, self.batch_size, device=self.device)

    def _laid_out(self, numbers: np.ndarray) -> Tensor:
        """Numbers of all pendulums (A E, ...) as a tensor (A, E, ...)."""
        return torch.from_numpy(numbers).to(self.device).view(*self.batch_size, *numbers.shape[1:])

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Hold the action for dt."""
        dt = self.base_model.dt
        share = tensordict.get("action")[..., 0].to(torch.float64).clamp(-1.0, 1.0)
        u = share * self.base_model.u_max
        reward = task.reward(self.state, u, dt).to(torch.float32)
        t = self.steps.to(torch.float64) * dt
        if self.has_random_force:
            k = self.steps.clamp(max=self.horizon - 1).unsqueeze(-1)
            self._torque.copy_(self._torques.gather(-1, k).squeeze(-1))
        after = self.model.advance(self.state, u, t)
        shown = self._sensors(*self._read(after, self.sensing, t + dt))
        self._keep([*_leaves(after), *shown, *(share, *self.past_actions)[: self.history]])
        self.steps.add_(1)
        ended = (self.steps >= self.horizon).unsqueeze(-1)
        after = {
            "observation": self._observe(),
            "reward": reward.unsqueeze(-1),
            "done": ended,
            "truncated": ended.clone(),
            "terminated": torch.zeros_like(ended),
        }
        return TensorDict(after, self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        """Agent a takes seed + a, and starts at its first episode."""
        if seed is not None:
            self.seeds = tuple(seed + a for a in range(self.agents))
            self.forget()

    def _observe(self) -> Tensor:
        return torch.stack(task.observation(self.seen, self.past_actions), -1).to(torch.float32)

    def _read(self, state: State, sensing: tuple[Memory, ...], t: Any) -> tuple[Reading, tuple[Memory, ...]]:
        return self.model.read(state.theta, state.theta_dot, sensing, t)

    def _sensors(self, seen: Reading, sensing: tuple[Memory, ...]) -> list[Any]:
        """What they show and remember; nothing where they show the state itself."""
        return [*seen, *(value for memory in sensing for value in memory)] if self.model.output_effects else []

    def get_extra_state(self) -> dict[str, Any]:
        """Everything that the next step depends on: what `state_dict` holds.

        Returns
        -------
        dict
            Tensors, lists and numbers.
        """
        return {
            "state": [leaf.clone() for leaf in self._kept],
            "parameters": {name: values.clone() for name, values in self.parameters_now.items()},
            "episodes": list(self.episodes),
            "steps": self.steps.clone(),
            **({"torques": self._torques.clone()} if self.has_random_force else {}),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Go on from a state, in place: what `load_state_dict` does.

        Parameters
        ----------
        state : dict
            What `get_extra_state` returned.
        """
        self._write(state["state"])
        for name, values in self.parameters_now.items():
            values.copy_(state["parameters"][name])
        self.episodes = list(state["episodes"])
        self.steps.copy_(state["steps"])
        if self.has_random_force:
            self._torques.copy_(state["torques"])


def _leaves(state: State) -> list[Any]:
    """Angle, speed and every number that an effect remembers."""
    return [state.theta, state.theta_dot, *(value for memory in state.memory for value in memory)]


def _split(numbers: Iterator[Any], sizes: Sequence[int]) -> tuple[Memory, ...]:
    """The next numbers, in groups of these sizes."""
    return tuple(tuple(next(numbers) for _ in range(size)) for size in sizes)
