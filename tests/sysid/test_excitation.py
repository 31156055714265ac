"""Excitation: signals within their limits, with the spectrum that they promise; the paper's measurement."""

import math

import numpy as np
import pytest

from sysid import paper_model, paper_rollouts
from sysid.planning.excitation import chirp, multisine, steps

N, DT, U = 4000, 0.01, 1.5
SIGNALS = {
    "multisine": lambda rng: multisine(rng, N, DT, U, 5.0),
    "chirp": lambda rng: chirp(N, DT, U, 0.1, 5.0),
    "steps": lambda rng: steps(rng, N, DT, U, 0.5),
}


@pytest.mark.parametrize("make", SIGNALS.values(), ids=SIGNALS.keys())
def test_signals_fill_their_range_and_repeat_with_their_seed(make):
    u = make(np.random.default_rng(0))
    assert u.shape == (N,) and 0.95 * U < np.max(np.abs(u)) <= U
    np.testing.assert_array_equal(u, make(np.random.default_rng(0)))


@pytest.mark.parametrize("name", ["multisine", "chirp"])
def test_power_lies_below_the_largest_frequency(name):
    power = np.abs(np.fft.rfft(SIGNALS[name](np.random.default_rng(1)))) ** 2
    assert np.sum(power[np.fft.rfftfreq(N, DT) > 5.5]) < 0.01 * np.sum(power)


def test_steps_hold_their_level():
    u = steps(np.random.default_rng(2), 95, 0.01, U, 0.1)
    assert np.all(np.diff(u).reshape(-1)[np.arange(94) % 10 != 9] == 0.0) and len(np.unique(u)) == 10


def test_the_papers_rollouts_draw_in_the_published_order():
    """One rollout, drawn by hand in the order of the published runs: start seed, then (u, noise, noise) a step."""
    model = paper_model(2.0, 1.5)
    (record,) = paper_rollouts(model, 1, np.random.default_rng(4), sigma=0.5, length=8)
    rng = np.random.default_rng(4)
    start = np.random.default_rng(int(rng.integers(0, 2**31 - 1))).uniform(low=[-math.pi, -1.0], high=[math.pi, 1.0])
    state = model.initial_state(*start.tolist())
    for k in range(8):
        u = float(np.float32(rng.uniform(-2.0, 2.0)))
        assert record.u[k] == u
        assert record.theta_dot[k] == float(np.float32(state.theta_dot)) + rng.normal(0.0, 0.5)
        assert math.cos(record.theta[k] - state.theta) > 1.0 - 1e-12
        state = model.advance(state, u)
        assert record.theta_dot_after[k] == float(np.float32(state.theta_dot)) + rng.normal(0.0, 0.5)


def test_rollouts_do_not_depend_on_how_many_follow():
    few, many = (paper_rollouts(paper_model(), n, np.random.default_rng(6), length=30) for n in (2, 5))
    for a, b in zip(few, many, strict=False):
        np.testing.assert_array_equal(a.u, b.u)
        np.testing.assert_allclose(a.theta_dot, b.theta_dot, rtol=1e-12)
    assert paper_rollouts(paper_model(), 0, np.random.default_rng(6)) == []
