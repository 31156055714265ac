"""The report: complete, self-contained, pictures first, for every verdict; and its pictures show the answer."""

from __future__ import annotations

import base64
import html
import io
import math
import re
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

from sysid import (
    Comparison,
    Coulomb,
    InvalidInput,
    LinearAxis,
    Model,
    Record,
    RodPendulum,
    Sensor,
    Viscous,
    compare,
    fit,
    plot_comparison,
    simulate,
)
from sysid.data.splitting import split
from sysid.diagnosis.answer import Diagnosis, Remaining, Step
from sysid.diagnosis.predictions import typical
from sysid.diagnosis.ranked import Ranked
from sysid.estimation.held_out import held_out_error
from sysid.planning.excitation import steps
from sysid.planning.planned_experiment import Experiment
from sysid.report import figures
from sysid.report import typesetting as set_as
from sysid.report.write import page_of, write_report
from tests.sysid.planted import SENSOR, logs, pushed

ROD = Model(RodPendulum(m=1.0, l=0.9), dt=0.02)
STICKY = ROD.with_effect(Coulomb(tau_c=0.15))
KINDS = ("adequate", "missing", "unknown", "cannot tell", "comparison")
VOID = {"meta", "img", "br"}


@cache
def fitted(records: tuple[Record, ...], sensor: Sensor) -> tuple:
    """What is held out, and without and with friction the fit and its error there."""
    training, held_out = split(records)
    fits = [fit(m, training, sensor, [n for n in m.parameters if n != "g"]) for m in (ROD, STICKY)]
    return held_out, *((estimate, held_out_error(estimate.model, held_out, sensor)) for estimate in fits)


@cache
def compared(record: Record) -> Comparison:
    return compare(ROD, (record,), SENSOR)


def diagnosis(records: list[Record], verdict: str = "missing", sensor: Sensor = SENSOR) -> Diagnosis:
    """What `diagnose` would say, in less time than it takes: dry friction or, where it is hidden from it, nothing."""
    held_out, (base, before), (end, after) = fitted(tuple(records), sensor)
    alike = ("coulomb", "stribeck") if verdict == "cannot tell" else ("coulomb",)
    tau_c = {"coulomb.tau_c": {"value": end.values["coulomb.tau_c"], "sd": end.sd["coulomb.tau_c"], "unit": "N m"}}
    step = Step("coulomb", alike, alike[1:], tau_c, before.ratio, after.ratio, 1e-20, end)
    added = (step,) if verdict in ("missing", "cannot tell") else ()
    return Diagnosis(
        verdict=verdict,
        base=base,
        base_error=before,
        error=after if added else before,
        steps=added,
        conventions=(),
        ranking=(Ranked("coulomb", alike, 900.0, 1e-20, 1.0), Ranked("tilt", ("tilt",), -3.0, 1.0, None)),
        remaining=Remaining(0.9, ("theta_dot",), "strongest for theta_dot from 1.00 to 2.00 rad/s (-0.15 N m)")
        if verdict == "unknown"
        else None,
        not_identifiable=(("m", "l", "torque_gain"),),
        ruled_out={"viscous": {"parameter": "b", "size": 0.00123, "unit": "N m s/rad"}},
        sensor=sensor,
        records=tuple(records),
        unseen=held_out,
        estimate=end if added else base,
        contacts=(),
        next_experiment=Experiment("none", "play steps.", ("coulomb", "stribeck")),
        seconds=1.5,
    )


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return logs(STICKY, n=4, seconds=3.0)


@pytest.fixture(scope="module")
def pages(records, tmp_path_factory) -> dict[str, str]:
    """A page for every verdict that shows what no other does, and one of a comparison alone."""
    folder, texts = tmp_path_factory.mktemp("report"), {}
    answers = {v: diagnosis(records, v) for v in KINDS[:-1]} | {"comparison": compared(records[-1])}
    for name, answer in answers.items():
        write_report(answer, folder / f"{name}.html")
        texts[name] = (folder / f"{name}.html").read_text(encoding="utf-8")
    return texts


def text(page: str) -> str:
    words = re.sub(r"<[^>]*>", " ", re.sub(r"<style>.*?</style>", "", page, flags=re.S))
    return html.unescape(re.sub(r"[ \n]+", " ", words))


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_it_opens_without_a_network(pages, kind):
    page = pages[kind]
    links = re.findall(r"(?:src|href|url|import)\s*[=(]\s*[\"']?([^\"')\s>]+)", page)
    assert len(links) >= 6
    assert all(link.startswith("data:image/svg+xml;base64,") for link in links)
    assert "<script" not in page
    for link in links:
        svg = base64.b64decode(link.split(",", 1)[1])
        assert ElementTree.fromstring(svg).tag.endswith("svg")
        outward = [h for h in re.findall(rb'href="([^"]*)"', svg) if not h.startswith((b"#", b"data:image/png"))]
        assert outward == []


@pytest.mark.parametrize("kind", KINDS)
def test_the_verdict_then_pictures_then_numbers(pages, kind):
    page = pages[kind]
    assert page.index("<h1") < page.index('class="error"') < page.index("<img") < page.index("<table")
    assert page.rindex("<img") < page.index("<table")


@pytest.mark.parametrize("kind", KINDS)
def test_every_tag_is_closed_and_every_picture_has_words(pages, kind):
    open_tags = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag, attrs):
            assert tag != "img" or dict(attrs)["alt"]
            if tag not in VOID:
                open_tags.append(tag)

        def handle_endtag(self, tag):
            assert open_tags.pop() == tag

    Reader().feed(pages[kind])
    assert open_tags == []


def test_it_reads_in_light_and_dark_and_on_a_phone(pages):
    for page in pages.values():
        assert "prefers-color-scheme: dark" in page
        assert 'name="viewport"' in page


def test_the_page_says_what_the_answer_says(records, pages):
    answer, said = diagnosis(records), text(pages["missing"])
    assert f"{answer.base_error.ratio:.2f} → {answer.error.ratio:.2f} times the sensor noise" in said
    assert answer.finding.replace("+-", "±") in said
    low, high = answer.estimate.interval()["coulomb.tau_c"]
    sd = answer.estimate.sd["coulomb.tau_c"]
    assert f"{set_as.rounded(low, sd)} to {set_as.rounded(high, sd)}" in said
    for words in ("m, l, torque_gain", "viscous 0.0012 N m s/rad b", "play steps.", "angle 0.003 rad", "rollout 3",
                  "600 samples (12 s) at 50 Hz"):  # fmt: skip
        assert words in said, words


def test_what_is_unknown_is_shown_before_all_else(pages):
    titles = re.findall(r"<h2>(.*?)</h2>", pages["unknown"])
    assert titles[1] == "The torque that no known effect explains"
    assert "90% of the model's squared error is more than noise" in text(pages["unknown"])
    assert "stribeck" in text(pages["cannot tell"])


def test_a_comparison_has_a_page_of_its_own(records, pages):
    answer, said = compared(records[-1]), text(pages["comparison"])
    assert answer.sentence in said
    for error in answer.errors.values():
        assert set_as.typeset_multiple(error.ratios["theta"]) in said


@pytest.fixture(scope="module")
def of_axis() -> Comparison:
    """A linear axis whose dry friction its model lacks."""
    axis, sensor, rng = Model(LinearAxis(m=1.0), dt=0.02), Sensor(0.001, 0.01), np.random.default_rng(0)
    u = np.array([steps(rng, 150, 0.02, 1.5, 0.3) for _ in range(2)])
    run = simulate(axis.with_effect(Coulomb(tau_c=0.2)), u, np.zeros(2), np.zeros(2))
    return compare(axis, sensor.measure(run, rng), sensor)


def test_the_page_of_an_axis_is_in_metres_and_newtons(of_axis, tmp_path):
    write_report(of_axis, tmp_path / "axis.html")
    page = (tmp_path / "axis.html").read_text(encoding="utf-8")
    said = text(page) + " ".join(re.findall(r'alt="([^"]*)"', page))
    assert "dry friction of about 0.2 N" in said and "position 0.001 m, speed 0.01 m/s" in said
    assert not re.search(r"\brad\b|N m\b|upright", said) and "The position x grows the way" in said


def test_it_says_what_asked_for_it_and_which_way_is_positive(records, pages, tmp_path):
    write_report(compared(records[-1]), tmp_path / "page.html", "python -m sysid compare <log>.csv")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "command python -m sysid compare <log>.csv" in text(page) and "<log>" not in page
    assert "command" not in text(pages["comparison"]).split("How it was made")[1]
    assert "θ grows this way" in text(page)


@pytest.mark.long
def test_names_are_text_and_neither_markup_nor_formula(tmp_path):
    name = r'<script>alert("1")</script> $\frac$ & a very long name of a rollout that fills no panel'
    records = [replace(r, name=f"{name} {i}") for i, r in enumerate(logs(STICKY, n=4, seconds=2.0))]
    for answer in (diagnosis(records), compared(records[0])):
        write_report(answer, tmp_path / "report.html")
        page = (tmp_path / "report.html").read_text(encoding="utf-8")
        assert "<script" not in page
        assert "&lt;script&gt;alert" in page


@pytest.mark.long
@pytest.mark.parametrize("sensor", [Sensor(0.003), Sensor(None, 0.05)], ids=["angle", "speed"])
def test_a_log_of_one_channel(tmp_path, sensor):
    records = logs(STICKY, n=4, seconds=3.0, sensor=sensor)
    page = page_of(diagnosis(records, sensor=sensor))
    (table,) = [t for t in page.tables if t.title == "Errors by horizon"]
    assert len(table.heads) == 3


@pytest.mark.long
def test_what_a_hand_touched_is_shown(tmp_path):
    push = np.zeros(300)
    push[100:130] = 3.0 * np.hanning(30)
    answer = diagnosis(pushed(logs(STICKY, n=4, seconds=6.0), 1, STICKY, push))
    (warning,) = page_of(answer).warnings
    assert re.match(r"No state of the joint explains pushed, [12]\.\d-[23]\.\d s \(\+", warning)


def test_numbers_that_are_not_determined_are_said_to_be(records):
    answer = diagnosis(records)
    covariance = answer.estimate.covariance.copy()
    covariance[0] = covariance[:, 0] = math.inf
    answer = replace(answer, estimate=replace(answer.estimate, covariance=covariance))
    parameters = page_of(answer).tables[0]
    assert "not determined" in parameters.rows[0][1]
    assert "±" in parameters.rows[1][1]


def test_a_page_that_cannot_be_written_is_said_to_be(records, tmp_path):
    answer = compared(records[-1])
    with pytest.raises(InvalidInput, match="cannot write"):
        write_report(answer, tmp_path / "nowhere" / "report.html")
    with pytest.raises(InvalidInput, match="expected a Diagnosis or a Comparison"):
        page_of(3.0)


# ---- pictures --------------------------------------------------------------------------------------------------------


def test_the_error_falls_in_the_order_of_the_loop(records):
    answer = diagnosis(records)
    step = answer.steps[0]
    late = replace(step, effect="stamp", error_before=1.2, error_after=1.0)
    early = replace(step, error_before=answer.base_error.ratio, error_after=1.2)
    mixed = replace(answer, steps=(early,), conventions=(late,))
    assert figures.in_order(mixed) == (early, late)
    axes = figures.fall(mixed).axes[0]
    values = next(line.get_ydata() for line in axes.lines if line.get_linestyle() == "-" and len(line.get_ydata()) == 3)
    np.testing.assert_allclose(values, [answer.base_error.ratio, 1.2, 1.0])
    assert any(np.allclose(line.get_ydata(), 1.0) for line in axes.lines)
    assert axes.get_yscale() == "log"


def test_a_class_is_one_row_of_the_ranking(records):
    ranked = (
        Ranked("coulomb", ("coulomb",), 900.0, 1e-9, None),
        Ranked("viscous", ("viscous", "back_emf"), 700.0, 1e-7, None),
        Ranked("back_emf", ("back_emf", "viscous"), 700.0, 1e-7, None),
        Ranked("tilt", ("tilt",), -2.0, 0.6, None),
    )
    axes = figures.ranking(replace(diagnosis(records), ranking=ranked)).axes[0]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["coulomb", "viscous, back_emf", "tilt"]
    assert [bar.get_width() for bar in axes.patches] == [900.0, 700.0, 0.0]


def test_a_rollout_is_drawn_with_what_the_models_say(records):
    paths = typical((ROD, STICKY), records, SENSOR)
    assert paths[0].ratio > 3.0
    assert paths[1].ratio < 1.2
    figure = figures.rollout_figure(paths, SENSOR, ("as it came", "mended"))
    readings, before, after = (line.get_ydata() for line in figure.axes[0].lines[:3])
    assert np.nanstd(readings - after) < 1.3 * SENSOR.theta < 0.1 * np.nanstd(readings - before)
    assert figure.axes[-1].get_ylabel() == "torque [N m]"
    np.testing.assert_array_equal(figure.axes[-1].lines[0].get_ydata(), paths[0].command)
    left = [line.get_ydata() for line in figure.axes[1].lines]
    np.testing.assert_allclose(left, [readings - before, readings - after])


def test_a_model_that_loses_the_motion_is_drawn_piece_by_piece(records):
    (path,) = typical((ROD,), records, SENSOR, ahead=1.0)
    (whole,) = typical((ROD,), records, SENSOR)
    assert np.count_nonzero(np.isnan(path.t)) == 3
    assert path.ratio < whole.ratio


def test_the_stretch_that_is_shown_is_typical():
    records, odd = (logs(STICKY, n=n, seconds=3.0) for n in (3, 1))
    records += [replace(r, theta=r.theta + 0.2 * np.sin(9.0 * r.t)) for r in odd]
    paths = typical((STICKY,), records, SENSOR)
    assert 0.8 < paths[0].ratio < 1.2


@pytest.fixture(scope="module")
def answer() -> Comparison:
    return compare(ROD, logs(ROD.with_effect(Viscous(b=0.1)), n=2), SENSOR)


def rendered(figure: Figure) -> bytes:
    """Drawn, which finds what only drawing finds: layouts that collapse, text that cannot be set."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=60)
    return file.getvalue()


def words(figure: Figure) -> str:
    return " ".join(t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")))


@pytest.mark.filterwarnings("error")
def test_a_comparison_on_one_page(answer: Comparison) -> None:
    figure = plot_comparison(answer)
    assert len(rendered(figure)) > 20_000
    said = words(figure)
    assert answer.sentence.split(":")[0] in said
    for unit in ("[rad]", "[rad/s]", "[N m]"):
        assert unit in said


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("sensor", [Sensor(0.003), Sensor(None, 0.05)], ids=["angle", "speed"])
def test_a_comparison_of_one_channel_of_a_perfect_model(sensor: Sensor) -> None:
    rendered(plot_comparison(compare(ROD, logs(ROD, sensor=sensor, n=1), sensor)))


def test_the_curve_that_is_drawn_is_the_answer(answer: Comparison) -> None:
    torque = answer.torque
    over = torque.over("theta")
    by_angle, in_time = Figure().subplots(1, 2)
    figures.binned_torque(torque, "theta", by_angle)
    drawn = by_angle.lines[1].get_ydata()
    assert len(drawn) > 5 and np.all(np.isin(drawn, over.mean))
    figures.over_time(torque, in_time)
    np.testing.assert_array_equal(in_time.lines[1].get_ydata(), torque.records[0].d)


@pytest.mark.filterwarnings("error")
def test_an_axis_is_drawn_in_metres_and_newtons(of_axis: Comparison) -> None:
    said = words(plot_comparison(of_axis))
    assert "rad" not in said and "N m" not in said
    for label in ("position $x$ [m]", r"speed $\dot x$ [m/s]", "force [N]", "Force beyond the model"):
        assert label in said, label


def test_a_model_that_runs_away_is_drawn() -> None:
    lost = ROD.with_effect(Viscous(b=5e4))
    comparison = compare(lost, logs(ROD, n=1), SENSOR)
    assert comparison.torque is None
    rendered(plot_comparison(comparison))


# ---- typography ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0.14994, -3.7, 1.2e-5, 12345.678, 0.0])
@pytest.mark.parametrize("sd", [6.1e-5, 0.03, 0.99, 123.0])
def test_a_number_is_rounded_well_within_its_sd(value, sd):
    read = float(set_as.rounded(value, sd).replace(set_as.MINUS, "-"))
    assert abs(read - value) <= max(0.051 * sd, 0.5)
    assert abs(read - value) <= 0.051 * sd or sd > 10.0


@pytest.mark.parametrize(
    ("plain", "set_in_print"),
    [("-0.15", "~0.15"), ("6.1e-05", "6.1x10⁻⁵"), ("-2e+07", "~2x10⁷"), ("0.003", "0.003"), ("nan", "nan")],
)
def test_a_number_is_set_as_in_print(plain, set_in_print):
    assert set_as.typeset(plain) == set_in_print.replace("~", set_as.MINUS).replace("x", set_as.TIMES)
    assert set_as.typeset_multiple(math.inf) == "∞"
