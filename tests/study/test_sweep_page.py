"""Report, tables and figures: complete, self-contained, and drawn for presets of every size."""

import csv
import itertools
import re
from html.parser import HTMLParser

import matplotlib
import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.patches import Rectangle
from matplotlib.text import Annotation

from study.figure_style import STYLE
from study.formatting import MINUS
from study.paper import paper_figures as figures
from study.paper.finished_runs import run_table
from study.paper.published_numbers import CellSummary
from study.paper.reproduction import reproduce
from study.paper.sweep_page import reference_table, sweep_account
from study.pipeline.tables import write_rows

VOID = {"meta", "img", "br"}


@pytest.fixture(scope="module")
def page(answer, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    sweep_account([answer], reproduce([answer], folder)).write(folder, "cpu")
    return (folder / "report.html").read_text(encoding="utf-8")


def test_it_opens_without_a_network(page, answer):
    links = re.findall(r"(?:src|href|url|import)\s*[=(]\s*[\"']?([^\"')\s>]+)", page)
    assert len(links) == len(figures.drawings(answer)) + len({"heat maps", "best widths", "contrasts"})
    assert all(link.startswith("data:image/png;base64,") for link in links)
    assert "<script" not in page


def test_the_answer_comes_before_everything_else(page, answer):
    places = [page.index(text.split(" [")[0][:30]) for _, text in answer.sentences()]
    assert places == sorted(places)
    assert places[-1] < page.index("<img") < page.index("<table")


def test_every_tag_is_closed(page):
    open_tags = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag, attrs):
            if tag not in VOID:
                open_tags.append(tag)

        def handle_endtag(self, tag):
            assert open_tags.pop() == tag

    Reader().feed(page)
    assert open_tags == []


def test_settings_versions_and_the_papers_numbers_are_there(page):
    for text in ("sac.polyak", "torch", "population", "2.x", "+434", "Table I", f"{MINUS}771", "energy swing-up"):
        assert text in page


@pytest.mark.long
def test_small_presets_have_a_report_too(small_answer, tmp_path):
    drawn = sweep_account([small_answer], reproduce([small_answer], tmp_path)).write(tmp_path, "cpu")
    names = {path.name for path in drawn}
    assert "curves.png" in names
    assert ("pareto.png" in names) == (len(small_answer.point.budgets) > 1)
    assert ("heatmap.png" in names) == (len(small_answer.cells) > 1)
    for path in drawn:
        assert np.ptp(imread(path)[..., :3]) > 0.5


def test_the_heatmap_outlines_the_best_cell_and_prints_the_means(answer):
    with matplotlib.rc_context(STYLE):
        axes = figures.drawings(answer)["heatmap"]().axes[0]
    (outline,) = [p for p in axes.patches if isinstance(p, Rectangle)]
    column, row = (int(x + 0.5) for x in outline.get_xy())
    assert (answer.point.budgets[row], answer.point.widths[column]) == answer.best
    printed = {}
    for text in axes.texts:
        x, y = text.get_position()
        printed.setdefault((round(y), round(x)), []).append(text.get_text())
    assert len(printed) == len(answer.cells)
    mean, error = printed[row, column]
    assert mean == f"{MINUS}{abs(answer.mean(answer.best)):.0f}"
    assert error.startswith(f"± {answer.summaries[answer.best].sem:.0f} · ")


@pytest.mark.parametrize("error", [0.0, 20.0, 32.0, 60.0])
def test_no_note_of_the_best_widths_covers_another(error):
    """Wide error bars push the name of a width down onto that of the line below it."""
    means = {(0, 0.0): -836.0, (0, 0.5): -900.0, (5, 0.0): -520.0, (50, 0.0): -400.0, (50, 0.5): -410.0}
    cells = {key: CellSummary(mean, error, mean, 3) for key, mean in means.items()}
    with matplotlib.rc_context(STYLE):
        figure = figures.paretos({"": cells}, {"optimal": -331.0, "swing_up_lqr": -335.0, "lqr": -960.0})
        figure.draw_without_rendering()
        boxes = [note.get_window_extent() for note in figure.axes[0].findobj(Annotation)]
    assert len(boxes) == 3 + 2 + 3
    assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))


@pytest.mark.parametrize("gain", [130.0, -130.0])
def test_the_names_of_two_close_lines_stand_on_their_outer_sides(gain):
    """Between the lines a name could be read as that of either."""
    cells = {(n, 0.0): CellSummary(mean, 20.0, mean, 2) for n, mean in ((0, -1460.0), (2, -1460.0 + gain))}
    with matplotlib.rc_context(STYLE):
        figure = figures.paretos({"": cells}, {"optimal": -331.0, "swing_up_lqr": -335.0, "lqr": -960.0})
        figure.draw_without_rendering()
        notes = {note.get_text().split(",")[0]: note for note in figure.axes[0].findobj(Annotation)}
        middle = {name: notes[name].get_window_extent() for name in ("no data", "pure fidelity")}
    upper, lower = ("pure fidelity", "no data") if gain > 0.0 else ("no data", "pure fidelity")
    height = {name: figure.axes[0].transData.transform((0.0, notes[name].xy[1]))[1] for name in middle}
    assert middle[upper].y0 > height[upper] > height[lower] > middle[lower].y1


def test_runs_csv_has_the_papers_columns_and_conventions(answer, tmp_path):
    write_rows(tmp_path / "runs.csv", *run_table(answer.runs))
    with (tmp_path / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    papers = "n,w,seed,id_error,eval_return_mean,eval_return_std,theta_hat_mass,theta_hat_length,wall_time_s"
    assert ",".join(rows[0]) == papers + ",point,eval_return_fresh"
    order = [(int(r["n"]), float(r["w"]), int(r["seed"])) for r in rows]
    assert order == sorted(order)
    assert len(order) == len(set(order)) == 18
    assert float(rows[0]["eval_return_std"]) == pytest.approx(30.0 / 2**0.5)  # divided by E, not by E - 1


def test_references_csv_has_every_controller(answer, tmp_path):
    write_rows(tmp_path / "references.csv", *reference_table([answer]))
    with (tmp_path / "references.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(r["m"], r["l"], r["controller"]) for r in rows] == [
        ("2.0", "1.5", name) for name in ("optimal", "lqr", "swing_up_lqr")
    ]
    ten = answer.reference("optimal", seeds=range(10))
    assert float(rows[0]["return_mean"]) == pytest.approx(np.mean(ten))
    assert float(rows[0]["return_sem"]) == pytest.approx(np.std(ten, ddof=1) / 10**0.5)


def test_the_paper_is_compared_with_the_optimum_from_its_start_states(page, answer):
    optimum = np.mean(answer.reference("optimal", seeds=range(10)))
    assert f"the best cell is {100.0 * (optimum + 337.0) / -optimum:.1f} % below it" in " ".join(page.split())


def test_both_heat_maps_of_a_report_share_their_optimum_and_their_shares(answer, tmp_path):
    """The study's seeds are fewer than the reference seeds, and their optimum is another."""
    assert answer.optimum != pytest.approx(answer.figure_references["optimal"], abs=1.0)
    with matplotlib.rc_context(STYLE):
        heatmap = figures.drawings(answer)["heatmap"]()
        held = reproduce([answer], tmp_path).drawings["published_heatmap"]()
    scales = [[note.get_text() for note in figure.axes[-1].findobj(Annotation)] for figure in (heatmap, held)]
    assert scales[0] == scales[1]
    assert heatmap.axes[0].images[0].norm.vmax == held.axes[0].images[0].norm.vmax
    shares = [
        {text.get_text() for text in axes.texts if "%" in text.get_text()} for axes in (heatmap.axes[0], held.axes[1])
    ]
    assert shares[0] == shares[1]
