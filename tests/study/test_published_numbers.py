"""The published facts: they follow from the authors' own runs, and from each other."""

from pathlib import Path

import numpy as np
import pytest

from study.paper.finished_runs import read_published
from study.paper.published_numbers import BASELINE, CELLS, DIFFERENCES, ID_ERRORS, POINTS, QUOTES
from study.statistics import paired_bootstrap, paired_t, sem

AUTHORS = Path(__file__).resolve().parents[3] / "shared" / "data" / "paper"


@pytest.fixture(scope="module")
def runs():
    if not (AUTHORS / "summary.csv").exists():
        pytest.skip("the authors' per-run results are not beside this checkout (../shared/data/paper)")
    return read_published(AUTHORS)


def test_every_cell_is_the_mean_error_and_median_of_the_runs(runs):
    assert set(CELLS) == set(runs.table)
    for spot, cell in CELLS.items():
        summary = runs.summary(spot)
        assert (cell.mean, cell.sem, cell.median) == pytest.approx(
            (summary.mean, summary.sem, summary.median), abs=0.051
        )
        assert cell.seeds == summary.seeds


def test_what_the_text_prints_is_that_mean_rounded():
    printed = [cell for cell in CELLS.values() if cell.printed is not None]
    assert len(printed) == 11
    for cell in printed:
        assert cell.mean == pytest.approx(cell.printed, abs=2.1 if "about" in cell.place else 0.6)


@pytest.mark.parametrize("c", DIFFERENCES, ids=lambda c: c.label)
def test_every_contrast_follows_from_the_runs(runs, c):
    a, b = runs.returns(c.a), runs.returns(c.b)
    contrast = paired_bootstrap(a, b, np.random.default_rng(0))
    assert contrast.mean == pytest.approx(c.mean, abs=0.6)
    assert (contrast.low, contrast.high) == pytest.approx((c.low, c.high), abs=1.5 if c.printed else 0.51)
    assert sem(a - b) == pytest.approx(c.error, abs=0.051)
    assert contrast.significant == c.significant
    assert contrast.seeds == c.seeds


def test_identification_errors_are_those_of_the_runs(runs):
    for point, errors in ID_ERRORS.items():
        for n, error in errors.items():
            assert np.mean(runs.id_errors(point, n)) == pytest.approx(error, abs=0.005)


def test_narrow_bands_lose_their_significance_with_t_and_all_of_them_with_holm(runs):
    narrow = [c for c in DIFFERENCES if c.b.w == 0.2]
    kept = [c.a.n for c in narrow if paired_t(runs.returns(c.a), runs.returns(c.b)).significant]
    assert [c.a.n for c in narrow] == [5, 10, 25, 50]
    assert all(c.significant for c in narrow)
    assert kept == [5]


def test_facts_name_their_place():
    assert all(c.place for c in [*CELLS.values(), *DIFFERENCES])
    assert all(words and place.startswith("Sec. ") for words, place in QUOTES.values())
    assert {spot.point for spot in CELLS} == set(POINTS)
    assert CELLS[BASELINE].seeds == 10
