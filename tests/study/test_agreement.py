"""Agreement: runs that are the published ones agree, runs that were moved do not, and pairs are not pretended."""

import dataclasses

import numpy as np
import pytest

from study.formatting import MINUS
from study.paper.agreement import DIFFERS, MARGIN, OPEN, SAME, Agreement
from study.paper.finished_runs import Outcomes, Run, outcomes
from study.paper.presets import PAPER, Cell
from study.paper.published_numbers import BASELINE, CELLS, DIFFERENCES, Spot

MAIN = Spot("main", 50, 0.0)


def invented(scatter=1.0, seed=0):
    """Runs of every published cell with the published means, and a scatter of their own."""
    rng = np.random.default_rng(seed)
    rows = []
    for spot, cell in CELLS.items():
        noise = scatter * rng.normal(size=cell.seeds)
        for s, value in enumerate(cell.mean + noise - noise.mean()):
            rows.append(Run(Cell(*spot, s), (2.1, 1.5), 0.5, value, fresh_mean=value - 3.0))
    return outcomes(rows)


def moved(runs, by, spot=None, seeds=None):
    """The same runs, some of them changed by a function of the outcome."""
    return Outcomes({
        at: {s: by(o) if (spot in (None, at) and (seeds is None or s in seeds)) else o for s, o in cells.items()}
        for at, cells in runs.table.items()
    })  # fmt: skip


def shifted(value):
    return lambda o: dataclasses.replace(o, mean=o.mean + value)


def at_main(ours, theirs):
    """The agreement of that cell."""
    return next(c for c in Agreement(ours, theirs).cells if c.spot == MAIN)


@pytest.fixture(scope="module")
def theirs():
    return invented(scatter=40.0)


def test_the_same_runs_agree_everywhere(theirs):
    agreement = Agreement(theirs, theirs)
    assert {c.verdict for c in agreement.cells} == {SAME}
    assert len(agreement.cells) == len(CELLS)
    assert all(c.change.mean == 0.0 for c in agreement.contrasts)


def test_pairing_finds_what_scatter_between_seeds_hides(theirs):
    rng = np.random.default_rng(1)
    ours = moved(theirs, lambda o: dataclasses.replace(o, mean=o.mean - 30.0 + rng.normal(0.0, 2.0)), MAIN)
    paired, unpaired = (at_main(ours, side) for side in (theirs, None))
    assert (paired.verdict, paired.difference.mean) == (DIFFERS, pytest.approx(-30.0, abs=2.0))
    assert "paired over 10 seeds" in paired.basis
    assert unpaired.verdict in (OPEN, DIFFERS)
    assert unpaired.basis.startswith("unpaired (Welch)")
    assert unpaired.difference.high - unpaired.difference.low > 3 * (paired.difference.high - paired.difference.low)


def test_a_small_but_certain_difference_is_the_same_and_a_wide_interval_is_open(theirs):
    assert at_main(moved(theirs, shifted(0.2 * MARGIN), MAIN), theirs).verdict == SAME
    rng = np.random.default_rng(2)
    loud = moved(theirs, lambda o: dataclasses.replace(o, mean=o.mean + rng.normal(0.0, 90.0)), MAIN)
    assert at_main(loud, theirs).verdict == OPEN


def test_nothing_is_paired_whose_estimates_or_starts_are_others(theirs):
    elsewhere = moved(theirs, lambda o: dataclasses.replace(o, theta_hat=(2.145, 1.5)), MAIN, seeds={4})
    assert at_main(elsewhere, theirs).basis.endswith("other theta_hat at seed 4")
    rounded = moved(theirs, lambda o: dataclasses.replace(o, theta_hat=(2.1 + 1e-12, 1.5)))
    assert all(c.basis.startswith("paired") for c in Agreement(rounded, theirs).cells)
    others = Agreement(theirs, theirs, dataclasses.replace(PAPER, episodes=5))
    assert all("start states" in c.basis for c in others.cells)


def test_one_unlucky_seed_is_named(theirs):
    rng = np.random.default_rng(3)
    ours = moved(theirs, lambda o: dataclasses.replace(o, mean=o.mean + rng.normal(0.0, 3.0)), MAIN)
    unlucky = moved(ours, shifted(-400.0), MAIN, seeds={7})
    spread = moved(unlucky, shifted(-20.0), MAIN)
    for runs, single in ((unlucky, True), (spread, False)):
        outlier = at_main(runs, theirs).outlier
        assert outlier.seed == 7
        assert outlier.rest.significant != single


def test_contrasts_agree_by_sign_and_significance():
    ours = invented()
    upside_down = moved(ours, shifted(-900.0), MAIN)
    agrees = {c.published.label: c.agrees for c in Agreement(ours).contrasts}
    assert agrees["n = 0 → 10, w = 0"]
    opposite = {c.published.label: c.agrees for c in Agreement(upside_down).contrasts}
    assert opposite["n = 0 → 50, w = 0"] is False
    alone = Agreement(Outcomes({MAIN: ours.table[MAIN]}))
    assert {c.agrees for c in alone.contrasts} == {None}
    assert len(alone.contrasts) == len(DIFFERENCES)


def test_without_the_files_the_published_intervals_stand_all_the_same():
    rows = Agreement(invented()).contrasts
    narrow = [c for c in rows if c.published.b.w == 0.2]
    assert [c.theirs_t.significant for c in narrow] == [True, False, False, False]
    assert not any(c.survives for c in narrow)
    assert sum(c.published.significant for c in rows) == 21
    assert sum(c.survives for c in rows) == 10


def test_the_robustness_table_has_our_row_where_it_was_run():
    ours = invented()
    rows = Agreement(ours).robustness
    for row in rows:
        assert row.mean == pytest.approx(row.printed, abs=0.7)
        assert row.budget.ours.mean == pytest.approx(row.budget.theirs.mean, abs=1.2)
        assert row.wide.ours.mean == pytest.approx(row.wide.theirs.mean, abs=1.2)
    assert [row.point for row in rows if row.wider] == ["large_gap"]
    without = Outcomes({spot: cells for spot, cells in ours.table.items() if spot.point != "main"})
    assert [row.best is None for row in Agreement(without).robustness] == [True] + [False] * (len(rows) - 1)


def test_the_words_hold_the_numbers(theirs):
    said = dict(Agreement(moved(theirs, shifted(-100.0), MAIN), theirs).sentences())
    ran = f"published cells {len(CELLS)} were run here: {len(CELLS) - 1} are the same within ±20, 1 differ"
    assert ran in said["Do the returns agree?"]
    baseline = said["Does covering the truth replace measuring it?"]
    assert f"{MINUS}749 ± 18 there" in baseline
    assert f"against n = 50, w = 0 that is {MINUS}413 [{MINUS}442, {MINUS}385] there" in baseline
    assert "10 survive Holm" in said["Which published claims of significance stand?"]


def test_cells_of_one_seed_and_cells_that_are_not_there_do_no_harm(theirs):
    one = Outcomes({spot: {0: cells[0]} for spot, cells in theirs.table.items() if spot != BASELINE})
    agreement = Agreement(one, theirs)
    assert {c.verdict for c in agreement.cells} == {OPEN}
    assert all(text for _, text in agreement.sentences())
    assert Agreement(Outcomes({}), theirs).cells == []
