"""The budget curve of an identifier: its knee and what a rollout is worth are those that were put in."""

import numpy as np
import pytest

from study.publication.knee import IDENTIFIERS, budget_curves, paragraph
from study.publication.paper import Spot
from study.publication.published import Outcome, outcomes
from study.statistics import MINUS

REFERENCES = {"optimal": -330.0, "swing_up_lqr": -335.0, "lqr": -960.0}
BUDGETS = (1, 2, 5, 10, 25, 50)
RETURNS = {
    "grid": (-700.0, -600.0, -450.0, -345.0, -340.0, -340.0),
    "least_squares": (-340.0,) * 6,
    "unscented": (-500.0, -500.0, -500.0, -420.0, -420.0, -420.0),
}
ERRORS = {"grid": 0.8, "least_squares": 0.02, "unscented": 0.1}


def runs(names=tuple(RETURNS)):
    return noisy({name: RETURNS[name] for name in names})


def noisy(returns):
    rng = np.random.default_rng(0)
    rows = [(Spot("prior", 0, 0.0), seed, Outcome(-770.0, 1.1, (1.0, 1.0))) for seed in range(5)]
    for name, values in returns.items():
        for n, value in zip(BUDGETS, values, strict=True):
            noise = rng.normal(size=5)
            rows += [
                (Spot(name, n, 0.0), seed, Outcome(value + x, ERRORS[name], (2.0, 1.5)))
                for seed, x in enumerate(noise - noise.mean())
            ]
    return outcomes(rows)


def test_the_knee_is_where_the_gap_stays_closed():
    curves = budget_curves(runs(), REFERENCES)
    assert {name: curve.knee for name, curve in curves.items()} == {"grid": 10, "least_squares": 1, "unscented": None}
    assert curves["grid"].worth == pytest.approx(42.5)
    assert curves["least_squares"].first.mean == pytest.approx(430.0)
    assert curves["grid"].after.mean == pytest.approx(5.0)
    assert curves["unscented"].after is None
    assert curves["grid"].closed[0] == 0.0


def test_the_paragraph_says_so():
    text = paragraph(budget_curves(runs(), REFERENCES), REFERENCES)
    assert all(name in text for name in IDENTIFIERS.values())
    assert f"without data and the optimum ({MINUS}330) is closed from n = 10 on, at 42 a rollout" in text
    assert "stays open: n = 50 closes 80 %" in text
    assert "40 to 40 times closer" in text
    assert "the knee moves from n = 10 to n = 1" in text
    assert "With n = 1 least squares closes 98 % of the gap; the grid comes as far" in text


def test_where_no_knee_is_reached_it_says_from_where_on_the_grid_comes_as_far():
    short = {"grid": (-700.0, -600.0, -450.0, -360.0, -360.1, -360.0), "least_squares": (-360.0,) * 6}
    curves = budget_curves(noisy(short), REFERENCES)
    assert curves["grid"].knee is None
    text = paragraph(curves, REFERENCES)
    assert (
        "With n = 1 least squares closes 93 % of the gap; the grid comes as far, give or take a standard error, "
        in text
    )
    assert "from n = 10 on" in text and "knee moves" not in text


def test_a_knee_that_returns_is_none_yet():
    dipping = {"grid": (-340.0, -600.0, -340.0, -340.0, -340.0, -340.0)}
    assert budget_curves(altered(dipping), REFERENCES)["grid"].knee == 5


def altered(changes):
    rows = [(Spot("prior", 0, 0.0), seed, Outcome(-770.0, 1.1, (1.0, 1.0))) for seed in range(3)]
    rows += [
        (Spot(name, n, 0.0), seed, Outcome(value, 0.5, (2.0, 1.5)))
        for name, values in changes.items()
        for n, value in zip(BUDGETS, values, strict=True)
        for seed in range(3)
    ]
    return outcomes(rows)


def test_nothing_is_said_where_nothing_was_run():
    assert budget_curves(runs(()), REFERENCES) == {}
    assert paragraph({}, REFERENCES) == ""
    assert "sensing" not in paragraph(budget_curves(runs(("grid",)), REFERENCES), REFERENCES)
