"""Short-horizon actor-critic (SHAC) for A agents at once: the gradient of the return goes through the model.

    population = SHACPopulation(model, [Band({"m": 2.0, "l": 1.5}, w=0.1)] * 3, seeds=[0, 1, 2])
    population.train(population.settings.steps)

The losses, and where they come from: `SHACPopulation`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.objectives import LossModule
from torchrl.objectives.value.functional import td_lambda_return_estimate

from policies.environments.random_streams import Purpose
from policies.training.cuda_graph import CudaGraph
from policies.training.networks import StackedMLP, WrittenOutMLP, initialise, leaves_of, with_ones
from policies.training.optimization import FusedAdam
from policies.training.population import Population, TrainingSettings
from policies.training.random_blocks import RandomBlocks
from sysid import InvalidInput

OPERATIONS = 200.0
"""About how many numbers a pendulum's step leaves for the way back."""
BEND = 2.5
"""|pi| from which tanh is hardly more than flat: 0.987."""
FIRST_ACTIONS = 0.1
"""Share of their usual size that the policy's last weights begin with: a large action is one that tanh has cut off, and
its gradient is nothing."""
LAST_RATE = 0.02
"""Share of the learning rate that is left at the end."""
FORGETTING = 0.95
"""How much of its last mean square an optimiser keeps."""


@dataclass(frozen=True)
class SHACSettings(TrainingSettings):
    """How agents train through the model.

    Parameters
    ----------
    hidden : tuple of int
        The sizes of the hidden layers.
    learning_rate : float
        That of policy and value function at the beginning; it falls in a straight line to a fiftieth.
    environments : int
        The pendulums of each agent.
    horizon : int
        The steps of a window.
    gamma : float
        The discount of a step.
    decay : float
        The lambda of the returns that the value function learns.
    noise : pair of floats
        The standard deviation of the policy's action before tanh, at the beginning and at the end.
    saturation : float
        The weight p of the penalty on actions that tanh cuts off, at the beginning.
    reward_scale : float
        What rewards are multiplied with, so that values are of the size of 10.
    polyak : float
        The share of the way that the slow copy goes after each window.
    minibatches : int
        The updates of the value function in each window.
    gradient_norm : float
        The norm to which longer gradients of the policy are cut.
    steps : int
        The environment steps of each agent, summed over its pendulums.

    Raises
    ------
    InvalidInput
        For layer sizes below 1 or none, a number that has to be positive and is not, a gamma, decay or polyak outside
        [0, 1], a negative noise or saturation, and minibatches that do not divide the environments.
    """

    algorithm: ClassVar[str] = "shac"
    positive: ClassVar[tuple[str, ...]] = (
        "learning_rate", "environments", "horizon", "reward_scale", "minibatches", "gradient_norm", "steps",
    )  # fmt: skip
    shares: ClassVar[tuple[str, ...]] = ("gamma", "decay", "polyak")
    random_steps: ClassVar[int] = 0
    hidden: tuple[int, ...] = (64, 64)
    learning_rate: float = 1e-2
    environments: int = 64
    horizon: int = 16
    gamma: float = 0.99
    decay: float = 0.95
    noise: tuple[float, float] = (0.6, 0.1)
    saturation: float = 0.1
    reward_scale: float = 0.02
    polyak: float = 0.2
    minibatches: int = 4
    gradient_norm: float = 1.0
    steps: int = 2_048_000

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "noise", tuple(self.noise))
        for name in ("noise", "saturation"):
            if not min(np.atleast_1d(getattr(self, name))) >= 0.0:
                raise InvalidInput(f"{name} = {getattr(self, name)}: expected no negative number")
        if self.environments % self.minibatches:
            raise InvalidInput(
                f"minibatches = {self.minibatches}: expected a number that divides the {self.environments} environments"
            )

    @property
    def window(self) -> int:
        """Steps of each agent between two updates of its policy."""
        return self.environments * self.horizon

    def memory(self, agents: int, observation_size: int) -> float:
        """How many bytes the networks take with their optimisers, and a window on its way back."""
        sizes = (observation_size, *self.hidden, 1)
        weights = 9 * sum(a * b for a, b in pairwise(sizes))
        window = self.window * (4 * sum(self.hidden) + 2 * OPERATIONS)
        return 4.0 * agents * (weights + window)


class SHACLoss(LossModule):
    """The losses of windows (A, E, T), TensorDicts as TorchRL's environments give them.

    seeds (A,): agent a's initial weights come from seeds[a] alone. progress: the share of the training that is done.
    """

    def __init__(self, seeds: Sequence[int], settings: SHACSettings, observation_size: int = 3) -> None:
        super().__init__()
        sizes = (observation_size, *settings.hidden, 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            actor = StackedMLP(len(seeds), sizes, ["observation"], ["loc"])
            value = StackedMLP(len(seeds), sizes, ["observation"], ["state_value"])
            self.convert_to_functional(actor, "actor_network")
            self.convert_to_functional(value, "value_network", create_target_params=True)
            self.target_leaves = leaves_of(self.target_value_network_params)
        self.actor_leaves, self.value_leaves = map(leaves_of, (self.actor_network_params, self.value_network_params))
        self.settings, self.progress = settings, torch.zeros((), dtype=torch.float64)
        initialise(seeds, self.actor_leaves, self.value_leaves)
        with torch.no_grad():
            torch._foreach_mul_(self.actor_leaves[-2:], FIRST_ACTIONS)
            torch._foreach_copy_(self.target_leaves, self.value_leaves)

    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """observation (A, E, O) and noise (A, E, 1), standard normal -> loc, which is pi, and action (A, E, 1)."""
        loc = _answers(tensordict.get("observation"), self.actor_leaves).unsqueeze(-1)
        first, last = self.settings.noise
        sd = first + (last - first) * self.progress
        return tensordict.set("loc", loc).set("action", (loc + sd * tensordict.get("noise")).tanh())

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """loss_actor, of a window through which gradients flow, and loss_value, each summed over agents."""
        losses = {"loss_actor": self.actor_loss(tensordict), "loss_value": self.value_loss(self.taught(tensordict))}
        return TensorDict(losses, [])

    def actor_loss(self, window: TensorDictBase) -> Tensor:
        """L_actor, whose gradient goes through the model.

        Parameters
        ----------
        window : TensorDict
            Steps (A, E, T) as the pendulums made them, still joined to the policy's weights.

        Returns
        -------
        Tensor
            The loss, summed over agents.
        """
        after, gamma = window.get("next"), self.settings.gamma
        reward = after.get("reward").squeeze(-1)
        steps = reward.shape[-1]
        discounts = gamma ** torch.arange(steps, dtype=reward.dtype, device=reward.device)
        final = self.value_after(after.get("observation")[..., -1, :])
        gained = self.settings.reward_scale * (reward @ discounts) + gamma**steps * final
        beyond = (window.get("loc").abs() - BEND).clamp_min(0.0)
        bent = self.settings.saturation * (1.0 - self.progress) * (beyond * beyond).mean((1, 2, 3))
        return (bent - gained.mean(1) / steps).sum()

    def value_after(self, observation: Tensor) -> Tensor:
        """V' (A, ...) of observations (A, ..., O)."""
        return _answers(observation, [leaf.detach() for leaf in self.target_leaves])

    def actor_gradients(self, window: TensorDictBase) -> list[Tensor]:
        """Of L_actor, for `actor_leaves`; an agent's is no longer than gradient_norm; inf and nan stay."""
        gradients = torch.autograd.grad(self.actor_loss(window), self.actor_leaves)
        norm = torch.stack([gradient.flatten(1).norm(dim=1) for gradient in gradients]).norm(dim=0)
        share = (self.settings.gradient_norm / norm).clamp(max=1.0).view(-1, 1, 1)
        return [gradient * share for gradient in gradients]

    @torch.no_grad()
    def taught(self, window: TensorDictBase) -> TensorDict:
        """What the value function learns: "observation" (A, E, T, O) and "value_target" (A, E, T), R_t."""
        after, settings = window.get("next").detach(), self.settings
        target = td_lambda_return_estimate(
            settings.gamma,
            settings.decay,
            self.value_after(after.get("observation")).unsqueeze(-1),
            settings.reward_scale * after.get("reward"),
            after.get("done"),
            after.get("terminated"),
        )
        seen = window.get("observation").detach()
        return TensorDict({"observation": seen, "value_target": target.squeeze(-1)}, window.batch_size)

    def value_loss(self, taught: TensorDictBase) -> Tensor:
        error = _answers(taught.get("observation"), self.value_leaves) - taught.get("value_target")
        return 0.5 * (error * error).mean((1, 2)).sum()

    def value_gradients(self, taught: TensorDictBase) -> Sequence[Tensor]:
        """Of L_value, for `value_leaves`."""
        return torch.autograd.grad(self.value_loss(taught), self.value_leaves)


def _answers(observation: Tensor, leaves: Sequence[Tensor]) -> Tensor:
    """The one output (A, ...) of the agents' networks for observations (A, ..., O)."""
    y = WrittenOutMLP.apply(with_ones(observation.flatten(1, -2)), *leaves)
    return y.view(observation.shape[:-1])


class SHACPopulation(Population):
    """Agents that learn from the gradient through the model, by short-horizon actor-critic (SHAC).

        J        = mean_E (sum_{t < T} gamma^t r_t + gamma^T V'(s_T)),   a_t = tanh(pi(s_t) + noise std)
        L_actor  = -J / T + p mean max(|pi| - 2.5, 0)^2,   its gradient goes through rewards, observations and motion
        L_value  = 1/2 mean (V(s_t) - R_t)^2,       R_t: TD(lambda) returns of V'

    Each agent has its own E pendulums, whose episodes end one after another. They move for T steps from where they are,
    under the agent's policy pi with noise; its value function V, with a slow copy V', says what comes after.

    Notes
    -----
    It is made of what every `Population` is made of, with `SHACSettings`.

    The model is differentiable, so that a gradient costs no more than twice the motion, and has none of the noise that
    an estimate from returns has. Short windows keep it from growing without bound along the motion; V' carries it on.
    Where tanh has come to its end nothing is left of the gradient, and a policy that hangs at full torque would hang
    there for ever: the second term of L_actor brings it back. It fades away with the learning rate.

    References
    ----------
    Xu et al., "Accelerated Policy Learning with Parallel Differentiable Simulation" (2022).
    """

    parts: ClassVar[tuple[str, ...]] = ("env", "loss", "value_optimizer", "actor_optimizer")
    settings_of: ClassVar[type[SHACSettings]] = SHACSettings
    differentiable: ClassVar[bool] = True
    settings: SHACSettings

    def _loss(self, observation_size: int) -> SHACLoss:
        return SHACLoss(self.seeds, self.settings, observation_size)

    def _prepare(self) -> None:
        settings, rate = self.settings, self.settings.learning_rate
        which = torch.arange(settings.environments, device=self.device)
        self.env.steps.add_(which * self.env.horizon // settings.environments)
        self.value_optimizer = FusedAdam(self.loss.value_leaves, rate, FORGETTING)
        self.actor_optimizer = FusedAdam(self.loss.actor_leaves, rate, FORGETTING)

        def normal(rng: np.random.Generator, length: int) -> NDArray[np.float32]:
            return rng.standard_normal((length, settings.environments, 1), dtype=np.float32)

        self._noise = RandomBlocks(self.seeds, Purpose.EXPLORATION, normal, self.device, settings.horizon)
        self._finite = torch.ones((), dtype=torch.bool, device=self.device)
        self._ended = torch.zeros(*self.env.batch_size, 1, dtype=torch.bool, device=self.device)
        self.resumed()

    def resumed(self) -> None:
        """A window is captured anew."""
        self._learning_window = CudaGraph(self._learn, self.device)

    def train(self, steps: int) -> None:
        """Advance every agent by `steps` environment steps, or up to a window more, but not beyond settings.steps.

        Raises
        ------
        InvalidInput
            Where the gradient through the model is not finite.
        """
        last = min(self.settings.steps, self.steps_done + steps)
        while self.steps_done < last:
            self._set_rate()
            self._noise.load(self.steps_done // self.settings.window)
            self._learning_window()
            if not self._finite:
                raise InvalidInput(
                    f"the gradient through the model is not finite after {self.steps_done} steps: expected a model "
                    "whose motion does not run away; sac trains without gradients of the model"
                )
            self.steps_done = min(self.settings.steps, self.steps_done + self.settings.window)
            self._begin_anew()

    def _set_rate(self) -> None:
        done = self.steps_done / self.settings.steps
        self.loss.progress.fill_(done)
        for optimizer in (self.value_optimizer, self.actor_optimizer):
            optimizer.set_rate(self.settings.learning_rate * (1.0 - (1.0 - LAST_RATE) * done))

    def _learn(self) -> None:
        """A window, an update of the policy, some of the value function, and one of its slow copy. Nothing in it waits
        for the device or depends on the host."""
        window = self._window()
        gradients = self.loss.actor_gradients(window)
        self._finite.copy_(torch.stack([gradient.isfinite().all() for gradient in gradients]).all())
        self.actor_optimizer.descend(gradients)
        taught, parts = self.loss.taught(window), self.settings.minibatches
        for part in range(parts):
            self.value_optimizer.descend(self.loss.value_gradients(taught[:, part::parts]))
        self.target_update.step()
        self._go_on_after(window)

    def _go_on_after(self, window: TensorDictBase) -> None:
        """The next window begins where this one ends, and no gradient flows back into this one."""
        self.env.detach_state()
        after = window.get("next").detach()
        self.observation.copy_(after.get("observation")[:, :, -1])
        self.returns.add_(after.get("reward").sum((2, 3)))
        self._ended.copy_(after.get("done")[:, :, -1])

    def _window(self) -> TensorDictBase:
        """Steps (A, E, T) of the pendulums under the policy as it is, from where they are."""
        seen, moved = self.observation, []
        for noise in self._noise.all():
            acted = self.loss.act(TensorDict({"observation": seen, "noise": noise}, self.env.batch_size))
            moved.append(self.env.step(acted))
            seen = moved[-1].get(("next", "observation"))
        return torch.stack(moved, 2)

    def _begin_anew(self) -> None:
        """Where episodes have ended, others begin."""
        if not bool(self._ended.any()):
            return
        over = self._ended.squeeze(-1)
        if bool(over[0, 0]):
            self._curve.append((self.steps_done, self.returns[:, 0].clone()))
        self.returns.masked_fill_(over, 0.0)
        self.observation.copy_(self.env.reset(TensorDict({"_reset": self._ended}, self.env.batch_size))["observation"])
        self.env.detach_state()
