"""Soft actor-critic for A agents at once, as a TorchRL program with Stable-Baselines3's conventions: an environment of
batch size (A,), a replay buffer, a loss, two optimisers and a target update, with TensorDicts between them.

    population = SACPopulation(model, [Band({"m": 2.0, "l": 1.5}, w=0.1)] * 3, seeds=[0, 1, 2])
    population.train(75_000)

The losses, and where they come from: `SACPopulation`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import SACLoss, ValueEstimators

from policies.environments.random_streams import Purpose
from policies.training.cuda_graph import CudaGraph
from policies.training.networks import (
    SquashedNormal,
    StackedMLP,
    backward,
    both_critics,
    forward,
    head,
    initialise,
    leaves_of,
    with_ones,
)
from policies.training.optimization import FusedAdam
from policies.training.population import Population, TrainingSettings
from policies.training.random_blocks import BLOCK_LENGTH, RandomBlocks
from policies.training.replay import replay_buffer
from sysid import InvalidInput


@dataclass(frozen=True)
class SACSettings(TrainingSettings):
    """How agents train by soft actor-critic: the paper's settings, which are Stable-Baselines3's but for learning_rate.

    Parameters
    ----------
    hidden : tuple of int
        The sizes of the hidden layers.
    learning_rate : float
        The learning rate of the critics, the policy and the temperature.
    batch : int
        The transitions in each agent's batch, at least 2.
    gamma : float
        The discount of a step.
    capacity : int
        The transitions that an agent remembers.
    polyak : float
        The share of the way that the slow copies of the critics go after each update; Stable-Baselines3 calls it tau.
    initial_temperature : float
        The temperature alpha at the beginning.
    target_entropy : float
        The entropy of the policy that the temperature is moved towards.
    random_steps : int
        The steps with uniform actions before the first update.
    steps : int
        The environment steps of each agent.

    Raises
    ------
    InvalidInput
        For layer sizes below 1 or none, a number that has to be positive and is not, a gamma or polyak outside [0, 1],
        and a batch below 2.
    """

    algorithm: ClassVar[str] = "sac"
    positive: ClassVar[tuple[str, ...]] = ("learning_rate", "capacity", "initial_temperature", "random_steps", "steps")
    shares: ClassVar[tuple[str, ...]] = ("gamma", "polyak")
    environments: ClassVar[int | None] = None
    hidden: tuple[int, ...] = (256, 256)
    learning_rate: float = 1e-3
    batch: int = 256
    gamma: float = 0.99
    capacity: int = 100_000
    polyak: float = 0.005
    initial_temperature: float = 1.0
    target_entropy: float = -1.0
    random_steps: int = 1000
    steps: int = 75_000

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.batch < 2:
            raise InvalidInput(f"batch = {self.batch}: expected at least 2 transitions")

    def memory(self, agents: int, observation_size: int) -> float:
        """How many bytes the networks take with their optimisers, and the transitions."""
        sizes = (observation_size + 1, *self.hidden, 2)
        weights = 14 * sum(a * b for a, b in pairwise(sizes))  # 4 copies of the actor's, 5 of each critic's
        activations = 8 * self.batch * sum(self.hidden)
        transitions = min(self.capacity, self.steps) * (2 * observation_size + 4)
        return 4.0 * agents * (weights + activations + transitions)


class StackedSACLoss(SACLoss):
    """TorchRL's SACLoss for data of batch size (A, B) and agents whose weights stand in stacks.

    seeds (A,): agent a's initial weights come from seeds[a] alone. What is drawn from the policy comes from the entries
    "noise" and ("next", "noise") (A, B, D), standard normal.

    Two things make it treat every agent alone. Critics answer with (A, B) instead of (A, B, 1), and log_alpha is
    (A, 1): with the trailing axis, SACLoss multiplies alpha (A, 1) with log_prob (A, B, 1), which broadcasts to a
    wrong shape, and silently to a wrong number where A = B. And the mean over B is taken before the sum over A.
    """

    def __init__(
        self, seeds: Sequence[int], settings: SACSettings, observation_size: int = 3, action_size: int = 1
    ) -> None:
        agents, hidden = len(seeds), settings.hidden
        sizes = (observation_size, *hidden, 2 * action_size), (observation_size + action_size, *hidden, 1)
        network = StackedMLP(agents, sizes[0], ["observation"], ["loc", "log_std"])
        critic = StackedMLP(agents, sizes[1], ["observation", "action"], ["state_action_value"])
        actor = ProbabilisticActor(
            network, in_keys=["loc", "log_std", "noise"], distribution_class=SquashedNormal, return_log_prob=True
        )
        with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            super().__init__(
                actor,
                critic,
                num_qvalue_nets=2,
                loss_function="l2",
                alpha_init=settings.initial_temperature,
                target_entropy=settings.target_entropy,
                deactivate_vmap=True,
            )
            self.make_value_estimator(ValueEstimators.TD0, gamma=settings.gamma)
            self.target_leaves = leaves_of(self.target_qvalue_network_params)
        self.actor_leaves, self.critic_leaves = map(leaves_of, (self.actor_network_params, self.qvalue_network_params))
        self._critics, self._targets = (
            [leaf.detach().flatten(0, 1) for leaf in leaves] for leaves in (self.critic_leaves, self.target_leaves)
        )
        self.log_alpha = nn.Parameter(torch.full((agents, 1), math.log(settings.initial_temperature)))
        self.settings, self._vmap_qnetworkN0 = settings, both_critics
        initialise(seeds, self.actor_leaves, *([leaf[i] for leaf in self.critic_leaves] for i in (0, 1)))
        torch._foreach_copy_(self.target_leaves, [leaf.detach() for leaf in self.critic_leaves])

    @torch.no_grad()
    def act(self, tensordict: TensorDictBase) -> TensorDictBase:
        """observation (A, O) and noise (A, D), standard normal -> action (A, D), of one pendulum an agent.

        The actor that SACLoss holds answers the same, and takes three times as long.
        """
        loc, log_std = head(forward(with_ones(tensordict.get("observation").unsqueeze(1)), self.actor_leaves)[-1])
        action = torch.addcmul(loc, log_std.exp(), tensordict.get("noise").unsqueeze(1)).tanh_()
        return tensordict.set("action", action.squeeze(1))

    def _reduce_loss(self, loss: Tensor, *_: Any, **__: Any) -> Tensor:
        """The mean over an agent's batch, the sum over agents."""
        return loss.mean(-1).sum()

    def qvalue_v2_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """L_critic; reward and flags of TorchRL's shape (A, B, 1)."""
        flat = tensordict.copy()
        flat["next"].update({name: flat["next", name].squeeze(-1) for name in ("reward", "done", "terminated")})
        loss, about = super().qvalue_v2_loss(flat)
        return 0.5 * loss, about

    def critic_gradients(self, tensordict: TensorDictBase) -> Sequence[Tensor]:
        """Of L_critic, for `critic_leaves`."""
        loss, _ = self.qvalue_v2_loss(tensordict)
        return torch.autograd.grad(loss, self.critic_leaves)

    def actor_gradients(self, tensordict: TensorDictBase) -> Sequence[Tensor]:
        """Of L_actor and L_alpha over transitions (A, B) with "noise": for `actor_leaves`, and log_alpha at the end."""
        loss, about = self.actor_loss(tensordict)
        loss = loss + self._reduce_loss(self.alpha_loss(about["log_prob"]))
        return torch.autograd.grad(loss, [*self.actor_leaves, self.log_alpha])


class FastSACLoss(StackedSACLoss):
    """The same losses, whose gradients for the training loop are written out:

        a = tanh x,   x = loc + exp(log_std) noise,   d log pi / dx = 2 a,   d log pi / d log_std = -1 + 2 a (x - loc)

    No graph is recorded for them, and none is computed that no step needs.
    """

    @torch.no_grad()
    def critic_gradients(self, tensordict: TensorDictBase) -> Sequence[Tensor]:
        y = self._target(tensordict.get("next"))
        passed = self._judge(self._critics, tensordict.get("observation"), tensordict.get("action"))
        slope = (passed[-1].view(2, *y.shape) - y).div_(y.shape[-1]).view_as(passed[-1])
        gradients, _ = backward(passed, self._critics, slope)
        return [gradient.view_as(leaf) for gradient, leaf in zip(gradients, self.critic_leaves, strict=True)]

    def _target(self, after: TensorDictBase) -> Tensor:
        """y (A, B)."""
        observation, reward = after.get("observation"), after.get("reward").squeeze(-1)
        loc, log_std = head(forward(with_ones(observation), self.actor_leaves)[-1])
        action, log_prob = SquashedNormal(loc, log_std, after.get("noise")).rsample_and_log_prob()
        value = self._judge(self._targets, observation, action)[-1].view(2, *reward.shape).amin(0)
        value = (value - self.log_alpha.exp() * log_prob).masked_fill_(after.get("terminated").squeeze(-1), 0.0)
        return reward + self.settings.gamma * value

    @torch.no_grad()
    def actor_gradients(self, tensordict: TensorDictBase) -> Sequence[Tensor]:
        observation, noise = tensordict.get("observation"), tensordict.get("noise")
        passed = forward(with_ones(observation), self.actor_leaves)
        loc, log_std = head(passed[-1])
        action, log_prob = SquashedNormal(loc, log_std, noise).rsample_and_log_prob()
        alpha = (self.log_alpha.exp() / noise.shape[1]).unsqueeze(-1)
        of_x = 2.0 * alpha * action + self._slope_of_least_q(observation, action) * (1.0 - action * action)
        within = passed[-1].chunk(2, -1)[1] == log_std
        slope = torch.cat((of_x, (of_x * log_std.exp() * noise - alpha) * within), -1)
        gradients, _ = backward(passed, self.actor_leaves, slope)
        return [*gradients, log_prob.mean(1, keepdim=True).add_(self.settings.target_entropy).neg_()]

    def _slope_of_least_q(self, observation: Tensor, action: Tensor) -> Tensor:
        """d/da of -mean_b min_i Q_i(s, a), (A, B, D)."""
        passed = self._judge(self._critics, observation, action)
        q = passed[-1].view(2, *action.shape[:-1])
        first = q[0] <= q[1]
        slope = torch.stack((first, ~first)).to(q.dtype).div_(-q.shape[-1]).view_as(passed[-1])
        of_action = self._critics[0][:, observation.shape[-1] : -1].mT
        return (backward(passed, self._critics, slope, learned=False)[1] @ of_action).view(2, *action.shape).sum(0)

    def _judge(self, critics: Sequence[Tensor], observation: Tensor, action: Tensor) -> list[Tensor]:
        """What passes through both critics, y (2 A, B, 1) at the end."""
        x = with_ones(observation, action)
        return forward(torch.cat((x, x)), critics)


class SACPopulation(Population):
    """Soft actor-critic agents, trained together, each with one pendulum and a memory of transitions.

        y        = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha log pi(a'|s')),   a' ~ pi(s')
        L_critic = 1/2 sum_i mean (Q_i(s, a) - y)^2
        L_actor  = mean (alpha log pi(a|s) - min_i Q_i(s, a)),   a ~ pi(s)
        L_alpha  = -mean log_alpha (log pi(a|s) + target_entropy)

    An agent has two critics Q_i, their slow copies Q'_i, a policy pi and a temperature alpha. Means run over the
    transitions of the agent's own batch, and the agents' losses are summed: no gradient of one depends on another.

    Notes
    -----
    It is made of what every `Population` is made of, with `SACSettings`.

    References
    ----------
    Haarnoja et al., "Soft Actor-Critic Algorithms and Applications" (2018); Stable-Baselines3, sac.py.
    """

    parts: ClassVar[tuple[str, ...]] = ("env", "replay", "loss", "critic_optimizer", "actor_optimizer")
    settings_of: ClassVar[type[SACSettings]] = SACSettings
    loss_of: ClassVar[type[StackedSACLoss]] = FastSACLoss
    """The loss: that of TorchRL with its gradients written out."""
    settings: SACSettings

    def _loss(self, observation_size: int) -> StackedSACLoss:
        return self.loss_of(self.seeds, self.settings, observation_size)

    def _prepare(self) -> None:
        settings, loss = self.settings, self.loss
        self._k = torch.zeros(1, dtype=torch.long, device=self.device)
        draws: dict[Purpose, Callable[[np.random.Generator, int], NDArray]] = {
            Purpose.EXPLORATION: _exploration,
            Purpose.REPLAY: lambda rng, n: rng.random((n, settings.batch)),
            Purpose.LOSS: lambda rng, n: rng.standard_normal((n, 2, settings.batch, 1), dtype=np.float32),
        }
        self._blocks = [RandomBlocks(self.seeds, purpose, draw, self.device) for purpose, draw in draws.items()]
        self._exploration, self._uniform, self._normal = self._blocks
        capacity, example = min(settings.capacity, settings.steps), self.env.fake_tensordict()
        self.replay = replay_buffer(capacity, settings.batch, example, lambda: self._uniform.at(self._k))
        self.critic_optimizer = FusedAdam(loss.critic_leaves, settings.learning_rate)
        self.actor_optimizer = FusedAdam([*loss.actor_leaves, loss.log_alpha], settings.learning_rate)
        self.resumed()

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
            self._curve.append((self.steps_done, self.returns.clone()))
            self.returns.zero_()
            self.observation.copy_(self.env.reset()["observation"])

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
        self._move(self.loss.act(self._seen(noise=self._exploration.at(self._k)[:, 1:])))
        batch = self.replay.sample()
        noise, next_noise = self._normal.at(self._k).unbind(1)
        batch = batch.set("noise", noise).set(("next", "noise"), next_noise)
        self.critic_optimizer.descend(self.loss.critic_gradients(batch))
        self.actor_optimizer.descend(self.loss.actor_gradients(batch))  # of the temperature, too
        self.target_update.step()
        self._k.add_(1)

    def _seen(self, **more: Tensor) -> TensorDict:
        return TensorDict({"observation": self.observation, **more}, self.env.batch_size)

    def _move(self, acted: TensorDictBase) -> None:
        """One step of every pendulum, remembered. A time limit is no terminal state."""
        moved = self.env.step(acted)
        self.replay.extend(moved.unsqueeze(0))
        after = moved.get("next")
        self.observation.copy_(after.get("observation"))
        self.returns.add_(after.get("reward").squeeze(1))

    def resumed(self) -> None:
        """Random numbers are loaded anew, and a step is captured anew."""
        self._block = -1
        self._learning_step = CudaGraph(self._learn, self.device)


def _exploration(rng: np.random.Generator, length: int) -> NDArray[np.float32]:
    """(length, 2): a uniform action in [-1, 1] and the normal noise of the policy's action, for each step."""
    uniform = rng.uniform(-1.0, 1.0, length)
    return np.stack((uniform, rng.standard_normal(length)), 1).astype(np.float32)
