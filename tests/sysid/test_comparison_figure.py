"""Every figure draws what its answer holds, without pyplot, and in units."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from sysid import LinearAxis, Model, RodPendulum, Sensor, Viscous, plot_comparison, simulate
from sysid.diagnosis.compare import Comparison, compare
from sysid.planning.excitation import steps
from sysid.report import figures
from tests.sysid.planted import SENSOR, logs

ROD = Model(RodPendulum(m=1.0, l=0.9), dt=0.02)


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
    assert torque is not None
    over = torque.over("theta")
    by_angle, in_time = Figure().subplots(1, 2)
    figures.binned_torque(torque, "theta", by_angle)
    drawn = by_angle.lines[1].get_ydata()
    assert len(drawn) > 5 and np.all(np.isin(drawn, over.mean))
    figures.over_time(torque, in_time)
    np.testing.assert_array_equal(in_time.lines[1].get_ydata(), torque.records[0].d)


@pytest.mark.filterwarnings("error")
def test_an_axis_is_drawn_in_metres_and_newtons() -> None:
    axis, rng = Model(LinearAxis(m=1.0), dt=0.02), np.random.default_rng(0)
    u = np.array([steps(rng, 250, 0.02, 1.5, 0.3) for _ in range(2)])
    initial_guess = axis.with_effect(Viscous(b=0.3))
    records = Sensor(0.001, 0.01).measure(simulate(initial_guess, u, np.zeros(2), np.zeros(2)), rng)
    found = compare(axis, records, Sensor(0.001, 0.01))
    said = words(plot_comparison(found))
    assert "rad" not in said and "N m" not in said
    for label in ("position $x$ [m]", r"speed $\dot x$ [m/s]", "force [N]", "Force beyond the model"):
        assert label in said, label


def test_a_model_that_runs_away_is_drawn() -> None:
    lost = ROD.with_effect(Viscous(b=5e4))
    found = compare(lost, logs(ROD, n=1), SENSOR)
    assert found.torque is None
    rendered(plot_comparison(found))


@pytest.mark.filterwarnings("error")
def test_a_name_is_no_formula() -> None:
    name = r"$\frac$ & a name that is longer than any panel is wide"
    answer = compare(ROD, [replace(r, name=name) for r in logs(ROD, n=1)], SENSOR)
    rendered(plot_comparison(answer))
