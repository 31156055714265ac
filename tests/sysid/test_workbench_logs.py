"""The workbench's logs and sessions: what is dropped, what is refused, and what is kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("dash", reason="the workbench needs the extra web")

from sysid.cli.command_options import LogOptions, ModelOptions
from sysid.data.record import write_csv
from sysid.errors import InvalidInput
from sysid.web import log_part, samples
from sysid.web.bench import Workbench
from sysid.web.callbacks import session_name
from tests.sysid import robot_files
from tests.sysid.workbench import uploaded


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rollout as a file in our own columns."""
    file = tmp_path_factory.mktemp("swing") / "swing.csv"
    write_csv(samples.sample("friction")[0], file)
    return file


def test_columns_of_other_names_are_taken_for_what_they_look_like(bench: Workbench, tmp_path: Path) -> None:
    log = tmp_path / "rig.csv"
    t = np.arange(200) * 0.02
    rows = np.column_stack([t, 0.3 * np.sin(3.0 * t), 0.9 * np.cos(3.0 * t), 0.1 * np.ones_like(t)])
    np.savetxt(log, rows, delimiter=",", header="time_s,angle_rad,speed,effort", comments="")
    session = uploaded(bench, log)
    preview = log_part.preview(session)
    assert preview.error == ""
    assert session.state.log.columns == "t=time_s,theta=angle_rad,theta_dot=speed,torque=effort"


def test_a_column_without_numbers_is_not_taken(bench: Workbench, tmp_path: Path) -> None:
    text = "time_s,angle,torque_cmd,torque_meas\n" + "".join(
        f"{0.02 * k},{3.0 + 0.1 * k},,{k % 3}\n" for k in range(60)
    )
    (tmp_path / "log.csv").write_text(text)
    session = uploaded(bench, tmp_path / "log.csv")
    assert log_part.columns(session)[1]["torque"] == "torque_meas"
    assert not log_part.preview(session).error


def test_a_log_that_hangs_upside_down_is_drawn_so_and_doubted(bench: Workbench, tmp_path: Path) -> None:
    record = samples.sample("friction")[0]
    write_csv(replace(record, theta=record.theta - np.pi), tmp_path / "turned.csv")
    session = uploaded(bench, tmp_path / "turned.csv")
    preview = log_part.preview(session)
    assert not preview.error
    assert log_part.arm(preview, 0.0)[1][1] > 0.5
    assert any("hanging" in note for note in preview.log.notes)
    values = {c: c for c in ("t", "theta", "theta_dot")} | {"torque": "u", "zero": "hanging", "plant": "rod"}
    log_part.change(session, values)
    preview = log_part.preview(session)
    assert not preview.error
    assert log_part.arm(preview, 0.0)[1][1] < -0.5
    assert not any("hanging" in note for note in preview.log.notes)


def test_a_preview_is_read_once(bench: Workbench, swing: Path) -> None:
    session = uploaded(bench, swing)
    first = log_part.preview(session)
    assert log_part.preview(session) is first
    session.change(log=replace(session.state.log, end=2.0))
    assert log_part.preview(session) is not first


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("cut.npz", lambda f: f.write_bytes(b"PK\x03\x04" + bytes(100))),
        ("claims.csv", lambda f: f.write_text("t,theta\n0,1e308\n1,-1e308\n2,nan\n")),
        ("code.csv", lambda f: f.write_text("t,theta\n0,=cmd()\n1,<script>alert(1)</script>\n")),
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


# ---- safety ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("title", ["../../etc/passwd.csv", "/tmp/x.csv", "a\0b.csv", "..csv", "con:<b>.csv"])
def test_the_name_of_a_file_never_becomes_a_path(bench: Workbench, title: str) -> None:
    session = bench.upload([title], ["data:,dCx0aGV0YQo="])
    written = [p for p in bench.sessions.folder.parent.rglob("*") if p.is_file()]
    assert {p.parent for p in written} == {session.folder, session.folder / "log" / "1"}
    assert len(written) == 2 and not any(set(p.name) & set("/<\0:") for p in written)


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


def test_a_session_keeps_what_the_command_line_said(bench: Workbench, swing: Path) -> None:
    log, start = (
        LogOptions((swing,), zero="hanging", end=3.0),
        ModelOptions(swing.with_name("model.json"), set=("l=1",)),
    )
    state = bench.open(log, start).state
    assert (state.log, state.start) == (log, start)


def test_a_session_of_an_older_version_is_completed_by_defaults(bench: Workbench, swing: Path) -> None:
    session = bench.open(LogOptions(files=(swing,)), ModelOptions())
    path = session.folder / "session.json"
    older = {
        "title": "old",
        "log": json.loads(path.read_text())["log"],
        "nodes": [{"parent": None, "added": ""}],
        "at": 0,
    }
    path.write_text(json.dumps(older))
    assert session.state.settings_of(0).log == session.state.log
    for opened in (session, bench.sessions.new("of no file")):
        for name in bench.stamps(opened):
            bench.part(name, opened)
        log_part.previewed(log_part.preview(opened))


@pytest.mark.parametrize(
    "change",
    [
        {"__reduce__": 1},
        {"log": {"unheard_of": 1}},
        {"at": 3},
        {"nodes": [{"unheard_of": 1}]},
        {"log": []},
    ],
)
def test_a_session_that_is_not_understood_is_refused_in_one_sentence(bench: Workbench, change: dict[str, Any]) -> None:
    session = bench.sessions.new("x")
    path = session.folder / "session.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    assert bench.sessions.find(session.identifier) is None
    assert "no session of this version" in bench.sessions.refusal(session.identifier)
    assert bench.sessions.all() == ()
    assert "no such session" in bench.sessions.refusal("0" * 8)


def test_a_session_is_renamed_and_deleted(bench: Workbench, swing: Path) -> None:
    session, other = bench.open(LogOptions(files=(swing,)), ModelOptions()), bench.sessions.new("other")
    assert bench.do(session, {"do": "rename"}, {"title": " the rig "}) == session
    assert session.state.title == "the rig"
    with pytest.raises(InvalidInput, match="empty"):
        bench.do(session, {"do": "rename"}, {"title": " "})
    assert bench.do(session, {"do": "delete", "session": other.identifier}, {}) == session
    assert bench.sessions.all() == (session,)
    assert bench.do(session, {"do": "delete", "session": session.identifier}, {}) is None
    assert not session.folder.exists()
    assert swing.is_file()


def test_a_message_calls_a_dropped_file_by_its_name(bench: Workbench, tmp_path: Path) -> None:
    (tmp_path / "größe <b>.csv").write_text("t,theta\n0,x\n1,y\n")
    assert log_part.preview(uploaded(bench, tmp_path / "größe <b>.csv")).error.startswith("größe _b_.csv, line 2")


def test_what_is_held_out_and_the_sample_interval_are_chosen(bench: Workbench, swing: Path) -> None:
    session = uploaded(bench, swing)
    form = {"t": "t", "theta": "theta", "theta_dot": "theta_dot", "torque": "u", "plant": "rod", "input": "torque",
            "zero": "upright", "signs": ["degrees"], "begin": 0.0}  # fmt: skip
    log_part.change(session, {**form, "hold_out": 0.4, "dt": 0.04})
    options = session.state.log
    assert (options.hold_out, options.dt, options.begin, options.degrees) == (0.4, 0.04, 0.0, True)
    assert options.input is options.zero is None
    assert "25 Hz" in str(log_part.preview(session).log)
    log_part.change(session, {**form, "hold_out": -1.0})
    assert "hold" in log_part.preview(session).error
    log_part.change(session, form)
    assert session.state.log.hold_out is None


@pytest.mark.parametrize("zero", [0.0, 2.157])
def test_a_zero_by_number_is_shown_and_kept(bench: Workbench, swing: Path, zero: float) -> None:
    session = bench.open(LogOptions(files=(swing,), zero=zero), ModelOptions())
    assert f"where it hangs at {zero:g}" in str(bench.part("log", session))
    log_part.change(session, {"t": "t", "theta": "theta", "plant": "rod", "input": "torque", "zero": zero})
    assert session.state.log.zero == zero


def test_the_joint_of_a_bag_can_be_chosen_where_it_has_several(bench: Workbench, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    t = 0.02 * np.arange(200)
    moved = {"t": t, "theta": np.pi + 0.3 * np.sin(3.0 * t), "theta_dot": 0.9 * np.cos(3.0 * t), "torque": np.sin(t)}
    folder = robot_files.write_bag(tmp_path / "robot", moved, "MCAP", ("shoulder", "elbow"))
    session = uploaded(bench, next(folder.glob("*.mcap")))
    assert "elbow" in log_part.preview(session).error
    assert "set-joint" in str(bench.part("log", session))
    log_part.change(session, {"joint": "shoulder", "signs": []})
    assert not log_part.preview(session).error
    assert set(log_part.columns(session)[1]) >= {"t", "theta"}
