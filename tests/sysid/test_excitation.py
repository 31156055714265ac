"""Excitation: signals within their limits, with the spectrum that they promise."""

import numpy as np
import pytest

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
