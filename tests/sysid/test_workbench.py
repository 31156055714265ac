"""The workbench: what its clicks do, and what its pictures keep."""

from __future__ import annotations

import importlib.util
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dash", reason="the workbench needs the extra web")

from sysid.data.record import write_csv
from sysid.errors import InvalidInput
from sysid.estimation.saved_model import load
from sysid.web import figures, samples
from sysid.web.bench import Workbench
from sysid.web.callbacks import effect_picture, region_of, zoomed
from sysid.web.jobs import Jobs, finished
from sysid.web.own_effect import OwnEffect
from sysid.web.script import script
from sysid.web.session import Answer, Node, Session, Sessions
from tests.sysid.workbench import uploaded, waited


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Workbench, Session]]:
    """A short log of a sticky joint, fitted, and dry friction added."""
    folder = tmp_path_factory.mktemp("walked")
    files = [folder / f"swing{k}.csv" for k in range(4)]
    for record, file in zip(samples.sample("friction"), files, strict=False):
        write_csv(record.head(200), file)
    bench = Workbench(Sessions(folder / "sessions"), Jobs())
    session = uploaded(bench, *files)
    bench.fit(session)
    assert waited(bench, session) == ""
    assert session.read(0, Answer.EFFECTS)["next"] == ["coulomb"]
    bench.add(session, "coulomb")
    assert waited(bench, session) == ""
    yield bench, session
    bench.end()


# ---- the loop --------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_the_error_falls_to_the_noise_by_the_effect_that_was_hidden(walked: tuple[Workbench, Session]) -> None:
    _, session = walked
    before, after = (session.read(k, Answer.FAILS)["ratio"] for k in (0, 1))
    assert before > 2.0
    assert after < 1.1
    estimate = load(session.of(1) / Answer.MODEL).estimate
    assert abs(estimate.values["coulomb.tau_c"] - 0.15) < 4.0 * estimate.sd["coulomb.tau_c"] + 1e-3
    diagnosis = session.read(1, Answer.EFFECTS)
    assert diagnosis["verdict"] == "adequate"
    assert not diagnosis["next"]
    assert diagnosis["ruled_out"]


@pytest.mark.long
def test_a_row_says_how_large_an_effect_is_and_what_it_explains(walked: tuple[Workbench, Session]) -> None:
    _, session = walked
    row = session.read(0, Answer.EFFECTS)["rows"][0]
    assert row["effect"] == "coulomb"
    assert row["explained"] > 0.9
    assert row["error"] < 1.1
    assert row["torque"]["over"] == "theta_dot"
    x, y = (np.array(row["torque"][k]) for k in ("x", "mean"))
    assert np.allclose(np.abs(y[np.abs(x) > 1.0]), 0.15, atol=0.02)
    session.change(at=0)
    assert len(effect_picture(session, "coulomb").data) == 4


@pytest.mark.long
def test_undo_leads_back_and_what_was_tried_is_kept(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=1)
    bench.do(session, {"do": "undo"}, {})
    assert session.state.at == 0
    bench.do(session, {"do": "add", "effect": "coulomb"}, {})
    assert session.state.at == 1
    assert len(session.state.nodes) == 2
    assert session.state.added(1) == ("coulomb",)


@pytest.mark.long
def test_a_refit_that_fails_leaves_the_page_as_it_was_with_one_sentence(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=1)
    before = bench.stamps(session)["fails"]
    bench.add(session, "no such effect")
    assert "unknown effect" in waited(bench, session)
    assert bench.stamps(session)["fails"] == before
    assert len(session.state.nodes) == 2


@pytest.mark.long
def test_a_cancelled_refit_is_taken_back(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=0)
    bench.add(session, "viscous")
    assert bench.jobs.running(session) == 2
    bench.do(session, {"do": "cancel"}, {})
    assert bench.jobs.running(session) is None
    assert len(session.state.nodes) == 2
    assert session.state.at == 0


@pytest.mark.long
def test_an_addition_that_is_cancelled_before_its_effects_are_known_is_taken_back(
    walked: tuple[Workbench, Session],
) -> None:
    bench, session = walked
    session.change(at=0)
    bench.add(session, "viscous")
    while not session.has(2, Answer.MODEL):
        assert bench.jobs.running(session) == 2
        time.sleep(0.02)
    bench.do(session, {"do": "cancel"}, {})
    assert len(session.state.nodes) == 2
    assert session.state.at == 0
    assert bench.part("effects", session).className == ""


@pytest.mark.long
def test_a_session_survives_a_restart(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    again = Workbench(Sessions(bench.sessions.folder), Jobs())
    restored = again.sessions.find(session.identifier)
    assert restored.state == session.state
    assert finished(restored, 1)
    assert again.stamps(restored) == bench.stamps(session)


@pytest.mark.long
def test_two_threads_that_change_a_session_keep_both_changes(tmp_path: Path) -> None:
    session = Sessions(tmp_path).new("a rig")

    def retitle() -> None:
        for k in range(40):
            session.change(title=f"rig {k}")

    other = Thread(target=retitle)
    other.start()
    numbers = [session.add_node(Node()) for _ in range(40)]
    other.join()
    assert numbers == list(range(40)) and len(session.state.nodes) == 40 and session.state.title == "rig 39"


def test_a_selection_marks_the_same_samples_in_all_plots(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=0)
    region = region_of("over", {"range": {"x": [1.0, 2.0], "y": [-9.0, 9.0]}}, "theta_dot")
    course, states, over = (
        p.to_plotly_json()["operations"] for p in bench.marked(session, region, "theta", "theta_dot")
    )
    speeds = np.array(over[0]["params"]["value"])
    assert len(speeds) > 10
    assert np.all((speeds >= 1.0) & (speeds <= 2.0))
    assert np.array_equal(np.array(states[1]["params"]["value"]), speeds)
    s = figures.series(session.of(0) / Answer.SERIES)
    assert np.array_equal(np.array(course[0]["params"]["value"]), s["t"][figures.within(s, region)])


# ---- pictures --------------------------------------------------------------------------------------------------------


def test_thinning_keeps_every_peak_and_the_order_of_time() -> None:
    rng = np.random.default_rng(0)
    t, y = np.arange(100_000.0), rng.standard_normal(100_000)
    y[54_321] = 40.0
    y[777] = -40.0
    x, z = figures.thinned(t, y)
    assert len(x) <= figures.MOST_POINTS
    assert np.all(np.diff(x) >= 0.0)
    assert z.max() == 40.0
    assert z.min() == -40.0
    x, z = figures.thinned(t, y, begin=54_000.0, end=54_400.0)
    assert len(x) == 402
    assert z.max() == 40.0


def test_thinning_leaves_out_no_gap() -> None:
    t = np.arange(20_000.0)
    y = np.where((t > 5_000.0) & (t < 9_000.0), np.nan, t)
    x, z = figures.thinned(t, y)
    assert np.all(np.isnan(z[(x > 5_000.0) & (x < 9_000.0)]))
    assert np.nanmax(z) == 19_999.0


def test_a_zoom_that_moves_no_time_changes_nothing(tmp_path: Path) -> None:
    columns = ("t", "theta_read", "theta_predicted", "residual_torque", "residual_torque_sd")
    series = {k: np.arange(9.0) for k in columns}
    np.savez(tmp_path / "s.npz", **series)
    s = figures.series(tmp_path / "s.npz")
    assert zoomed(s, "theta", {"yaxis.range[0]": 0.0}) is None
    assert zoomed(s, "theta", {"xaxis.range[0]": 2.0, "xaxis.range[1]": 4.0}) is not None


@pytest.mark.long
def test_an_effect_that_the_user_writes_is_fitted_like_ours(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=0)
    with pytest.raises(InvalidInput, match="not understood"):
        bench.try_own(session, OwnEffect("mine", "__import__('os').system('x')"))
    with pytest.raises(InvalidInput, match="in the catalogue"):
        bench.try_own(session, OwnEffect("coulomb", "-a * theta_dot"))
    assert session.state.at == 0
    effect = OwnEffect("grip", "-a * tanh(theta_dot / v)", "v = 0.05, 0.2")
    bench.try_own(session, effect)
    assert waited(bench, session) == ""
    node = session.state.at
    assert session.state.added(node) == ("grip",)
    assert session.read(node, Answer.FAILS)["ratio"] < 1.3
    sizes = {p["name"]: p["said"] for p in session.read(node, Answer.FAILS)["parameters"]}
    assert abs(float(sizes["grip.a"].partition(" ")[0]) - 0.15) < 0.02
    with pytest.raises(InvalidInput, match="another name"):
        bench.try_own(session, OwnEffect("grip", "-a * theta_dot"))
    lines = script(session.state, session.read(0, Answer.BEGUN), 2, [effect.source()])
    compile(lines, "lines", "exec")
    assert "own_effects.py" in str(bench.part("take", session))
    if importlib.util.find_spec("policies") is not None:
        bench.trainings.begin(session, 2, 2.0, "--steps", "2000", "--no-references")
        waited(bench, session)
        assert "this policy" in (session.of(2) / Answer.TRAINING).read_text()
    session.drop_last_node()


def test_settings_that_read_no_log_leave_the_history(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    before, log = session.state.nodes, session.state.log
    session.change(log=replace(log, begin=1e6))
    bench.fit(session)
    assert session.state.nodes == before
    session.change(log=log)


@pytest.mark.long
def test_beginning_anew_can_be_undone(walked: tuple[Workbench, Session]) -> None:
    """The models of the older settings stay, and so do these settings: form, fits and lines go by them again."""
    bench, session = walked
    session.change(at=1)
    before = session.state
    session.change(log=replace(before.log, end=3.0))
    bench.fit(session)
    assert session.state.at == 2
    assert session.state.settings_of(1).log == before.log
    assert session.state.settings_of(2).log.end == 3.0
    assert "end=" not in script(session.state, session.read(0, Answer.BEGUN), 1)
    assert "before" in str(bench.part("fails", session))
    bench.do(session, {"do": "undo"}, {})
    assert session.state == before
    assert waited(bench, session) == ""
    session.change(log=replace(before.log, end=3.0))
    bench.fit(session)
    assert waited(bench, session) == ""
    bench.do(session, {"do": "go", "node": 1}, {})
    assert session.state.log == before.log
    assert "as it came (end 3.0)" in str(bench.part("ladder", session))
    bench.do(session, {"do": "go", "node": 2}, {})
    assert session.state.log.end == 3.0
    bench.do(session, {"do": "undo"}, {})
    assert session.state.at == 1
    session.drop_last_node()


@pytest.mark.long
def test_the_model_before_stays_on_the_page_until_the_new_one_is_known(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=0)
    bench.add(session, "viscous")
    for name in ("fails", "effects"):
        assert bench.part(name, session).className == "before"
    assert session.shown(Answer.FAILS) == 0
    assert "'add'" not in str([b for b in buttons(bench.part("effects", session)) if not b.disabled])
    bench.do(session, {"do": "cancel"}, {})
    assert bench.part("fails", session).className == ""
    assert "'add'" in str([b for b in buttons(bench.part("effects", session)) if not b.disabled])


def buttons(part: Any) -> list[Any]:
    return [component for component in part._traverse() if type(component).__name__ == "Button"]


@pytest.mark.long
def test_answers_of_another_version_are_worked_out_anew(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=1)
    path = session.of(1) / Answer.FAILS
    kept = json.loads(path.read_text())
    path.write_text(json.dumps({"ratio": 1.0}))
    assert session.read(1, Answer.FAILS) is None
    assert "sensor noise" in str(bench.part("fails", session))
    bench.resume(session)
    assert waited(bench, session) == ""
    again = session.read(1, Answer.FAILS)
    assert (again["ratio"], again["rollouts"]) == (kept["ratio"], kept["rollouts"])


@pytest.mark.long
def test_the_lines_repeat_every_click(walked: tuple[Workbench, Session], tmp_path: Path) -> None:
    _, session = walked
    begun = session.read(0, Answer.BEGUN)
    lines = script(session.state, begun, 1).replace("model.json", str(tmp_path / "again.json"))
    exec(compile(lines, "lines", "exec"), {})
    here, again = load(session.of(1) / Answer.MODEL).estimate, load(tmp_path / "again.json").estimate
    assert here.values == again.values


@pytest.mark.long
def test_the_report_is_that_of_the_model_that_is_looked_at(walked: tuple[Workbench, Session]) -> None:
    _, session = walked
    before, after = ((session.of(k) / Answer.REPORT).read_text() for k in (0, 1))
    assert f"{session.read(0, Answer.FAILS)['ratio']:.2f}" in before
    assert "lacks nothing that matters" in after
    assert "coulomb.tau_c" in after


@pytest.mark.long
def test_the_next_experiment_is_planned_and_written(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=1)
    bench.do(session, {"do": "plan"}, {})
    assert waited(bench, session) == ""
    assert session.read(1, Answer.PLANNED)["sentence"]
    assert (session.of(1) / Answer.NEXT).read_text().startswith("rollout,t,torque")


@pytest.mark.long
def test_a_policy_is_trained_and_its_curve_is_heard(walked: tuple[Workbench, Session]) -> None:
    pytest.importorskip("policies")
    bench, session = walked
    with pytest.raises(InvalidInput, match="above 0"):
        bench.trainings.begin(session, 0, 0.0)
    bench.trainings.begin(session, 0, 2.0, "--steps", "2000")
    assert bench.busy(session)
    waited(bench, session)
    session.change(at=0)
    said = str(bench.part("train", session))
    assert "this policy" in said and "optimum" in said
    bench.trainings.end(session)
    assert not bench.busy(session)
