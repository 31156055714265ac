"""Stacked networks are A separate networks, with PyTorch's initialisation, autograd's gradients, TorchRL's density."""

import numpy as np
import pytest
import torch
from torch import nn
from torchrl.modules import TanhNormal

from policies.training.networks import (
    SquashedNormal,
    StackedMLP,
    WrittenOutMLP,
    head,
    initialise,
    layers_of,
    with_ones,
)

SIZES = [(3, 16, 1), (3, 16, 24, 2), (4, 8, 8, 8, 1)]


def stacked(count, sizes):
    network = StackedMLP(count, sizes, ["observation"], ["state_value"])
    initialise(range(count), network.leaves)
    return network.leaves


def inputs(count, batch, size):
    return torch.randn(count, batch, size, generator=torch.Generator().manual_seed(0)).requires_grad_()


def plain(x, leaves):
    """The same in the words of PyTorch."""
    layers = layers_of(leaves)
    for i, (w, b) in enumerate(layers):
        x = torch.stack([nn.functional.linear(x[s], w[s].T, b[s, 0]) for s in range(len(x))])
        x = torch.relu(x) if i < len(layers) - 1 else x
    return x


@pytest.mark.parametrize("sizes", SIZES)
def test_it_computes_what_ordinary_layers_compute_and_its_gradients_are_autograds(sizes):
    leaves, x = stacked(3, sizes), inputs(3, 7, sizes[0])
    ours, theirs = WrittenOutMLP.apply(with_ones(x), *leaves), plain(x, leaves)
    torch.testing.assert_close(ours, theirs)
    slope = torch.randn(3, 7, sizes[-1], generator=torch.Generator().manual_seed(1))
    expected = torch.autograd.grad(theirs, [x, *leaves], slope)
    for gradient, reference in zip(torch.autograd.grad(ours, [x, *leaves], slope), expected, strict=True):
        torch.testing.assert_close(gradient, reference)
    fixed = [leaf.detach() for leaf in leaves]
    (gradient,) = torch.autograd.grad(WrittenOutMLP.apply(with_ones(x), *fixed), [x], slope)
    torch.testing.assert_close(gradient, expected[0])


def test_initial_weights_are_distributed_as_pytorchs():
    (w, b), (last, _) = layers_of(leaf.detach() for leaf in stacked(2, (64, 256, 1)))
    reference = nn.Linear(64, 256)
    for ours, theirs in ((w, reference.weight), (b, reference.bias)):
        assert ours.abs().max() <= 1.0 / 8.0
        assert ours.std().item() == pytest.approx(theirs.std().item(), rel=0.1)
    assert last.abs().max().item() == pytest.approx(1.0 / 16.0, rel=0.05)
    assert not torch.equal(w[0], w[1])


def test_log_std_is_clamped():
    _, log_std = head(torch.tensor([[[0.0, -50.0]], [[0.0, 7.0]], [[0.0, 1.5]]]))
    assert log_std.flatten().tolist() == [-20.0, 2.0, 1.5]


def test_density_is_torchrls():
    rng = torch.Generator().manual_seed(1)
    loc, log_std, noise = (torch.randn(2, 50, 3, generator=rng, dtype=torch.float64) for _ in range(3))
    action, log_prob = SquashedNormal(loc, log_std, noise).rsample_and_log_prob()
    assert log_prob.shape == (2, 50)
    expected = TanhNormal(loc, log_std.exp(), safe_tanh=False).log_prob(action)
    torch.testing.assert_close(log_prob, expected, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("loc", [-40.0, 40.0])
def test_a_saturated_action_keeps_a_finite_density_and_gradient(loc):
    at = torch.full((1, 1, 1), loc, requires_grad=True)
    log_std = torch.full((1, 1, 1), -20.0, requires_grad=True)
    _, log_prob = SquashedNormal(at, log_std, torch.ones(1, 1, 1)).rsample_and_log_prob()
    log_prob.sum().backward()
    assert torch.isfinite(log_prob).all()
    assert float(at.grad) == pytest.approx(2.0 * np.sign(loc))
    assert float(log_std.grad) == pytest.approx(-1.0, abs=1e-5)
