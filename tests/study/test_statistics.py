"""The bootstrap: its coverage, its pairing, and the paper's own intervals from the paper's own runs."""

import csv
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from study import paper
from study.statistics import bootstrap_coverage, paired_bootstrap, sem
from sysid import InvalidInput

PAPER_RUNS = Path(__file__).resolve().parents[3] / "shared" / "data" / "paper" / "summary.csv"


def rng(seed=0):
    return np.random.default_rng(seed)


def test_intervals_of_many_seeds_hold_the_true_mean_as_often_as_they_say():
    hits = 0
    source = rng(1)
    for _ in range(400):
        shared = source.normal(0.0, 50.0, 40)
        contrast = paired_bootstrap(shared + source.normal(3.0, 1.0, 40), shared, source, resamples=1000)
        hits += contrast.low <= 3.0 <= contrast.high
    assert 0.91 < hits / 400 < 0.98


@pytest.mark.parametrize(("seeds", "expected"), [(3, 0.75), (5, 0.836), (10, 0.901), (100, 0.946)])
def test_with_few_seeds_they_hold_it_less_often_and_that_is_said(seeds, expected):
    assert bootstrap_coverage(seeds, rng()) == pytest.approx(expected, abs=0.012)


def test_pairing_removes_what_seeds_share():
    shared, noise = rng(2).normal(0.0, 100.0, 10), rng(3).normal(0.0, 1.0, 10)
    contrast = paired_bootstrap(shared + 5.0 + noise, shared, rng())
    assert contrast.significant
    assert contrast.high - contrast.low < 3.0


def test_swapping_the_cells_mirrors_the_interval():
    a, b = rng(4).normal(size=10), rng(5).normal(size=10)
    forth, back = paired_bootstrap(a, b, rng()), paired_bootstrap(b, a, rng())
    assert (back.mean, back.low, back.high) == pytest.approx((-forth.mean, -forth.high, -forth.low))


def test_width_of_the_interval_is_that_of_a_mean():
    difference = rng(6).normal(0.0, 2.0, 400)
    contrast = paired_bootstrap(difference, np.zeros(400), rng())
    assert contrast.high - contrast.low == pytest.approx(2 * 1.96 * sem(difference), rel=0.03)


@pytest.mark.parametrize(
    ("a", "b", "told"),
    [([], [], "same seeds"), ([1.0, 2.0], [1.0], "same seeds"), ([1.0, np.nan], [1.0, 2.0], "NaN")],
)
def test_bad_input_is_refused(a, b, told):
    with pytest.raises(InvalidInput, match=told):
        paired_bootstrap(a, b, rng())


@pytest.fixture(scope="module")
def published():
    if not PAPER_RUNS.exists():
        pytest.skip("the authors' per-run results are not beside this checkout (../shared/data/paper)")
    cells = defaultdict(dict)
    with PAPER_RUNS.open() as file:
        for row in csv.DictReader(file):
            cells[int(row["n"]), float(row["w"])][int(row["seed"])] = float(row["eval_return_mean"])
    return {key: np.array([by_seed[s] for s in range(10)]) for key, by_seed in cells.items()}


@pytest.mark.parametrize("c", paper.CONTRASTS, ids=lambda c: f"{c.a}-{c.b}")
def test_the_papers_contrasts_follow_from_its_runs(published, c):
    contrast = paired_bootstrap(published[c.a], published[c.b], rng())
    assert contrast.mean == pytest.approx(c.mean, abs=0.6)
    if c.interval:
        assert (contrast.low, contrast.high) == pytest.approx(c.interval, abs=1.5)


@pytest.mark.parametrize("m", paper.MEANS, ids=lambda m: f"n{m.n}-w{m.w:g}")
def test_the_papers_means_follow_from_its_runs(published, m):
    assert np.mean(published[m.n, m.w]) == pytest.approx(m.mean, abs=2.5 if "about" in m.place else 0.6)


def test_the_papers_errors_are_sample_standard_errors(published):
    assert sem(published[10, 0.0]) == pytest.approx(6.0, abs=0.5)
