"""The section beside the publication: complete for every preset, with its siblings where they are there."""

import dataclasses
import re

import numpy as np
import pytest
from matplotlib.image import imread

from study.figure_style import save_figure
from study.paper.finished_runs import Run, outcomes, run_table
from study.paper.identification_scatter import scatter
from study.paper.presets import PAPER_PRESETS, Cell
from study.paper.published_numbers import CELLS, Spot
from study.paper.reproduction import REPRODUCTION_CAPTIONS, reproduce
from study.paper.sweep_page import outputs, sweep_account
from study.pipeline.tables import write_rows


@pytest.fixture(scope="module")
def small_scatter():
    return scatter(np.random.default_rng(0), seeds=10, budgets=(5, 50, 100, 200))


@pytest.fixture(scope="module")
def theirs(answer):
    """The authors' runs, as if they were ours but for the seeds' scatter."""
    rng = np.random.default_rng(1)
    return outcomes(dataclasses.replace(run, mean=run.mean + rng.normal(), fresh_mean=np.nan) for run in answer.runs)


def words(answer, reproduction):
    """The section in the report."""
    page = sweep_account([answer], reproduction).page({})
    section = page[page.index("Held against the publication") : page.index("How it was made")]
    return " ".join(re.sub(r"<[^>]+>", " ", re.sub(r"data:[^\"]+", "", section)).split())


def test_every_part_is_there(answer, theirs, small_scatter, tmp_path):
    reproduction = reproduce([answer], tmp_path, theirs, small_scatter)
    assert set(reproduction.drawings) == set(REPRODUCTION_CAPTIONS) - {"identifiers"}
    for draw in reproduction.drawings.values():
        assert np.ptp(imread(save_figure(draw, tmp_path / "drawn.png"))[..., :3]) > 0.5
    text = words(answer, reproduction)
    for part in ("Where this run and the paper disagree", "Cell by cell", "Every published contrast",
                 "The robustness table", "What it claims beside its table", "paired over 3 seeds"):  # fmt: skip
        assert part in text
    assert "nan" not in text
    assert len(reproduction.claims) == 7


def test_without_the_authors_files_it_says_how_to_give_them(answer, tmp_path):
    reproduction = reproduce([answer], tmp_path)
    assert any("--published DIR" in note for note in reproduction.notes)
    assert all(cell.basis.startswith("unpaired") for cell in reproduction.agreement.cells)


def test_siblings_take_part_and_missing_ones_are_named(answer, tmp_path):
    paper = dataclasses.replace(
        answer, preset=dataclasses.replace(PAPER_PRESETS["paper-small"], points=answer.preset.points)
    )
    (tmp_path / "paper-small").mkdir()
    alone = reproduce([paper], tmp_path / "paper-small")
    assert any("--preset robustness-small" in note for note in alone.notes)
    assert any("--preset longer-small" in note for note in alone.notes)
    rows = [Run(Cell(*spot, 0), (1.0, 1.0), 0.1, CELLS[spot].mean) for spot in CELLS if spot.point == "small_gap"]
    longer = [Run(Cell("main", 50, 0.5, s), (2.0, 1.5), 0.1, -300.0) for s in range(3)]
    for name, runs in (("robustness-small", rows), ("longer-small", longer)):
        (tmp_path / name).mkdir()
        write_rows(tmp_path / name / "runs.csv", *run_table(runs))
    reproduction = reproduce([paper], tmp_path / "paper-small")
    assert not any("not beside these" in note for note in reproduction.notes)
    assert [row.best is not None for row in reproduction.agreement.robustness] == [True, True, False, False, False]
    assert "With 150,000 steps" in next(c.answer for c in reproduction.claims if c.name == "undertraining")
    assert Spot("main", 50, 0.5) in reproduction.agreement.ours
    assert reproduction.agreement.ours.summary(Spot("main", 50, 0.5)).mean != -300.0


def test_a_sibling_that_cannot_be_read_is_left_out_and_said(answer, tmp_path):
    paper = dataclasses.replace(
        answer, preset=dataclasses.replace(PAPER_PRESETS["paper-small"], points=answer.preset.points)
    )
    for name in ("robustness-small", "paper-small"):
        (tmp_path / name).mkdir()
    (tmp_path / "robustness-small" / "runs.csv").write_text("nonsense\n")
    reproduction = reproduce([paper], tmp_path / "paper-small")
    assert any("left out" in note and "no column" in note for note in reproduction.notes)


def test_longer_training_is_not_taken_for_the_published_sweep(answer, tmp_path):
    longer = dataclasses.replace(
        answer, preset=dataclasses.replace(PAPER_PRESETS["longer-small"], points=answer.preset.points)
    )
    for name in ("longer-small", "paper-small"):
        (tmp_path / name).mkdir()
    write_rows(tmp_path / "paper-small" / "runs.csv", *run_table(answer.runs))
    reproduction = reproduce([longer], tmp_path / "longer-small")
    assert reproduction.agreement is None
    assert "changes by +0 [+0, +0]" in next(c.answer for c in reproduction.claims if c.name == "undertraining")


def test_small_presets_have_the_section_too(small_answer, tmp_path):
    text = words(small_answer, reproduce([small_answer], tmp_path))
    assert "Held against the publication" in text
    assert "±nan" not in text


def test_the_store_knows_every_figure_that_may_be_written():
    assert {f"{name}.png" for name in REPRODUCTION_CAPTIONS} < set(outputs(PAPER_PRESETS["paper-small"]))
