"""The losses of `policies.training.sac` by TorchRL's SACLoss and autograd: what its written-out gradients are held to.

    reference = TorchRLReference(sac)            # starts from the weights and temperatures of sac
    reference.update(batch, noise, next_noise)   # takes the steps that sac.update takes, from SACLoss

The networks of A agents are stacked along a leading agent axis, so that one batched product serves all of them:

    y_a = x_a W_a + b_a        x (A, B, in), W (A, in, out), b (A, 1, out)

Training uses `policies.training.sac`, which computes the same numbers in two thirds of the time.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from itertools import pairwise

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.distributions import Distribution, constraints
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import SACLoss, SoftUpdate, ValueEstimators

from policies.training.networks import Stack
from policies.training.replay import Batch
from policies.training.sac import LOG_STD_BOUNDS, SAC, SACSettings

AgentLayers = Sequence[tuple[Tensor, Tensor]]


def mlp(x: Tensor, layers: AgentLayers) -> Tensor:
    """Linear layers (W, b) with ReLU between them; x (A, B, in) -> (A, B, out)."""
    *hidden, (weight, bias) = layers
    for w, b in hidden:
        x = torch.relu_(torch.baddbmm(b, x, w))
    return torch.baddbmm(bias, x, weight)


def layers_of(params: TensorDictBase) -> AgentLayers:
    """The (W, b) of each layer among the parameters of a StackedMLP."""
    leaves = {key[-1] if isinstance(key, tuple) else key: leaf for key, leaf in params.items(True, True)}
    return [(leaves[f"w{i}"], leaves[f"b{i}"]) for i in range(len(leaves) // 2)]


class StackedMLP(TensorDictModuleBase):
    """The MLPs of A agents; parameters w0 (A, in, out), b0 (A, 1, out), w1, ...

    A TensorDict module by itself: TensorDictModule around a plain module spends more time looking for optional
    packages at every call than these networks spend on their products.
    """

    def __init__(self, agents: int, sizes: Sequence[int]) -> None:
        super().__init__()
        self.depth = len(sizes) - 1
        for i, (n_in, n_out) in enumerate(pairwise(sizes)):
            self.register_parameter(f"w{i}", nn.Parameter(torch.zeros(agents, n_in, n_out)))
            self.register_parameter(f"b{i}", nn.Parameter(torch.zeros(agents, 1, n_out)))

    def answer(self, x: Tensor) -> Tensor:
        """x (A, B, in) -> (A, B, out)."""
        return mlp(x, [(getattr(self, f"w{i}"), getattr(self, f"b{i}")) for i in range(self.depth)])


class StackedActor(StackedMLP):
    """observation (A, B, O) -> location and log standard deviation of the action before tanh, each (A, B, D)."""

    in_keys = ["observation"]  # noqa: RUF012
    out_keys = ["loc", "log_std"]  # noqa: RUF012

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        loc, log_std = head(self.answer(tensordict.get("observation")))
        return tensordict.set("loc", loc).set("log_std", log_std)


class StackedCritic(StackedMLP):
    """observation (A, B, O), action (A, B, D) -> Q (A, B). No trailing axis: see `make_loss`."""

    in_keys = ["observation", "action"]  # noqa: RUF012
    out_keys = ["state_action_value"]  # noqa: RUF012

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        x = torch.cat((tensordict.get("observation"), tensordict.get("action")), -1)
        return tensordict.set("state_action_value", self.answer(x).squeeze(-1))


def both_critics(tensordict: TensorDictBase, params: TensorDictBase) -> TensorDictBase:
    """Q (2, A, B) of two sets of StackedCritic parameters (2, A, ...), in one pass with 2 A agents."""
    x = torch.cat((tensordict.get("observation"), tensordict.get("action")), -1)
    layers = [(w.flatten(0, 1), b.flatten(0, 1)) for w, b in layers_of(params)]
    values = mlp(x.expand(2, *x.shape).flatten(0, 1), layers).view(2, *x.shape[:-1])
    return TensorDict({"state_action_value": values}, values.shape)


def head(output: Tensor) -> tuple[Tensor, Tensor]:
    """Split an actor's output (A, B, 2 D) into loc and log_std = clamp(., -20, 2)."""
    loc, log_std = output.chunk(2, -1)
    return loc, log_std.clamp(*LOG_STD_BOUNDS)


class SquashedNormal(Distribution):
    """tanh of a normal, whose standard normal noise is given instead of drawn from torch's global generator.

        a = tanh(x),   x = loc + exp(log_std) noise
        log p(a) = sum[-noise^2 / 2 - log_std - log(2 pi) / 2 - 2 (log 2 - x - softplus(-2 x))]

    loc, log_std, noise (A, B, D). The last term is log(1 - tanh(x)^2), written so that it never overflows
    (Haarnoja et al. 2018, appendix C). Same density as torchrl's TanhNormal(loc, exp(log_std)).
    """

    arg_constraints = {"loc": constraints.real, "log_std": constraints.real}  # noqa: RUF012
    has_rsample = True

    def __init__(self, loc: Tensor, log_std: Tensor, noise: Tensor) -> None:
        self.loc, self.log_std, self.noise = loc, log_std, noise
        super().__init__(loc.shape[:-1], loc.shape[-1:], validate_args=False)

    def rsample_and_log_prob(self, sample_shape: Sequence[int] = ()) -> tuple[Tensor, Tensor]:
        """The action (A, B, D) and its log probability (A, B)."""
        if len(sample_shape):
            raise ValueError(f"sample_shape is {tuple(sample_shape)}; the given noise makes exactly one sample, ()")
        x = torch.addcmul(self.loc, self.log_std.exp(), self.noise)
        log_slope = 2.0 * (math.log(2.0) - x - nn.functional.softplus(-2.0 * x))
        log_normal = -0.5 * self.noise**2 - self.log_std - 0.5 * math.log(2.0 * math.pi)
        return x.tanh(), (log_normal - log_slope).sum(-1)

    def rsample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """The action (A, B, D)."""
        return self.rsample_and_log_prob(sample_shape)[0]

    @property
    def deterministic_sample(self) -> Tensor:
        """tanh(loc), which the trained policy plays."""
        return self.loc.tanh()


def make_actor(agents: int, observation_size: int, action_size: int, hidden: Sequence[int]) -> ProbabilisticActor:
    """The actor that SACLoss needs; it reads "observation" and "noise"."""
    network = StackedActor(agents, (observation_size, *hidden, 2 * action_size))
    return ProbabilisticActor(
        network, in_keys=["loc", "log_std", "noise"], distribution_class=SquashedNormal, return_log_prob=True
    )


def make_critic(agents: int, observation_size: int, action_size: int, hidden: Sequence[int]) -> StackedCritic:
    """The critic that SACLoss needs, which makes two of it."""
    return StackedCritic(agents, (observation_size + action_size, *hidden, 1))


def make_loss(agents: int, observation_size: int, action_size: int, settings: SACSettings) -> SACLoss:
    """TorchRL's SACLoss for data of batch size (A, B), with a temperature an agent.

    Two things make it treat every agent alone. Critics answer with (A, B) instead of (A, B, 1), and log_alpha is
    (A, 1): with the trailing axis, SACLoss multiplies alpha (A, 1) with log_prob (A, B, 1), which broadcasts to a
    wrong shape, and silently to a wrong number where A = B. And no loss is reduced here, so the mean over B can be
    taken before the sum over A.
    """
    with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loss = SACLoss(
            make_actor(agents, observation_size, action_size, settings.hidden),
            make_critic(agents, observation_size, action_size, settings.hidden),
            num_qvalue_nets=2,
            loss_function="l2",
            alpha_init=settings.initial_temperature,
            target_entropy=settings.target_entropy,
            reduction="none",
            scalar_output_mode="exclude",
            deactivate_vmap=True,
        )
        loss.make_value_estimator(ValueEstimators.TD0, gamma=settings.gamma)
    loss._vmap_qnetworkN0 = both_critics  # a sixth faster than its loop over the critics, which computes the same
    loss.log_alpha = nn.Parameter(torch.full((agents, 1), math.log(settings.initial_temperature)))
    return loss


class TorchRLReference:
    """The learners of A agents as SACLoss defines them, from the state of a fresh SAC."""

    def __init__(self, sac: SAC) -> None:
        self.settings, self.agents = sac.settings, sac.agents
        self.loss = make_loss(sac.agents, sac.observation_size, sac.action_size, sac.settings).to(sac.device)
        self.actor = layers_of(self.loss.actor_network_params)
        self.critics = layers_of(self.loss.qvalue_network_params)
        self.targets = layers_of(self.loss.target_qvalue_network_params)
        self._soft_update = SoftUpdate(self.loss, tau=sac.settings.polyak)
        with torch.no_grad():
            self.loss.log_alpha.copy_(sac.log_alpha)
            for ours, theirs in ((self.actor, sac.actor), (self.critics, sac.critics), (self.targets, sac.targets)):
                for leaf, numbers in zip(_leaves(ours), in_order(theirs, sac.agents), strict=True):
                    leaf.copy_(numbers)
        rate = sac.settings.learning_rate
        self.critic_optimizer = torch.optim.Adam(_leaves(self.critics), lr=rate, fused=True)
        self.actor_optimizer = torch.optim.Adam([*_leaves(self.actor), self.loss.log_alpha], lr=rate, fused=True)

    def update(self, batch: Batch, noise: Tensor, next_noise: Tensor) -> None:
        """As `SAC.update`; the gradients stay with the parameters."""
        shape = batch.reward.shape
        critic_loss, _ = self.loss.qvalue_v2_loss(self._tensordict(batch, noise, next_noise))
        self.critic_optimizer.zero_grad()
        (0.5 * critic_loss.sum() / shape[1]).backward()
        self.critic_optimizer.step()

        actor_loss, metadata = self.loss.actor_loss(self._tensordict(batch, noise, next_noise))
        alpha_loss = self.loss.alpha_loss(metadata["log_prob"])
        self.actor_optimizer.zero_grad()
        ((actor_loss + alpha_loss).sum() / shape[1]).backward()
        self.actor_optimizer.step()

        self._soft_update.step()

    def _tensordict(self, batch: Batch, noise: Tensor, next_noise: Tensor) -> TensorDict:
        """A fresh one for every use: SACLoss writes what its networks answer into what it is given."""
        shape = batch.reward.shape
        after = TensorDict(
            {
                "observation": batch.next_observation,
                "noise": next_noise,
                "reward": batch.reward,
                "terminated": batch.terminated,
                "done": batch.terminated,
            },
            batch_size=shape,
        )
        before = {"observation": batch.observation, "action": batch.action, "noise": noise, "next": after}
        return TensorDict(before, batch_size=shape)


def in_order(stack: Stack, agents: int) -> list[Tensor]:
    """W and b of every layer of a SAC's stack in the order of SACLoss: (A, ...), or (2, A, ...) for critics."""
    leaves = [leaf for layer in stack.weights for leaf in layer]
    if stack.count == agents:
        return leaves
    return [leaf.unflatten(0, (agents, 2)).transpose(0, 1) for leaf in leaves]


def _leaves(layers: AgentLayers) -> list[Tensor]:
    return [leaf for layer in layers for leaf in layer]
