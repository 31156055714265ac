"""The same log in any format is the same record, whatever its file is called."""

import datetime
import re

import numpy as np
import pytest

from sysid import InvalidInput, read
from sysid.__main__ import main
from tests.sysid.robot_files import (
    FORMS,
    records,
    write_bag,
    write_excel,
    write_json,
    write_mat,
    write_mat_73,
    write_parquet,
    write_text,
)
from tests.sysid.written import rollouts, same, table


@pytest.fixture(scope="module")
def columns():
    (record,) = rollouts()
    return table(record) | {"t": np.round(record.t, 9)}


@pytest.fixture(scope="module")
def plain(columns, tmp_path_factory):
    return read(write_text(tmp_path_factory.mktemp("plain") / "log.csv", columns))


def alike(log, plain, rtol=0.0):
    assert len(log) == len(plain) == 1 and log.dt == plain.dt and log[0].name == "log"
    same(log[0], plain[0], rtol)


# ---- what was written comes back ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["log", "log.csv", "log.bin"])
@pytest.mark.parametrize("form", FORMS)
def test_every_format_gives_the_same_record_to_the_bit(form, name, columns, plain, tmp_path):
    FORMS[form](tmp_path / name, columns)
    alike(read(tmp_path / name), plain, 1e-14 if form == "excel" else 0.0)  # its cells hold so many digits


@pytest.mark.parametrize("write", [write_mat, write_mat_73])
def test_the_columns_of_a_matrix_are_columns(write, columns, plain, tmp_path):
    write(tmp_path / "log", {"data": np.column_stack(list(columns.values()))})
    alike(read(tmp_path / "log", columns="t=data:1,theta=data:2,theta_dot=data:3,torque=data:4"), plain)


def test_fields_of_structs_in_structs_are_columns(columns, plain, tmp_path):
    signals = np.array([{"values": columns[n]} for n in ("theta", "theta_dot")], dtype=object)
    write_mat(tmp_path / "log", {"out": {"time": columns["t"], "signals": signals, "in": {"u": columns["torque"]}}})
    names = "t=time,theta=signals1.values,theta_dot=signals2.values,torque=in.u"
    alike(read(tmp_path / "log", columns=names), plain)


def test_fields_of_several_structs_go_by_the_names_of_both(columns, plain, tmp_path):
    scope, drive = {"time": columns["t"], "angle": columns["theta"]}, {"time": columns["t"], "u": columns["torque"]}
    write_mat(
        tmp_path / "log", {"scope": scope, "drive": drive, "rate": columns["theta_dot"], "gain": 2.0, "who": "me"}
    )
    with pytest.raises(InvalidInput, match=r"found scope.time, scope.angle, drive.time, drive.u, rate;"):
        read(tmp_path / "log")
    alike(read(tmp_path / "log", columns="t=scope.time,theta=scope.angle,theta_dot=rate,torque=drive.u"), plain)


def test_a_sheet_is_read_as_text_is(columns, plain, tmp_path):
    begin = datetime.datetime(2026, 3, 1, 12)
    dates = [begin + datetime.timedelta(milliseconds=round(1e3 * t)) for t in columns["t"]]
    about, units = [["Pendulum 3"], ["Rate", 50, "Hz"]], [["", "rad", "rad/s", "N m"]]
    write_excel(tmp_path / "log", columns | {"t": dates}, about, units)
    alike(read(tmp_path / "log"), plain, 1e-9)
    write_excel(tmp_path / "log", {"t": columns["t"], "theta": ["late"] * len(columns["t"])})
    with pytest.raises(InvalidInput, match="log, line 2: theta is 'late', expected a number"):
        read(tmp_path / "log")


def test_in_json_objects_in_records_and_lists_in_lists_are_columns(columns, plain, tmp_path):
    rows = [{"t": r["t"], "q": [r["theta"], r["theta_dot"]], "drive": {"tau": r["torque"]}} for r in records(columns)]
    write_json(tmp_path / "log", rows)
    alike(read(tmp_path / "log", columns="t=t,theta=q:1,theta_dot=q:2,torque=tau"), plain)
    write_json(tmp_path / "log", [list(row.values()) for row in records(columns)])
    alike(read(tmp_path / "log", columns="t=rows:1,theta=rows:2,theta_dot=rows:3,torque=rows:4"), plain)


def test_a_data_frame_gives_the_same_record(columns, plain):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(columns)
    for given in (frame, frame.set_index("t"), frame.astype("Float64"), frame.rename(columns={"torque": "u"})):
        log = read(given)
        assert log[0].name == "DataFrame"
        same(log[0], plain[0])
    assert [r.name for r in read(frame, [frame])] == ["DataFrame 1", "DataFrame 2"]


def test_time_stamps_are_seconds_since_the_first_row(columns, plain, tmp_path):
    pandas = pytest.importorskip("pandas")
    begin = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)
    stamps = pandas.DatetimeIndex([begin + datetime.timedelta(microseconds=round(1e6 * t)) for t in columns["t"]])
    frame = pandas.DataFrame(columns | {"t": stamps})
    same(read(frame)[0], plain[0])
    same(read(frame.assign(t=frame["t"] - frame["t"][0]))[0], plain[0])
    frame.to_parquet(tmp_path / "log")
    alike(read(tmp_path / "log"), plain)
    text = write_text(tmp_path / "text", columns).read_text().splitlines()
    dated = [f"{stamp.isoformat()},{line.partition(',')[2]}" for stamp, line in zip(stamps, text[1:], strict=True)]
    (tmp_path / "log").write_text("\n".join([text[0], *dated]))
    alike(read(tmp_path / "log"), plain)


def test_missing_numbers_are_missing_in_every_format(columns, tmp_path):
    pandas = pytest.importorskip("pandas")
    holes = columns | {"theta": columns["theta"].copy()}
    holes["theta"][[7, 30]] = np.nan
    expected = read(write_text(tmp_path / "log.csv", holes))
    assert any("2 rows without a reading" in note for note in expected.notes)
    null = pandas.DataFrame(holes).convert_dtypes()
    null.to_parquet(tmp_path / "log.parquet")
    for log in (read(null), read(tmp_path / "log.parquet")):
        same(log[0], expected[0])


# ---- joints ------------------------------------------------------------------------------------------------------


def test_a_joint_is_asked_for_by_its_name(columns, plain, tmp_path, capsys):
    path = write_bag(tmp_path / "log", columns, joints=("shoulder", "elbow"))
    alike(read(path, joint="shoulder"), plain)
    with pytest.raises(InvalidInput, match=re.escape("log has 2 joints: expected one of shoulder, elbow (--joint, ")):
        read(path)
    with pytest.raises(InvalidInput, match="log has no joint 'wrist': expected one of shoulder, elbow"):
        read(path, joint="wrist")
    assert main(["fit", str(path)]) == 2
    assert "expected one of shoulder, elbow" in capsys.readouterr().err
    (tmp_path / "log.toml").write_text('joint = "shoulder"\n')
    for more in (["--log", "none", "--joint", "shoulder"], []):
        assert main(["compare", str(path), "--set", "m=1", "--set", "l=1", *more]) == 0
    with pytest.raises(InvalidInput, match=r"log.csv has no joints to choose from: expected a ROS 2 bag or MCAP file"):
        read(write_text(tmp_path / "log.csv", columns), joint="shoulder")


@pytest.mark.parametrize(
    ("kind", "name"), [("std_msgs/msg/Float64", "/command"), ("std_msgs/msg/Float64MultiArray", "/command[1]")]
)
def test_where_efforts_are_empty_a_topic_of_numbers_is_the_torque(kind, name, columns, plain, tmp_path):
    path = write_bag(tmp_path / "log", columns, effort=False, extra=[("/command", kind, columns["torque"])])
    with pytest.raises(InvalidInput, match="the joint's efforts are empty: name the topic that commands it") as refusal:
        read(path)
    assert name in str(refusal.value)
    alike(read(path, columns={"torque": name}), plain)
    assert not np.any(read(path, columns="torque=")[0].u)


# ---- what is refused ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "package"),
    [("parquet", "pyarrow"), ("mat 7.3", "h5py"), ("bag", "rosbags"), ("mcap", "rosbags"), ("excel", "openpyxl")],
)
def test_a_missing_package_is_one_sentence_that_names_the_extra(form, package, columns, tmp_path, monkeypatch):
    path = FORMS[form](tmp_path / "log", columns)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InvalidInput, match=rf"needs the package {package}.*: pip install 'gapfinder\[files\]'"):
        read(path)


def test_what_is_no_column_of_numbers_is_refused(columns, tmp_path):
    pandas = pytest.importorskip("pandas")

    class Trap:
        def __float__(self):
            raise AssertionError("an object was asked")

    words = columns | {"theta": np.array(["a"] * len(columns["t"]))}
    for log in (
        pandas.DataFrame(columns).assign(theta=[Trap()] * len(columns["t"])),
        pandas.DataFrame(words),
        write_parquet(tmp_path / "log.parquet", words),
        write_parquet(tmp_path / "list.parquet", columns | {"theta": [[1.0]] * len(columns["t"])}),
    ):
        with pytest.raises(InvalidInput, match=r"theta' holds .*not numbers"):
            read(log)
    twice = pandas.DataFrame(columns)
    with pytest.raises(InvalidInput, match="DataFrame: a column comes twice"):
        read(twice.rename(columns={"torque": "theta"}))


def test_a_link_or_a_storage_out_of_an_hdf5_file_is_not_followed(columns, tmp_path):
    h5py = pytest.importorskip("h5py")
    write_mat_73(tmp_path / "secret", columns)
    path = tmp_path / "log.mat"
    write_mat_73(path, {c: v for c, v in columns.items() if c != "theta"})
    with h5py.File(path, "a") as file:
        file["theta"] = h5py.ExternalLink("secret", "/theta")
        file["torque_link"] = h5py.SoftLink("/torque")
        file.create_dataset("outside", (5,), "f8", external=[("secret", 0, 40)])
    with pytest.raises(InvalidInput, match=r"log.mat has no column .theta.*: found outside, t, theta_dot, torque$"):
        read(path, columns="theta=theta")
    with pytest.raises(InvalidInput, match="'outside' lies in other files: expected it in this one"):
        read(path, columns="theta=outside")


def test_a_bag_of_ros_1_is_told_apart(tmp_path):
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(InvalidInput, match=r"old.bag is a bag of ROS 1: expected one of ROS 2"):
        read(tmp_path / "old.bag")
