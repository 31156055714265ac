"""S multilayer perceptrons side by side in one flat tensor, with their forward and backward passes written out.

    h_i = max(h_{i-1} W_i + b_i, 0),   y = h_k W + b         x (S, B, in), W_i (S, in, out), b_i (S, 1, out)

One batched product serves all networks, and no number of one network depends on another's. Inputs end with a column of
ones, so that the first layer's bias is the last row of its weights. Results go into tensors that exist already, so a
training step stays in the processor's cache and can be replayed as a CUDA graph.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

Layer = tuple[Tensor, Tensor | None]
"""W (S, in, out) and b (S, 1, out); None where the bias is the last row of W."""


class Stack:
    """`count` networks with these layer sizes; `flat` holds all their numbers, then `extra` (count, 1) where wanted."""

    def __init__(self, count: int, sizes: Sequence[int], device: torch.device, extra: bool = False) -> None:
        self.count, self.sizes = count, tuple(sizes)
        shapes = [(count, sizes[0] + 1, sizes[1])]
        for n_in, n_out in pairwise(sizes[1:]):
            shapes += [(count, n_in, n_out), (count, 1, n_out)]
        shapes += [(count, 1)] if extra else []
        lengths = [math.prod(shape) for shape in shapes]
        self.flat = torch.zeros(sum(lengths), device=device)
        pieces = [piece.view(shape) for piece, shape in zip(self.flat.split(lengths), shapes, strict=True)]
        self.extra = pieces.pop() if extra else self.flat[:0]
        self.layers: list[Layer] = [(pieces[0], None), *zip(pieces[1::2], pieces[2::2], strict=True)]

    @property
    def weights(self) -> list[tuple[Tensor, Tensor]]:
        """(W, b) of every layer, the first one's taken apart; views."""
        first = self.layers[0][0]
        return [(first[:, :-1], first[:, -1:]), *((w, b) for w, b in self.layers[1:] if b is not None)]

    @torch.no_grad()
    def initialise(self, network: int, rng: np.random.Generator) -> None:
        """Draw the weights of one network as `linear_init` does."""
        leaves = [leaf[network] for layer in self.weights for leaf in layer]
        for leaf, numbers in zip(leaves, linear_init(rng, self.sizes), strict=True):
            leaf.copy_(torch.from_numpy(numbers))


def linear_init(rng: np.random.Generator, sizes: Sequence[int]) -> list[NDArray[np.float32]]:
    """W (in, out), b (1, out) of each layer of one network, from U(-k, k), k = 1 / sqrt(in), as nn.Linear's default."""
    drawn = []
    for n_in, n_out in pairwise(sizes):
        k = 1.0 / math.sqrt(n_in)
        drawn += [rng.uniform(-k, k, (n_in, n_out)).astype(np.float32)]
        drawn += [rng.uniform(-k, k, (1, n_out)).astype(np.float32)]
    return drawn


def activations(count: int, batch: int, hidden: Sequence[int], device: torch.device) -> list[Tensor]:
    """Room for the hidden activations (count, batch, size) of each layer."""
    return [torch.zeros(count, batch, size, device=device) for size in hidden]


def forward(x: Tensor, layers: Sequence[Layer], hidden: Sequence[Tensor], out: Tensor) -> Tensor:
    """Fill the hidden activations (S, B, .) and `out` (S, B, out) from x (S, B, in + 1); returns `out`."""
    for (w, b), h in zip(layers, (*hidden, out), strict=True):
        torch.bmm(x, w, out=h)
        if b is not None:
            h.add_(b)
        x = h if h is out else h.clamp_min_(0.0)
    return out


def backward(
    x: Tensor,
    layers: Sequence[Layer],
    hidden: Sequence[Tensor],
    slope: Tensor,
    spare: Sequence[Tensor],
    gradients: Sequence[Layer] | None = None,
) -> Tensor:
    """From slope = dL/dy (S, B, out) to dL/d(x W_0) (S, B, .), through room like `hidden`; fills `gradients` if given.

    `hidden` is as `forward` left it.
    """
    for i in reversed(range(1, len(layers))):
        w, h, below = layers[i][0], hidden[i - 1], spare[i - 1]
        if gradients is not None:
            _weight_gradients(h, slope, *gradients[i])
        if slope.shape[-1] == 1:
            torch.mul(slope, w.mT, out=below)
        else:
            torch.bmm(slope, w.mT, out=below)
        slope = torch.ops.aten.threshold_backward.grad_input(below, h, 0.0, grad_input=below)
    if gradients is not None:
        _weight_gradients(x, slope, *gradients[0])
    return slope


def _weight_gradients(x: Tensor, slope: Tensor, w: Tensor, b: Tensor | None) -> None:
    """dL/dW and dL/db, into w and b. A single column is several times faster as a row.

    The row is a view of its own: into the column's transpose, which has the same numbers in the same order but other
    strides, oneDNN's product writes nothing (torch 2.13).
    """
    if slope.shape[-1] == 1:
        torch.bmm(slope.mT, x, out=w.view(len(w), 1, -1))
    else:
        torch.bmm(x.mT, slope, out=w)
    if b is not None:
        torch.sum(slope, 1, keepdim=True, out=b)
