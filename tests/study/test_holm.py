"""Holm's correction: by hand, in order, and honest for whole families."""

import numpy as np
import pytest

from study.statistics import holm


def test_by_hand():
    assert holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005}) == pytest.approx(
        {"d": 4 * 0.005, "a": 3 * 0.01, "c": 2 * 0.03, "b": 2 * 0.03}
    )
    assert holm({"a": 0.03}) == {"a": 0.03}
    assert holm({"a": 0.7, "b": 0.6}) == {"b": 1.0, "a": 1.0}
    assert holm({}) == {}


def test_whole_families_are_honest_and_keep_their_order():
    source, wrong = np.random.default_rng(13), 0
    for _ in range(500):
        p = source.uniform(size=12)
        adjusted = holm(dict(enumerate(p)))
        values = np.array([adjusted[k] for k in range(12)])
        assert np.all((p <= values) & (values <= 1.0))
        assert np.all(np.diff(values[np.argsort(p)]) >= 0.0)
        wrong += np.min(values) < 0.05
    assert wrong / 500 < 0.08
