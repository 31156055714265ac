"""Figures and page of the mismatch experiment, drawn for an answer of invented numbers that is known beforehand."""

import itertools
from collections import Counter
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from study.figure_style import STYLE, save_figure
from study.formatting import MINUS
from study.mismatch.mismatch_findings import MismatchFindings, Split, Verdict
from study.mismatch.mismatch_page import CAPTION, MISMATCH_COLOURS, mismatch_account
from study.mismatch.mismatch_plan import MISMATCH_PLANS, STRATEGIES
from study.pipeline.publication import AnswerSection
from study.statistics import paired_t
from study.strategies.trial_figures import returns_in_rows
from study.strategies.trial_findings import Outcome, planned_contrasts

OPTIMUM, SEED_STEP = -360.0, 3.0
STRUCTURE = {"plain": 0.0, "coulomb": 15.0, "delay_medium": 40.0, "delay_large": 150.0, "magnet": 140.0, "slew": 120.0}
IDENTIFICATION = {"prior": 400.0, "breadth": 250.0, "grid": 60.0}
TRAINING = 12.0


def invented(plan):
    """J = optimum - structure (not of mended where the catalogue has the effect) - identification - training."""
    outcomes, splits = {}, {}
    for condition in dict.fromkeys(case.condition for case in plan.cases):
        seeds = plan.seeds_of(condition.strategy)
        knows = condition.strategy == "mended" and condition.plant not in ("magnet", "slew")
        structure = 0.0 if knows or condition.strategy == "oracle" else STRUCTURE[condition.plant]
        identification = IDENTIFICATION.get(condition.strategy, 2.0 + 50.0 / max(condition.n, 5))
        identification *= condition.strategy != "oracle"
        reached = OPTIMUM - structure - identification - TRAINING
        reached = reached - SEED_STEP * (len(condition.strategy) + np.arange(len(seeds)))
        nothing = np.full(len(seeds), np.nan)
        outcomes[condition] = Outcome(seeds, reached, np.full(len(seeds), OPTIMUM), nothing, nothing, nothing, nothing)
        split = Split(structure, identification, OPTIMUM - np.mean(reached) - structure - identification, len(seeds))
        splits[condition] = split if STRATEGIES[condition.strategy].center or condition.strategy == "oracle" else None
    compared = tuple(
        replace(row, contrast=paired_t(pair[0] + np.linspace(-1.0, 1.0, len(pair[0])), pair[1]), p=0.001)
        for row in planned_contrasts(plan, outcomes)
        for pair in [[outcomes[plan.condition(plan.plant(row.plant), "encoder", strategy, row.n)].returns
                      for strategy in (row.a, row.b)]]
    )  # fmt: skip
    verdicts = {
        (p.name, n): Counter({Verdict("missing", ("delay",)): 12, Verdict("unknown"): 3})
        for p in plan.plants
        for n in plan.contrasted
    }
    return MismatchFindings(plan, outcomes, compared, 7, 9000.0, {"numpy": "2.x"}, splits, verdicts)


@pytest.fixture(scope="module", params=["mismatch", "mismatch-quick", "one seed"])
def answer(request):
    if request.param == "one seed":
        return invented(replace(MISMATCH_PLANS["mismatch-quick"], seeds=(1000,), described=1))
    return invented(MISMATCH_PLANS[request.param])


@pytest.fixture(scope="module")
def figure(answer):
    with matplotlib.rc_context(STYLE):
        made = returns_in_rows(answer, STRATEGIES.__getitem__, MISMATCH_COLOURS)
        made.canvas.draw()
    return made


def dots(axes):
    """Means (x, y) of the round marks."""
    return [(line.get_xdata()[0], line.get_ydata()[0]) for line in axes.lines if line.get_marker() == "o"]


def test_every_mean_is_a_dot_or_a_number_at_the_edge(answer, figure):
    for axes, plant in zip(figure.axes, answer.plan.plants, strict=True):
        means = sorted(
            round(o.mean.mean, 6) for condition, o in answer.outcomes.items() if condition.plant == plant.name
        )
        numbers = [text.get_text() for text in axes.texts if text.get_text().startswith("◂")]
        shown = sorted(round(x, 6) for x, _ in dots(axes))
        assert shown == means[len(numbers) :]
        assert [f"◂ {MINUS}{-mean:.0f}" for mean in means[: len(numbers)]] == sorted(numbers, reverse=True)
        low, high = axes.get_xlim()
        assert all(low < x < high for x in shown)
        assert low < answer.optimum(plant.name) < high


def test_every_way_stands_in_a_row_of_its_own_in_words(answer, figure):
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == [STRATEGIES[strategy].short for strategy in STRATEGIES if strategy in answer.plan.strategies]


def test_titles_do_not_run_into_the_next_panel(answer, figure):
    renderer = FigureCanvasAgg(figure).get_renderer()
    row = [axes for axes in figure.axes if axes.get_title(loc="left")]
    texts = [[axes._left_title, *axes.texts] for axes in row]
    assert len(row) == len(answer.plan.plants)
    for panel, following in itertools.pairwise(zip(texts, row, strict=True)):
        end = max(text.get_window_extent(renderer).x1 for text in panel[0])
        assert end < following[1].get_window_extent(renderer).x0


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mismatch")
    findings = invented(MISMATCH_PLANS["mismatch"])
    figures = {"returns": save_figure(lambda: Figure(figsize=(1.0, 1.0)), folder / "a.png")}
    account = replace(
        mismatch_account(findings),
        sections=[AnswerSection([("Does breadth pay?", "Breadth <b> changed it by +40 [30, 50].")])],
    )
    return account.page({name: (path, CAPTION) for name, path in figures.items()})


def test_the_page_says_the_answer_first_and_escapes_it(html):
    place = html.index("Breadth &lt;b&gt; changed it by +40\u00a0[30,\u00a050].")
    assert place < html.index("<img") < html.index("<table")


def test_the_page_holds_every_contrast_with_its_interval_and_every_way(html):
    findings = invented(MISMATCH_PLANS["mismatch"])
    for row in findings.compared:
        assert str(row.contrast).replace(" ", "\u00a0") in html
    for condition, outcome in findings.outcomes.items():
        assert f"{outcome.mean.mean:.0f}".replace("-", MINUS) in html, condition
    assert "missing: delay (12), unknown (3)" in html
    assert all(plant.title[1:] in html for plant in findings.plan.plants)
    assert ">nan" not in html
