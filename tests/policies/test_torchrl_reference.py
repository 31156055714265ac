"""Stacked networks are A separate networks, with PyTorch's initialisation and TorchRL's tanh-normal density."""

import numpy as np
import pytest
import torch
from torch import nn
from torchrl.modules import TanhNormal

from policies.training.networks import linear_init
from policies.training.torchrl_reference import SquashedNormal, head, mlp

SIZES = (3, 16, 16, 2)


def stacked(agents, seed=0):
    drawn = [linear_init(np.random.default_rng(seed + a), SIZES) for a in range(agents)]
    leaves = [torch.from_numpy(np.stack(leaf)).requires_grad_() for leaf in zip(*drawn, strict=True)]
    return list(zip(leaves[::2], leaves[1::2], strict=True))


def test_each_agent_computes_what_its_own_layers_compute():
    layers, x = stacked(3), torch.randn(3, 5, 3, generator=torch.Generator().manual_seed(0))
    out = mlp(x, layers)
    for a in range(3):
        h = x[a]
        for i, (w, b) in enumerate(layers):
            h = nn.functional.linear(h, w[a].T, b[a, 0])
            h = torch.relu(h) if i < 2 else h
        torch.testing.assert_close(out[a], h)


def test_no_gradient_crosses_between_agents():
    layers, x = stacked(3), torch.ones(3, 5, 3)
    mlp(x, layers)[1].sum().backward()
    for w, b in layers:
        for leaf in (w, b):
            assert leaf.grad[0].abs().max() == leaf.grad[2].abs().max() == 0.0
            assert leaf.grad[1].abs().max() > 0.0


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


def test_density_integrates_to_one():
    noise = torch.linspace(-9.0, 9.0, 20_001, dtype=torch.float64).reshape(1, -1, 1)
    distribution = SquashedNormal(torch.full_like(noise, 0.3), torch.full_like(noise, -0.5), noise)
    action, log_prob = distribution.rsample_and_log_prob()
    assert float(torch.trapezoid(log_prob.exp()[0], action[0, :, 0])) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("loc", [-40.0, 40.0])
def test_a_saturated_action_keeps_a_finite_density_and_gradient(loc):
    at = torch.full((1, 1, 1), loc, requires_grad=True)
    log_std = torch.full((1, 1, 1), -20.0, requires_grad=True)
    _, log_prob = SquashedNormal(at, log_std, torch.ones(1, 1, 1)).rsample_and_log_prob()
    log_prob.sum().backward()
    assert torch.isfinite(log_prob).all()
    assert float(at.grad) == pytest.approx(2.0 * np.sign(loc))
    assert float(log_std.grad) == pytest.approx(-1.0, abs=1e-5)
