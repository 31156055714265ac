"""The workbench: what its clicks do, what its pictures keep, and who may ask."""

from __future__ import annotations

import base64
import dataclasses
import importlib.util
import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dash", reason="the workbench needs the extra web")

import sysid
from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.data.record import write_csv
from sysid.errors import InvalidInput
from sysid.estimation.saved_model import load
from sysid.web import figures, log_part, samples
from sysid.web.bench import Workbench
from sysid.web.callbacks import do, effect_picture, region_of, session_name, zoomed
from sysid.web.jobs import Jobs, finished
from sysid.web.own_effect import OwnEffect
from sysid.web.script import script
from sysid.web.session import Answer, Session, Sessions
from sysid.web.training import OPTIMUM, OWN, heard
from tests.sysid import hostile_logs, robot_files


def waited(bench: Workbench, session: Session, seconds: float = 120.0) -> str:
    """Wait for the work under way; returns what went wrong."""
    end = time.monotonic() + seconds
    while bench.jobs.running(session) is not None and time.monotonic() < end:
        time.sleep(0.1)
    return bench.jobs.message(session)


def uploaded(bench: Workbench, *files: Path) -> Session:
    """A session of files that were dropped."""
    contents = [f"data:text/csv;base64,{base64.b64encode(f.read_bytes()).decode()}" for f in files]
    return bench.upload([f.name for f in files], contents)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Workbench]:
    made = Workbench(Sessions(tmp_path / "sessions"), Jobs(), most=1 << 20)
    yield made
    made.end()


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
    assert estimate is not None
    assert abs(estimate.values["coulomb.tau_c"] - 0.15) < 4.0 * estimate.sd["coulomb.tau_c"] + 1e-3
    found = session.read(1, Answer.EFFECTS)
    assert found["verdict"] == "adequate"
    assert not found["next"]
    assert found["ruled_out"]


@pytest.mark.long
def test_a_row_says_how_large_an_effect_is_and_what_it_explains(walked: tuple[Workbench, Session]) -> None:
    _, session = walked
    own = session.read(0, Answer.EFFECTS)["rows"][0]
    assert own["effect"] == "coulomb"
    assert own["explained"] > 0.9
    assert own["error"] < 1.1
    assert own["torque"]["over"] == "theta_dot"
    x, y = (np.array(own["torque"][k]) for k in ("x", "mean"))
    assert np.allclose(np.abs(y[np.abs(x) > 1.0]), 0.15, atol=0.02)
    session.change(at=0)
    assert len(effect_picture(session, "coulomb").data) == 4


@pytest.mark.long
def test_undo_leads_back_and_what_was_tried_is_kept(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=1)
    do(bench, session, {"do": "undo"})
    assert session.state.at == 0
    do(bench, session, {"do": "add", "effect": "coulomb"})
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
    bench.cancel(session)
    assert bench.jobs.running(session) is None
    assert len(session.state.nodes) == 2
    assert session.state.at == 0


@pytest.mark.long
def test_a_session_survives_a_restart(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    again = Workbench(Sessions(bench.sessions.folder), Jobs())
    found = again.sessions.find(session.identifier)
    assert found is not None
    assert found.state == session.state
    assert finished(found, 1)
    assert again.stamps(found) == bench.stamps(session)


@pytest.mark.long
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
    assert np.array_equal(np.array(course[0]["params"]["value"]), s["t"][s.within(region)])


# ---- pictures --------------------------------------------------------------------------------------------------------


def test_thinning_keeps_every_peak_and_the_order_of_time() -> None:
    rng = np.random.default_rng(0)
    t, y = np.arange(100_000.0), rng.standard_normal(100_000)
    y[54_321] = 40.0
    y[777] = -40.0
    x, z = figures.thinned(t, y)
    assert len(x) <= figures.MOST
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
    series = {k: np.arange(9.0) for k in ("t", "theta", "read_theta", "said_t", "said_theta", "d", "sd")}
    np.savez(tmp_path / "s.npz", **series)
    s = figures.Series(tmp_path / "s.npz")
    assert zoomed(s, "theta", {"yaxis.range[0]": 0.0}) is None
    assert zoomed(s, "theta", {"xaxis.range[0]": 2.0, "xaxis.range[1]": 4.0}) is not None


# ---- logs ------------------------------------------------------------------------------------------------------------


def test_columns_of_other_names_are_taken_for_what_they_look_like(bench: Workbench, tmp_path: Path) -> None:
    log = tmp_path / "rig.csv"
    t = np.arange(200) * 0.02
    rows = np.column_stack([t, 0.3 * np.sin(3.0 * t), 0.9 * np.cos(3.0 * t), 0.1 * np.ones_like(t)])
    np.savetxt(log, rows, delimiter=",", header="time_s,angle_rad,speed,effort", comments="")
    session = uploaded(bench, log)
    found = log_part.preview(session)
    assert found.about.error == ""
    assert session.state.log["columns"] == "t=time_s,theta=angle_rad,theta_dot=speed,torque=effort"


def test_a_column_without_numbers_is_not_taken(bench: Workbench, tmp_path: Path) -> None:
    text = "time_s,angle,torque_cmd,torque_meas\n" + "".join(
        f"{0.02 * k},{3.0 + 0.1 * k},,{k % 3}\n" for k in range(60)
    )
    (tmp_path / "log.csv").write_text(text)
    session = uploaded(bench, tmp_path / "log.csv")
    assert log_part.columns(session)[1]["torque"] == "torque_meas"
    assert not log_part.preview(session).about.error


def test_a_log_that_hangs_upside_down_is_drawn_so_and_doubted(bench: Workbench, tmp_path: Path) -> None:
    record = samples.sample("friction")[0]
    assert record.theta is not None
    write_csv(replace(record, theta=record.theta - np.pi), tmp_path / "turned.csv")
    session = uploaded(bench, tmp_path / "turned.csv")
    found = log_part.preview(session)
    assert not found.about.error
    assert log_part.arm(found, 0.0)[1][1] > 0.5
    assert any("hanging" in note for note in found.about.notes)
    values = {c: c for c in ("t", "theta", "theta_dot")} | {"torque": "u", "zero": "hanging", "plant": "rod"}
    session.save(log_part.changed(session.state, values | {"signs": []}, log_part.columns(session)[1]))
    found = log_part.preview(session)
    assert not found.about.error
    assert log_part.arm(found, 0.0)[1][1] < -0.5
    assert not any("hanging" in note for note in found.about.notes)


def test_a_preview_is_read_once(bench: Workbench, tmp_path: Path) -> None:
    write_csv(samples.sample("friction")[0], tmp_path / "swing.csv")
    session = uploaded(bench, tmp_path / "swing.csv")
    first = log_part.preview(session)
    log_part._previewed.cache_clear()
    again = log_part.preview(session)
    assert again.about == first.about
    assert np.array_equal(again.theta, first.theta, equal_nan=True)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("pickled.npz", hostile_logs.pickled),
        ("bomb.npz", hostile_logs.bomb),
        ("lying.db3", hostile_logs.lying_bag),
        ("cut.npz", lambda f: f.write_bytes(b"PK\x03\x04" + bytes(100))),
        ("claims.csv", lambda f: f.write_text("t,theta\n0,1e308\n1,-1e308\n2,nan\n")),
        ("empty.csv", lambda f: f.write_bytes(b"")),
        ("binary.csv", lambda f: f.write_bytes(bytes(range(256)) * 9)),
        ("wrong.mat", lambda f: f.write_bytes(b"MATLAB 5.0" + bytes(300))),
    ],
)
def test_a_hostile_log_harms_nothing(bench: Workbench, tmp_path: Path, name: str, write: Any) -> None:
    write(tmp_path / name)
    session = uploaded(bench, tmp_path / name)
    shown = str(bench.part("log", session)) + str(log_part.previewed(log_part.preview(session)))
    assert "error" in shown


def test_what_is_no_log_is_one_sentence(bench: Workbench, tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t,theta\n0,=cmd()\n1,<script>alert(1)</script>\n")
    found = log_part.preview(uploaded(bench, tmp_path / "x.csv"))
    assert "expected a number" in found.about.error


# ---- safety ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("title", ["../../etc/passwd.csv", "/tmp/x.csv", "a\0b.csv", "..csv", "con:<b>.csv"])
def test_the_name_of_a_file_never_becomes_a_path(bench: Workbench, title: str) -> None:
    session = bench.upload([title], ["data:,dCx0aGV0YQo="])
    written = [p for p in bench.sessions.folder.parent.rglob("*") if p.is_file()]
    assert sorted(p.name for p in written) == ["log1.csv", "session.json"]
    assert all(session.folder in p.parents for p in written)


def test_an_upload_has_a_limit(bench: Workbench) -> None:
    with pytest.raises(InvalidInput, match="more than 1 MB"):
        bench.upload(["x.csv"], ["data:," + "A" * (3 << 20)])
    with pytest.raises(InvalidInput, match="ends in"):
        bench.upload(["x.pkl"], ["data:,AAAA"])
    with pytest.raises(InvalidInput, match="no file"):
        bench.upload(["x.csv"], ["data:,???"])
    assert not bench.sessions.all()


@pytest.mark.parametrize("name", ["..", "../x", "0123456", "0123456g", "", None, "0123456789", "%2e%2e"])
def test_no_other_name_is_a_session(bench: Workbench, name: str | None) -> None:
    assert bench.sessions.find(name) is None


def test_an_address_names_a_session() -> None:
    assert session_name("?session=0123abcd&token=x") == "0123abcd"
    assert session_name(None) is None


def test_a_session_that_another_wrote_is_refused(bench: Workbench) -> None:
    session = bench.sessions.new("x")
    (session.folder / "session.json").write_text(json.dumps({"__reduce__": 1}))
    with pytest.raises(InvalidInput, match="no session of this version"):
        _ = session.state


def test_a_session_of_an_older_version_is_completed_by_defaults(bench: Workbench, tmp_path: Path) -> None:
    write_csv(samples.sample("friction")[0], tmp_path / "swing.csv")
    session = bench.open(LogOptions(files=(tmp_path / "swing.csv",)), ModelOptions())
    path = session.folder / "session.json"
    older = {
        "title": "old",
        "log": json.loads(path.read_text())["log"],
        "nodes": [{"parent": None, "added": ""}],
        "at": 0,
    }
    path.write_text(json.dumps(older))
    assert session.state.titles == ("swing.csv",)
    assert session.state.settings_of(0).log == session.state.log
    for own in (session, bench.sessions.new("of no file")):
        for name in bench.stamps(own):
            bench.part(name, own)
        log_part.previewed(log_part.preview(own))


@pytest.mark.parametrize(
    "change",
    [{"new": 1}, {"log": {"unheard_of": 1}}, {"at": 3}, {"nodes": [{"unheard_of": 1}]}, {"titles": 5}, {"log": []}],
)
def test_a_session_that_is_not_understood_is_refused_in_one_sentence(bench: Workbench, change: dict[str, Any]) -> None:
    session = bench.sessions.new("x")
    path = session.folder / "session.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    assert bench.sessions.find(session.identifier) is None
    assert "no session of this version" in bench.sessions.refusal(session.identifier)
    assert bench.sessions.all() == ()
    assert "no such session" in bench.sessions.refusal("0" * 8)


def test_a_session_is_renamed_and_deleted(bench: Workbench, tmp_path: Path) -> None:
    write_csv(samples.sample("friction")[0], tmp_path / "swing.csv")
    session, other = (
        bench.open(LogOptions(files=(tmp_path / "swing.csv",)), ModelOptions()),
        bench.sessions.new("other"),
    )
    assert do(bench, session, {"do": "rename"}, {"title": " the rig "}) == session
    assert session.state.title == "the rig"
    with pytest.raises(InvalidInput, match="empty"):
        do(bench, session, {"do": "rename"}, {"title": " "})
    assert do(bench, session, {"do": "delete", "session": other.identifier}) == session
    assert bench.sessions.all() == (session,)
    assert do(bench, session, {"do": "delete", "session": session.identifier}) is None
    assert not session.folder.exists()
    assert (tmp_path / "swing.csv").is_file()


def test_a_message_calls_a_dropped_file_by_the_name_of_the_user(bench: Workbench, tmp_path: Path) -> None:
    for name in ("one <b>.csv", "two.csv"):
        (tmp_path / name).write_text("t,theta\n0,x\n1,y\n")
    session = uploaded(bench, tmp_path / "two.csv", tmp_path / "one <b>.csv")
    assert log_part.preview(session).about.error.startswith("two.csv, line 2")
    assert (
        session.with_titles("log2.csv and log2, not log3 or catalog1")
        == "one <b>.csv and one <b>, not log3 or catalog1"
    )


def test_what_is_held_out_and_the_sample_interval_are_chosen(bench: Workbench, tmp_path: Path) -> None:
    write_csv(samples.sample("friction")[0], tmp_path / "swing.csv")
    session = uploaded(bench, tmp_path / "swing.csv")
    form = {"t": "t", "theta": "theta", "theta_dot": "theta_dot", "torque": "u", "plant": "rod", "input": "torque",
            "zero": "upright", "signs": ["degrees"], "begin": 0.0}  # fmt: skip
    log_part.change(session, {**form, "hold_out": 0.4, "dt": 0.04})
    options = session.state.log_options
    assert (options.hold_out, options.dt, options.begin, options.degrees) == (0.4, 0.04, 0.0, True)
    assert options.input is options.zero is None
    assert "25 Hz" in log_part.preview(session).about.said
    log_part.change(session, {**form, "hold_out": -1.0})
    assert "hold" in log_part.preview(session).about.error
    log_part.change(session, form)
    assert session.state.log_options.hold_out is None


def test_the_joint_of_a_bag_can_be_chosen_where_it_has_several(bench: Workbench, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    t = 0.02 * np.arange(200)
    moved = {"t": t, "theta": np.pi + 0.3 * np.sin(3.0 * t), "theta_dot": 0.9 * np.cos(3.0 * t), "torque": np.sin(t)}
    folder = robot_files.write_bag(tmp_path / "robot", moved, "MCAP", ("shoulder", "elbow"))
    session = uploaded(bench, next(folder.glob("*.mcap")))
    assert "elbow" in log_part.preview(session).about.error
    assert "set-joint" in str(bench.part("log", session))
    log_part.change(session, {"joint": "shoulder", "signs": []})
    assert not log_part.preview(session).about.error
    assert set(log_part.columns(session)[1]) >= {"t", "theta"}


@pytest.mark.long
def test_reports_are_written_without_scripts(walked: tuple[Workbench, Session]) -> None:
    _, session = walked
    assert "<script" not in (session.of(0) / Answer.REPORT).read_text()


@pytest.mark.long
def test_an_effect_that_the_user_writes_is_fitted_like_ours(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=0)
    with pytest.raises(InvalidInput, match="not understood"):
        bench.try_own(session, OwnEffect("mine", "__import__('os').system('x')"))
    with pytest.raises(InvalidInput, match="in the catalogue"):
        bench.try_own(session, OwnEffect("coulomb", "-a * theta_dot"))
    assert session.state.at == 0
    own = OwnEffect("grip", "-a * tanh(theta_dot / v)", "v = 0.05, 0.2")
    bench.try_own(session, own)
    assert waited(bench, session) == ""
    node = session.state.at
    assert session.state.added(node) == ("grip",)
    assert session.read(node, Answer.FAILS)["ratio"] < 1.3
    sizes = {p["name"]: p["said"] for p in session.read(node, Answer.FAILS)["parameters"]}
    assert abs(float(sizes["grip.a"].partition(" ")[0]) - 0.15) < 0.02
    with pytest.raises(InvalidInput, match="another name"):
        bench.try_own(session, OwnEffect("grip", "-a * theta_dot"))
    lines = script(session.state, session.read(0, Answer.BEGUN), 2, [own.source()])
    compile(lines, "lines", "exec")
    assert "own_effects.py" in str(bench.part("take", session))
    if importlib.util.find_spec("policies") is not None:
        bench.trainings.begin(session, 2, 2.0, steps=2_000)
        end = time.monotonic() + 240.0
        while time.monotonic() < end and bench.busy(session):
            time.sleep(0.5)
        said = heard(session, 2)
        assert said is not None
        assert said["returns"][OWN] < 0.0
    session.drop_last_node()


def test_the_lines_of_an_own_effect_have_the_bounds_that_the_page_fits_in() -> None:
    own = OwnEffect("hum", "a * sin(w * t) + b * cos(w * t)", "w = 0.6, 3.1, 6.3")
    known: dict[str, Any] = {"sysid": sysid, "dataclasses": dataclasses}
    lines = own.source().replace("@sysid.register\n", "")
    exec(compile(lines, "lines", "exec"), known)
    here, again = own.checked()().parameters, known["Hum"]().parameters
    assert {n: (p.bounds, p.value) for n, p in here.items()} == {n: (p.bounds, p.value) for n, p in again.items()}


def test_a_name_that_is_no_variable_is_told_with_those_that_are() -> None:
    with pytest.raises(InvalidInput, match="expected one of the variables theta, theta_dot"):
        OwnEffect("typo", "-b * theta_dott", "").checked()


def test_settings_that_read_no_log_leave_the_history(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    before, log = session.state.nodes, session.state.log
    session.change(log={**log, "begin": 1e6})
    bench.fit(session)
    assert session.state.nodes == before
    session.change(log=log)


@pytest.mark.long
def test_beginning_anew_can_be_undone(walked: tuple[Workbench, Session]) -> None:
    """The models of the older settings stay, and so do these settings: form, fits and lines go by them again."""
    bench, session = walked
    session.change(at=1)
    before = session.state
    session.change(log={**before.log, "end": 3.0})
    bench.fit(session)
    assert session.state.at == 2
    assert session.state.settings_of(1).log == before.log
    assert session.state.settings_of(2).log["end"] == 3.0
    assert "end=" not in script(session.state, session.read(0, Answer.BEGUN), 1)
    assert "before" in str(bench.part("fails", session))
    do(bench, session, {"do": "undo"})
    assert session.state == before
    assert waited(bench, session) == ""
    session.change(log={**before.log, "end": 3.0})
    bench.fit(session)
    assert waited(bench, session) == ""
    do(bench, session, {"do": "go", "node": 1})
    assert session.state.log == before.log
    assert "as it came (end 3.0)" in str(bench.part("ladder", session))
    do(bench, session, {"do": "go", "node": 2})
    assert session.state.log["end"] == 3.0
    do(bench, session, {"do": "undo"})
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
    bench.cancel(session)
    assert bench.part("fails", session).className == ""
    assert "'add'" in str([b for b in buttons(bench.part("effects", session)) if not b.disabled])


def buttons(part: Any) -> list[Any]:
    return [own for own in part._traverse() if type(own).__name__ == "Button"]


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
def test_files_are_called_as_they_were_when_they_came(walked: tuple[Workbench, Session]) -> None:
    _, session = walked
    assert [r["name"] for r in session.read(0, Answer.FAILS)["rollouts"]] == [f"swing{k}" for k in range(4)]
    answers = (Answer.FAILS, Answer.EFFECTS, Answer.REPORT)
    assert not [name for name in answers if "log1" in (session.of(0) / name).read_text()]
    assert "log/log1.csv" in script(session.state, session.read(0, Answer.BEGUN), 0)


@pytest.mark.long
def test_the_lines_repeat_every_click(walked: tuple[Workbench, Session], tmp_path: Path) -> None:
    _, session = walked
    begun = session.read(0, Answer.BEGUN)
    lines = script(session.state, begun, 1).replace("model.json", str(tmp_path / "again.json"))
    exec(compile(lines, "lines", "exec"), {})
    here, again = load(session.of(1) / Answer.MODEL).estimate, load(tmp_path / "again.json").estimate
    assert here is not None
    assert again is not None
    assert here.values == again.values


@pytest.mark.long
def test_the_report_tells_the_way_that_was_gone(walked: tuple[Workbench, Session]) -> None:
    _, session = walked
    text = (session.of(1) / Answer.REPORT).read_text()
    assert "missing" in text
    assert "coulomb" in text
    before = session.read(0, Answer.FAILS)["ratio"]
    assert f"{before:.2f}" in text


@pytest.mark.long
def test_the_next_experiment_is_planned_and_written(walked: tuple[Workbench, Session]) -> None:
    bench, session = walked
    session.change(at=1)
    bench.plan(session)
    assert waited(bench, session) == ""
    assert session.read(1, Answer.PLANNED)["sentence"]
    assert (session.of(1) / Answer.NEXT).read_text().startswith("rollout,t,torque")


@pytest.mark.long
def test_a_policy_is_trained_and_its_curve_is_heard(walked: tuple[Workbench, Session]) -> None:
    pytest.importorskip("policies")
    bench, session = walked
    with pytest.raises(InvalidInput, match="above 0"):
        bench.trainings.begin(session, 0, 0.0)
    bench.trainings.begin(session, 0, 2.0, steps=2_000)
    assert bench.busy(session)
    end = time.monotonic() + 240.0
    while time.monotonic() < end and bench.busy(session):
        time.sleep(0.5)
    found = heard(session, 0)
    assert found is not None
    assert found["returns"][OPTIMUM] > found["returns"][OWN]
    session.change(at=0)
    assert "optimum" in str(bench.part("train", session))
    bench.trainings.cancel(session)
    assert not bench.busy(session)


def test_what_a_training_says_is_understood(tmp_path: Path) -> None:
    session = Session(tmp_path)
    session.of(0).mkdir(parents=True)
    (session.of(0) / "training.txt").write_text(
        "training 1 agent\n     step   return in training\n    5,000     -1204  ########   12 s, 2 min left\n"
        "  this policy                       -207.2  [-222.3, -192.2]\n"
        "  optimum (dynamic programming)     -149.2  [-160.6, -137.8]\n"
    )
    found = heard(session, 0)
    assert found is not None
    assert found["points"] == [(5000, -1204.0)]
    assert found["returns"] == {"this policy": -207.2, "optimum (dynamic programming)": -149.2}
