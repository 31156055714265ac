"""The budget curve of an identifier: its saturation budget and what a rollout is worth are those that were put in."""

from dataclasses import replace

import numpy as np
import pytest

from study.formatting import MINUS
from study.paper.finished_runs import Run, outcomes
from study.paper.presets import Cell
from study.paper.published_numbers import Spot
from study.paper.saturation_budget import LABELS, budget_curves, paragraph

REFERENCES = {"optimal": -330.0, "swing_up_lqr": -335.0, "lqr": -960.0}
BUDGETS = (1, 2, 5, 10, 25, 50)
RETURNS = {
    "grid": (-700.0, -600.0, -450.0, -345.0, -340.0, -340.0),
    "least_squares": (-340.0,) * 6,
    "unscented": (-500.0, -500.0, -500.0, -420.0, -420.0, -420.0),
}
ERRORS = {"grid": 0.8, "least_squares": 0.02, "unscented": 0.1}


def runs(names=tuple(RETURNS)):
    return played({name: RETURNS[name] for name in names})


def played(returns):
    rng = np.random.default_rng(0)
    rows = [Run(Cell("prior", 0, 0.0, seed), (1.0, 1.0), 1.1, -770.0) for seed in range(5)]
    for name, values in returns.items():
        for n, value in zip(BUDGETS, values, strict=True):
            noise = rng.normal(size=5)
            rows += [
                Run(Cell(name, n, 0.0, seed), (2.0, 1.5), ERRORS[name], value + x)
                for seed, x in enumerate(noise - noise.mean())
            ]
    return outcomes(rows)


def test_the_saturation_budget_is_where_the_gap_stays_closed():
    curves = budget_curves(runs())
    assert {name: curve.saturation for name, curve in curves.items()} == {
        "grid": 10,
        "least_squares": 1,
        "unscented": None,
    }
    assert curves["grid"].worth == pytest.approx(42.5)
    assert curves["least_squares"].first.mean == pytest.approx(430.0)
    assert curves["grid"].after.mean == pytest.approx(5.0)
    assert curves["unscented"].after is None
    assert curves["grid"].closed[0] == 0.0


def test_the_paragraph_says_so():
    text = paragraph(budget_curves(runs()), {}, REFERENCES)
    assert all(name in text for name in LABELS.values())
    assert f"return {MINUS}770, on a plant that is known {MINUS}340, and the optimum is {MINUS}330." in text
    assert "95 % of that gap are closed, give or take a standard error, from n = 10 on, at 42 a rollout" in text
    assert "n = 50 closes 81 % of that gap" in text
    assert "40 to 40 times closer" in text


def test_a_failed_seed_moves_no_saturation_budget():
    """One of five agents with 50 rollouts that did not learn: the mean leaves the plateau by a standard error."""
    rows = runs()
    failed = rows.table[Spot("grid", 50, 0.0)]
    rows.table[Spot("grid", 50, 0.0)] = {**failed, 4: replace(failed[4], mean=-740.0)}
    assert rows.summary(Spot("grid", 50, 0.0)).mean < -400.0
    assert budget_curves(rows)["grid"].saturation == 10


def test_saturation_budgets_of_another_width_are_told_beside():
    curves = budget_curves(runs())
    text = paragraph(curves, {name: replace(curve, w=0.2) for name, curve in curves.items()}, REFERENCES)
    assert text.endswith(
        "In a band of w = 0.2 the saturation budget is n = 10 with grid search, n = 1 with least squares, none with "
        "the Kalman filter."
    )


def test_a_saturation_that_ends_again_is_none_yet():
    dipping = {"grid": (-340.0, -600.0, -340.0, -340.0, -340.0, -340.0)}
    assert budget_curves(played(dipping))["grid"].saturation == 5


def test_nothing_is_said_where_nothing_was_run():
    assert budget_curves(runs(())) == {}
    assert paragraph({}, {}, REFERENCES) == ""
    assert "closer than" not in paragraph(budget_curves(runs(("grid",))), {}, REFERENCES)
