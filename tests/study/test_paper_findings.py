"""The answer: effects that were put into the runs come out, and a gap is the sum of its parts."""

import dataclasses

import pytest

from study.formatting import MINUS


def test_what_rollouts_and_width_were_worth_comes_out(answer):
    assert answer.contrast((5, 0.0), (0, 0.0)).mean == pytest.approx(420.0)
    assert answer.contrast((50, 0.5), (50, 0.0)).mean == pytest.approx(-180.0)
    assert answer.best == (50, 0.0)


def test_a_gap_is_identification_plus_training(answer):
    for key, cost in (((0, 0.0), 500.0), ((5, 0.0), 80.0), ((50, 0.0), 2.0)):
        gap = answer.gap(key)
        assert gap.identification.mean == pytest.approx(cost)
        assert gap.training.mean == pytest.approx(4.0)
        assert gap.total.mean == pytest.approx(gap.identification.mean + gap.training.mean)


def test_what_a_seed_shares_does_not_widen_the_intervals(answer):
    contrast = answer.contrast((5, 0.0), (0, 0.0))
    assert contrast.high - contrast.low < 1e-9 < answer.summaries[5, 0.0].sem


def test_a_contrast_does_not_depend_on_what_was_asked_before(answer):
    first = answer.contrast((5, 0.5), (0, 0.0))
    answer.contrast((50, 0.5), (0, 0.0))
    assert answer.contrast((5, 0.5), (0, 0.0)) == first


def test_the_words_hold_the_numbers(answer):
    first, width, optimal = (text for _, text in answer.sentences())
    assert first.startswith("The first 5 rollouts were worth +420 [+420, +420]")
    assert f"{MINUS}180 [{MINUS}180, {MINUS}180] at n = 50" in width
    assert "2 [2, 2] because the model is off, 4 [4, 4] because of training" in optimal
    assert "75 % of cases" in answer.caveat()


def test_every_small_preset_has_an_answer_in_words(small_answer):
    said = small_answer.sentences()
    assert all(text.endswith(".") and "nan" not in text for _, text in said)
    choices = [small_answer.point.budgets, small_answer.point.widths]
    assert len(said) == 1 + sum(len(choice) > 1 for choice in choices)


def test_nothing_is_said_of_no_data_where_none_was_run(answer):
    point = dataclasses.replace(answer.point, budgets=answer.point.budgets[1:])
    (_, first), *_ = dataclasses.replace(answer, point=point).sentences()
    assert first.startswith("To go from n = 5 to n = 50 was worth")


def test_one_seed_shows_no_difference(answer):
    """An interval needs scatter: with one seed it is everything, and no difference stands."""
    alone = dataclasses.replace(answer, point=dataclasses.replace(answer.point, seeds=answer.point.seeds[:1]))
    assert not alone.contrast((50, 0.0), (0, 0.0)).significant
    assert all("not distinguishable" in text for _, text in alone.sentences()[:2])
    assert "no interval is finite" in alone.caveat()
