"""Claims: each answer says what was put into the numbers, and start states overlap as the report says."""

from dataclasses import replace

import numpy as np
import pytest

from study.formatting import MINUS
from study.paper import claims
from study.paper.finished_runs import Outcomes, Run, outcomes
from study.paper.identification_scatter import Scatter, scatter
from study.paper.presets import Cell
from study.paper.published_numbers import CELLS, DIFFERENCES, QUOTES, Spot
from study.statistics import Contrast

BUDGETS = (1, 2, 5, 10, 25, 50, 100, 200, 400)


def falling(power, noise=0.05):
    """Estimates whose error falls as n^power, with a share of bias that is none."""
    rng = np.random.default_rng(0)
    sigmas = (0.5, 1.0, 2.0)
    sizes = np.array(sigmas)[:, None, None, None] * 0.5 * (np.array(BUDGETS) / 50.0)[None, :, None, None] ** power
    signs = rng.choice([-1.0, 1.0], (3, len(BUDGETS), 400, 2)) * (
        1.0 + noise * rng.normal(size=(3, len(BUDGETS), 400, 2))
    )
    estimates = np.array([2.0, 1.5]) + sizes * signs
    return Scatter((2.0, 1.5), sigmas, BUDGETS, estimates, estimates)


@pytest.fixture(scope="module")
def measured():
    return scatter(np.random.default_rng(5), seeds=60, budgets=(5, 50, 100, 200))


def test_the_rate_is_recognised():
    assert claims.rate(falling(-0.5)).verdict == claims.HOLDS
    slow = claims.rate(falling(-0.2))
    assert slow.verdict == claims.FAILS
    assert f"to the power {MINUS}0.20" in slow.answer


def test_noise_in_the_inputs_scatters_m_and_does_not_move_it(measured):
    claim = claims.bias(measured)
    assert claim.verdict == claims.FAILS
    assert measured.thetas(1.0, 50)[:, 0].mean() == pytest.approx(
        measured.thetas(1.0, 50, clean=True)[:, 0].mean(), abs=0.03
    )
    assert measured.thetas(1.0, 50)[:, 0].std() > 0.4


def test_a_shift_of_the_inputs_would_be_seen(measured):
    shifted = Scatter(measured.truth, measured.sigmas, measured.budgets, measured.estimates + 0.2, measured.clean)
    assert claims.bias(shifted).verdict == claims.IN_PART


def test_a_floor_is_told_from_a_fall(measured):
    assert claims.error_floor(measured).verdict == claims.FAILS
    assert claims.error_floor(falling(0.0)).verdict == claims.OPEN


def test_the_nearest_cell_is_half_a_step_away_at_most():
    assert claims.nearest_cell((0.3, 3.0)) == pytest.approx(0.0, abs=1e-12)
    assert 0.0 < claims.nearest_cell((2.0, 1.5)) < claims.CELL / 2**0.5


def test_what_the_published_cells_say_against_the_text():
    assert "8 are within 20" in claims.plateau().answer
    assert "3 of 20 steps" in claims.monotone().answer


def test_ours_stand_beside():
    assert "Here 15 of 15 are." in claims.plateau(flat(-340.0)).answer
    assert "Here none of 20 steps" in claims.monotone(flat(-340.0)).answer


def flat(value):
    """Two runs of every cell of the paper's sweep."""
    spots = [spot for spot in CELLS if spot.point == "main"]
    return outcomes(
        Run(Cell(*spot, seed), (2.0, 1.5), 0.5, value, fresh_mean=value - seed) for spot in spots for seed in range(2)
    )


def test_200_evaluations_stand_on_29_start_states():
    assert claims.distinct_starts() == (29, 200)
    assert claims.starts().verdict == claims.IN_PART
    assert claims.starts((0, 20, 40)).verdict == claims.HOLDS


def test_fresh_starts_stand_beside():
    answer = claims.starts(ours=flat(-340.0)).answer
    assert f"returns {MINUS}340 ± 0.5 there instead of {MINUS}340 ± 0.0" in answer
    assert "start states that no two seeds share" not in claims.starts(ours=Outcomes({})).answer


def test_the_gap_is_to_what_the_same_starts_allow():
    """The best cell loses half a point to starts at which the optimum of its own seeds loses five."""
    runs, asked = flat(-340.0), []

    def optima(seeds):
        asked.append(seeds)
        return -330.0, -335.0

    answer = claims.starts(ours=runs, optima=optima).answer
    assert (
        f"the optimum goes from {MINUS}330 to {MINUS}335, and the cell is 1.6 % short of it instead of 3.0 %" in answer
    )
    assert asked == [runs.seeds(next(iter(runs.table)))]


def test_the_best_cell_is_one_of_the_plant_that_the_optimum_belongs_to():
    """An easy plant returns more than the optimum of a hard one."""
    easy, hard = Spot("small_gap", 50, 0.0), Spot("main", 25, 0.0)
    rows = [
        Run(Cell(*spot, s), (2.0, 1.5), 0.5, j, fresh_mean=j)
        for spot, j in ((easy, -224.0), (hard, -350.0))
        for s in range(3)
    ]
    answer = claims.starts(ours=outcomes(rows), optima=lambda seeds: (-340.0, -340.0)).answer
    assert "(n = 25, w = 0)" in answer and "2.9 % short" in answer


def test_a_contrast_that_other_starts_turn_is_told():
    a, b = DIFFERENCES[0].a, DIFFERENCES[0].b
    rows = [Run(Cell(*a, s), (2.0, 1.5), 0.5, -300.0 - s, fresh_mean=-300.0 - s) for s in range(5)]
    rows += [Run(Cell(*b, s), (2.0, 1.5), 0.5, -400.0 - 2 * s, fresh_mean=-300.0 + 3 * (-1) ** s) for s in range(5)]
    answer = claims.starts(ours=outcomes(rows)).answer
    assert (
        f"Of 1 published contrasts 0 change neither in sign nor in significance; these do: {DIFFERENCES[0].label}"
        in answer
    )
    same = [replace(run, fresh_mean=run.mean - 7.0) for run in rows]
    assert claims.starts(ours=outcomes(same)).answer.endswith("1 change neither in sign nor in significance.")


def curves(rise, seeds=6, spread=0.02, seed=1):
    rng = np.random.default_rng(seed)
    steps = 200.0 * np.arange(1, 376)
    return [list(zip(steps, rise * (1 + spread * rng.normal()) * steps / 1e4 + rng.normal(size=375), strict=True))
            for _ in range(seeds)]  # fmt: skip


def test_the_slope_at_the_end_of_training_is_found_with_its_interval():
    slopes = [claims.slope(curves(12.0, seed=seed)) for seed in range(40)]
    assert np.mean([slope.mean for slope in slopes]) == pytest.approx(12.0, rel=0.01)
    assert 0.85 <= np.mean([slope.low < 12.0 < slope.high for slope in slopes]) <= 1.0
    level = [(s, -300.0 - 1e4 / s) for s, _ in curves(0.0, 1)[0]]
    assert claims.slope([level, level]).mean == pytest.approx(0.03, abs=0.02)


@pytest.mark.parametrize(
    ("gain", "verdict"),
    [((30.0, 5.0, 60.0), claims.HOLDS), ((3.0, -5.0, 9.0), claims.OPEN), ((-9.0, -12.0, -2.0), claims.FAILS)],
)
def test_longer_training_decides_where_it_was_run(gain, verdict):
    claim = claims.undertraining({0.0: curves(0.0), 0.5: curves(9.0)}, 50, 75_000, (Contrast(*gain, 10), 150_000))
    assert claim.verdict == verdict
    assert "150,000 steps" in claim.answer
    assert claims.undertraining({0.5: curves(9.0)}, 50, 75_000).verdict == claims.IN_PART
    assert claims.undertraining({0.5: curves(0.0)}, 50, 75_000).verdict == claims.OPEN


def test_every_claim_quotes_the_paper(measured):
    said = [claims.rate(measured), claims.bias(measured), claims.error_floor(measured), claims.plateau(),
            claims.monotone(), claims.starts(), claims.undertraining({0.5: curves(1.0)}, 50, 75_000)]  # fmt: skip
    assert {claim.name for claim in said} == set(QUOTES)
    assert all(
        claim.quote and claim.place and claim.answer.endswith(".") and "nan" not in claim.answer for claim in said
    )
