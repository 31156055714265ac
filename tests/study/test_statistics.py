"""Bootstrap, t, Welch and Holm: coverage, pairing, and what each says where the other is known."""

import numpy as np
import pytest
import scipy.stats

from study.formatting import MINUS
from study.statistics import bootstrap_coverage, holm, paired_bootstrap, paired_t, sem, student, welch
from sysid import InvalidInput


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize(("seeds", "expected"), [(3, 0.75), (5, 0.836), (10, 0.901), (100, 0.946)])
def test_with_few_seeds_they_hold_it_less_often_and_that_is_said(seeds, expected):
    assert bootstrap_coverage(seeds, rng()) == pytest.approx(expected, abs=0.012)


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [([], [], "same seeds"), ([1.0, 2.0], [1.0], "same seeds"), ([1.0, np.nan], [1.0, 2.0], "NaN")],
)
def test_bad_input_is_refused(a, b, message):
    with pytest.raises(InvalidInput, match=message):
        paired_bootstrap(a, b, rng())


def test_student_intervals_hold_the_true_mean_as_often_as_they_say_with_ten_seeds_and_the_bootstrap_does_not():
    source, hits = rng(7), np.zeros(2)
    for _ in range(600):
        a, b = source.normal(3.0, 1.0, 10), np.zeros(10)
        for k, contrast in enumerate((paired_t(a, b), paired_bootstrap(a, b, source, resamples=500))):
            hits[k] += contrast.low <= 3.0 <= contrast.high
    assert 0.93 < hits[0] / 600 < 0.97
    assert hits[1] / 600 < 0.93


def test_p_and_interval_tell_the_same():
    source = rng(8)
    for _ in range(50):
        contrast = paired_t(source.normal(0.7, 1.0, 8), np.zeros(8))
        assert (contrast.p < 0.05) == contrast.significant


def test_t_of_a_published_mean_and_error_is_that_of_the_runs():
    a, b = rng(9).normal(size=12), rng(10).normal(size=12)
    known = student(float(np.mean(a - b)), sem(a - b), 12)
    assert (known.low, known.high, known.p) == pytest.approx(vars_of(paired_t(a, b)))


def vars_of(contrast):
    return contrast.low, contrast.high, contrast.p


def test_welch_agrees_with_the_textbook():
    a, b = rng(11).normal(1.0, 1.0, 9), rng(12).normal(0.0, 4.0, 14)
    contrast = welch((a.mean(), sem(a), 9), (b.mean(), sem(b), 14))
    expected = scipy.stats.ttest_ind(a, b, equal_var=False)
    interval = expected.confidence_interval()
    assert vars_of(contrast) == pytest.approx((interval.low, interval.high, expected.pvalue))


def test_one_seed_decides_nothing():
    alone = paired_t([5.0], [1.0])
    assert (alone.mean, alone.significant, alone.p) == (4.0, False, 1.0)
    assert str(alone) == f"+4 [{MINUS}inf, +inf]"
    assert not welch((1.0, np.nan, 1), (0.0, 0.1, 10)).significant


def test_equal_pairs_are_no_difference_and_shifted_ones_are():
    assert not paired_t([1.0, 2.0], [1.0, 2.0]).significant
    assert paired_t([2.0, 3.0], [1.0, 2.0]).significant


def test_holms_correction_by_hand():
    assert holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005}) == pytest.approx(
        {"d": 4 * 0.005, "a": 3 * 0.01, "c": 2 * 0.03, "b": 2 * 0.03}
    )
    assert holm({"a": 0.03}) == {"a": 0.03}
    assert holm({"a": 0.7, "b": 0.6}) == {"b": 1.0, "a": 1.0}
    assert holm({}) == {}


def test_whole_families_are_honest_and_keep_their_order():
    source, wrong = rng(13), 0
    for _ in range(500):
        p = source.uniform(size=12)
        adjusted = holm(dict(enumerate(p)))
        values = np.array([adjusted[k] for k in range(12)])
        assert np.all((p <= values) & (values <= 1.0))
        assert np.all(np.diff(values[np.argsort(p)]) >= 0.0)
        wrong += np.min(values) < 0.05
    assert wrong / 500 < 0.08
