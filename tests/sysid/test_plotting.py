"""Every figure draws what its answer holds, without pyplot, and in units."""

from __future__ import annotations

import io
import math
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from sysid import Coulomb, Model, Record, RodPendulum, Sensor, Viscous, plotting, simulate
from sysid.diagnose.compare import Comparison, compare
from sysid.diagnose.residual_torque import residual_torque
from sysid.excitation import steps

SENSOR = Sensor(0.003, 0.05)
ROD = Model(RodPendulum(m=1.0, l=0.9), dt=0.02)


def logs(model: Model, sensor: Sensor = SENSOR, n: int = 2) -> list[Record]:
    rng = np.random.default_rng(0)
    u = np.array([steps(rng, 250, model.dt, 1.5, 0.3) for _ in range(n)])
    return simulate(model, u, math.pi + rng.uniform(-0.8, 0.8, n), np.zeros(n)).measure(sensor, rng)


@pytest.fixture(scope="module")
def answer() -> Comparison:
    return compare(ROD, logs(ROD.with_effect(Viscous(b=0.1))), SENSOR)


def rendered(figure: Figure) -> bytes:
    """Drawn, which finds what only drawing finds: layouts that collapse, text that cannot be set."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=60)
    return file.getvalue()


def words(figure: Figure) -> str:
    return " ".join(t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text")))


@pytest.mark.filterwarnings("error")
def test_a_comparison_on_one_page(answer: Comparison) -> None:
    figure = answer.plot()
    assert len(rendered(figure)) > 20_000
    assert answer.sentence.split(":")[0] in words(figure)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("sensor", [Sensor(0.003), Sensor(None, 0.05)], ids=["angle", "speed"])
def test_a_comparison_of_one_channel_of_a_perfect_model(sensor: Sensor) -> None:
    rendered(compare(ROD, logs(ROD, sensor, n=1), sensor).plot())


@pytest.mark.filterwarnings("error")
def test_each_figure_alone_has_units(answer: Comparison) -> None:
    figures = plotting.comparison_figures(answer)
    assert set(figures) == {
        "errors", "map", "past torque", "whiteness", "worst windows",
        "over theta", "over theta_dot", "over torque", "over time",
    }  # fmt: skip
    for figure in figures.values():
        rendered(figure)
    for name, unit in {"errors": "rad/s", "map": "[N m]", "over theta": "[rad]", "over theta_dot": "[rad/s]"}.items():
        assert unit in words(figures[name]), name


def test_the_curve_that_is_drawn_is_the_answer(answer: Comparison) -> None:
    figure = plotting.alone(lambda axes: plotting.curve(answer.curves["theta"], axes))
    drawn = [line.get_ydata() for line in figure.axes[0].lines]
    assert any(
        len(y) == len(answer.curves["theta"].at) and np.allclose(y, answer.curves["theta"].torque) for y in drawn
    )


def diagnosis(*errors: float) -> SimpleNamespace:
    """What `fall` and `ranking` read of a diagnosis."""
    names = ("coulomb", "delay", "ripple")
    found = [SimpleNamespace(effect=n, error_after=e) for n, e in zip(names, errors[1:], strict=False)]
    ranked = [
        SimpleNamespace(effect=n, score=s, p_value=p, error_after=e)
        for n, s, p, e in (("coulomb", 900.0, 1e-9, 2.0), ("viscous", 700.0, 1e-7, 3.1), ("tilt", 2.0, 0.6, None))
    ]
    return SimpleNamespace(
        base_error=SimpleNamespace(ratio=errors[0]), conventions=(), steps=tuple(found), ranking=tuple(ranked)
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("errors", [(7.2, 3.0, 1.01), (1.0,), (70.0, 1.1)])
def test_the_error_falls_to_the_noise(errors: tuple[float, ...]) -> None:
    figure = plotting.alone(lambda axes: plotting.fall(diagnosis(*errors), axes))
    rendered(figure)
    axes = figure.axes[0]
    assert [bar.get_height() + bar.get_y() for bar in axes.patches] == pytest.approx(list(errors))
    assert axes.get_yscale() == "log"
    assert any(np.allclose(line.get_ydata(), 1.0) for line in axes.lines)


@pytest.mark.filterwarnings("error")
def test_the_ranking_is_drawn_best_first() -> None:
    figure = plotting.alone(lambda axes: plotting.ranking(diagnosis(7.2, 1.0), axes))
    rendered(figure)
    axes = figure.axes[0]
    assert [t.get_text() for t in axes.get_yticklabels()] == ["tilt", "viscous", "coulomb"]
    assert [bar.get_width() for bar in axes.patches] == [2.0, 700.0, 900.0]


@pytest.mark.filterwarnings("error")
def test_residual_torque_and_trajectories() -> None:
    records = logs(ROD.with_effect(Coulomb(tau_c=0.15)))
    figure = plotting.residual_torque(residual_torque(ROD, records, SENSOR))
    rendered(figure)
    assert "[N m]" in words(figure) and "[rad/s]" in words(figure)
    figure = plotting.trajectories(ROD, ROD.with_effect(Coulomb(tau_c=0.15)), records[0], SENSOR)
    rendered(figure)
    readings, before, after = (line.get_ydata() for line in figure.axes[0].lines[:3])
    assert np.std(readings - after) < 1.3 * SENSOR.theta < 0.1 * np.std(readings - before)
