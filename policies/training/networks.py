"""The networks of A agents side by side, as TensorDict modules whose backward pass is written out.

    h_i = max(h_{i-1} W_i + b_i, 0),   y = h_k W + b         x (A, B, in), W_i (A, in, out), b_i (A, 1, out)

One batched product serves all agents, and no number of one agent depends on another's. Inputs end with a column of
ones, so that the first layer's bias is the last row of its weights.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.distributions import Distribution

from policies.environments.random_streams import Purpose, generator

LOG_STD_BOUNDS = (-20.0, 2.0)
"""log(std) of the policy is clamped to this (Stable-Baselines3)."""


def forward(x: Tensor, leaves: Sequence[Tensor]) -> list[Tensor]:
    """x (S, B, in + 1), ending with ones, and leaves w0, w1, b1, w2, b2, ... -> [x, h_1, ..., y (S, B, out)]."""
    passed = [x, torch.bmm(x, leaves[0])]
    for w, b in zip(leaves[1::2], leaves[2::2], strict=True):
        passed.append(torch.bmm(passed[-1].clamp_min_(0.0), w).add_(b))
    return passed


def backward(
    passed: Sequence[Tensor], leaves: Sequence[Tensor], slope: Tensor, learned: bool = True
) -> tuple[list[Tensor], Tensor]:
    """dL/d leaves, if `learned`, and dL/d(x W_0), from what `forward` went through and slope = dL/dy."""
    gradients: list[Tensor] = []
    for i in reversed(range(1, len(passed) - 1)):
        h, w = passed[i], leaves[2 * i - 1]
        if learned:
            gradients = [_of_weight(h, slope), slope.sum(1, keepdim=True), *gradients]
        slope = slope * w.mT if slope.shape[-1] == 1 else torch.bmm(slope, w.mT)
        slope = torch.ops.aten.threshold_backward.grad_input(slope, h, 0.0, grad_input=slope)
    return ([_of_weight(passed[0], slope), *gradients] if learned else []), slope


def _of_weight(x: Tensor, slope: Tensor) -> Tensor:
    """dL/dW. A single column is several times faster as a row."""
    if slope.shape[-1] == 1:
        return torch.bmm(slope.mT, x).view(len(x), -1, 1)
    return torch.bmm(x.mT, slope)


class WrittenOutMLP(torch.autograd.Function):
    """`forward` and `backward` for autograd: y (S, B, out) of x and leaves.

    Autograd through the same products would keep more of what lies between, and take a third longer.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, *leaves: Tensor) -> Tensor:
        *passed, y = forward(x, leaves)
        ctx.save_for_backward(*passed, *leaves)
        return y

    @staticmethod
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        """dL/dx, and dL/d leaves where they learn."""
        depth = (len(ctx.saved_tensors) + 1) // 3
        passed, leaves = [*ctx.saved_tensors[:depth], slope], ctx.saved_tensors[depth:]
        gradients, slope = backward(passed, leaves, slope, any(ctx.needs_input_grad[1:]))
        of_x = torch.bmm(slope, leaves[0].mT) if ctx.needs_input_grad[0] else None
        return of_x, *(gradients or [None] * len(leaves))


def with_ones(*inputs: Tensor) -> Tensor:
    """The inputs (..., .) side by side, and a column of ones."""
    return torch.cat((*inputs, inputs[0].new_ones(()).expand(*inputs[0].shape[:-1], 1)), -1)


def leaves_of(params: TensorDictBase) -> list[Tensor]:
    """w0, w1, b1, w2, b2, ... among the parameters of a StackedMLP."""
    leaves = {key if isinstance(key, str) else key[-1]: leaf for key, leaf in params.items(True, True)}
    return [leaves[name] for name in leaf_names(len(leaves) // 2 + 1)]


def leaf_names(depth: int) -> list[str]:
    """Of so many layers."""
    return ["w0", *(f"{kind}{i}" for i in range(1, depth) for kind in "wb")]


def layers_of(leaves: Iterable[Any]) -> list[tuple[Any, Any]]:
    """(W (..., in, out), b (..., 1, out)) of every layer; views."""
    first, *rest = leaves
    return [(first[..., :-1, :], first[..., -1:, :]), *zip(rest[::2], rest[1::2], strict=True)]


class StackedMLP(TensorDictModuleBase):
    """The networks of A agents; the parameters are w0 (A, in + 1, out), w1 (A, in, out), b1 (A, 1, out), ...

    An actor answers observation (A, B, O) with "loc" and "log_std" of the action before tanh, each (A, B, D); a critic
    answers observation and action with "state_action_value" (A, B). No trailing axis: see `StackedSACLoss`.
    """

    def __init__(self, agents: int, sizes: Sequence[int], in_keys: Sequence[str], out_keys: Sequence[str]) -> None:
        super().__init__()
        self.in_keys, self.out_keys, self.names = list(in_keys), list(out_keys), leaf_names(len(sizes) - 1)
        self.register_parameter("w0", nn.Parameter(torch.zeros(agents, sizes[0] + 1, sizes[1])))
        for i, (n_in, n_out) in enumerate(pairwise(sizes[1:]), 1):
            self.register_parameter(f"w{i}", nn.Parameter(torch.zeros(agents, n_in, n_out)))
            self.register_parameter(f"b{i}", nn.Parameter(torch.zeros(agents, 1, n_out)))

    @property
    def leaves(self) -> list[Tensor]:
        """w0, w1, b1, ..."""
        return [getattr(self, name) for name in self.names]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        y = WrittenOutMLP.apply(with_ones(*(tensordict.get(key) for key in self.in_keys)), *self.leaves)
        answers = head(y) if len(self.out_keys) == 2 else (y.squeeze(-1),)
        return tensordict.update(dict(zip(self.out_keys, answers, strict=True)))


def both_critics(tensordict: TensorDictBase, params: TensorDictBase) -> TensorDictBase:
    """Q (2, A, B) by parameters (2, A, ...) of critics: one pass in place of SACLoss's loop over the two."""
    x = with_ones(tensordict.get("observation"), tensordict.get("action"))
    leaves = (leaf.flatten(0, 1) for leaf in leaves_of(params))
    values = WrittenOutMLP.apply(x.expand(2, *x.shape).flatten(0, 1), *leaves).view(2, *x.shape[:-1])
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

    def __init__(self, loc: Tensor, log_std: Tensor, noise: Tensor) -> None:
        self.loc, self.log_std, self.noise = loc, log_std, noise
        super().__init__(loc.shape[:-1], loc.shape[-1:], validate_args=False)

    def rsample_and_log_prob(self, sample_shape: Sequence[int] = ()) -> tuple[Tensor, Tensor]:
        """The action (A, B, D) and its log probability (A, B)."""
        x = torch.addcmul(self.loc, self.log_std.exp(), self.noise)
        log_slope = 2.0 * (math.log(2.0) - x - nn.functional.softplus(-2.0 * x))
        log_normal = -0.5 * self.noise**2 - self.log_std - 0.5 * math.log(2.0 * math.pi)
        return x.tanh(), (log_normal - log_slope).sum(-1)


@torch.no_grad()
def initialise(seeds: Sequence[int], *networks: Sequence[Tensor]) -> None:
    """Draw the leaves (A, ...) of some networks, one after another from each agent's own generator.

    Weights and biases come from U(-k, k), k = 1 / sqrt(in), as nn.Linear's default.
    """
    for a, seed in enumerate(seeds):
        rng = generator(seed, Purpose.WEIGHTS)
        for leaves in networks:
            for w, b in layers_of(leaf[a] for leaf in leaves):
                k = 1.0 / math.sqrt(len(w))
                for numbers in (w, b):
                    numbers.copy_(torch.from_numpy(rng.uniform(-k, k, numbers.shape).astype(np.float32)))
