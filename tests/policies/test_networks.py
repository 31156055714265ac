"""A stack is as many ordinary networks, and its backward pass is autograd's."""

import numpy as np
import pytest
import torch
from torch import nn

from policies.training.networks import Stack, activations, backward, forward

CPU = torch.device("cpu")


def stack_of(count, sizes, extra=False):
    stack = Stack(count, sizes, CPU, extra)
    for network in range(count):
        stack.initialise(network, np.random.default_rng(network))
    return stack


def inputs(count, batch, size):
    x = torch.randn(count, batch, size, generator=torch.Generator().manual_seed(0))
    return torch.cat((x, torch.ones(count, batch, 1)), -1)


@pytest.mark.parametrize("sizes", [(3, 16, 1), (3, 16, 24, 2), (4, 8, 8, 8, 1)])
def test_it_computes_what_ordinary_layers_compute(sizes):
    stack, x = stack_of(3, sizes), inputs(3, 7, sizes[0])
    room = activations(3, 7, sizes[1:-1], CPU)
    out = forward(x, stack.layers, room, torch.empty(3, 7, sizes[-1]))
    for s in range(3):
        h = x[s, :, :-1]
        for i, (w, b) in enumerate(stack.weights):
            h = nn.functional.linear(h, w[s].T, b[s, 0])
            h = torch.relu(h) if i < len(sizes) - 2 else h
        torch.testing.assert_close(out[s], h)


@pytest.mark.parametrize("sizes", [(3, 16, 1), (3, 16, 24, 2), (4, 8, 8, 8, 1)])
def test_its_gradients_are_autograds(sizes):
    stack, gradients, x = stack_of(3, sizes), Stack(3, sizes, CPU), inputs(3, 7, sizes[0])
    room, spare = (activations(3, 7, sizes[1:-1], CPU) for _ in range(2))
    slope = torch.randn(3, 7, sizes[-1], generator=torch.Generator().manual_seed(1))
    forward(x, stack.layers, room, torch.empty(3, 7, sizes[-1]))
    below = backward(x, stack.layers, room, slope.clone(), spare, gradients.layers)

    layers = [(w.clone().requires_grad_(), b.clone().requires_grad_()) for w, b in stack.weights]
    h = start = x[..., :-1].clone().requires_grad_()
    for i, (w, b) in enumerate(layers):
        h = h @ w + b
        h = torch.relu(h) if i < len(layers) - 1 else h
    h.backward(slope)
    for ours, theirs in zip(gradients.weights, layers, strict=True):
        for leaf, reference in zip(ours, theirs, strict=True):
            torch.testing.assert_close(leaf, reference.grad)
    torch.testing.assert_close(below @ stack.weights[0][0].mT, start.grad)


def test_everything_lies_in_one_tensor():
    stack = stack_of(2, (3, 8, 8, 2), extra=True)
    stack.extra.fill_(7.0)
    assert stack.flat.numel() == 2 * (4 * 8 + 8 * 8 + 8 + 8 * 2 + 2 + 1)
    assert (stack.flat[-2:] == 7.0).all()
    stack.flat.zero_()
    assert all((leaf == 0.0).all() for layer in stack.weights for leaf in layer)


def test_initial_weights_are_distributed_as_pytorchs():
    stack, reference = stack_of(2, (64, 256, 1)), nn.Linear(64, 256)
    (w, b), (last, _) = stack.weights
    for ours, theirs in ((w, reference.weight), (b, reference.bias)):
        assert ours.abs().max() <= 1.0 / 8.0
        assert ours.std().item() == pytest.approx(theirs.std().item(), rel=0.1)
    assert last.abs().max().item() == pytest.approx(1.0 / 16.0, rel=0.05)
    assert not torch.equal(w[0], w[1])
