"""Logs: what a rig wrote becomes records of our conventions, and whatever cannot is refused in one sentence."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from sysid import (
    GeneralJoint,
    InvalidInput,
    LinearAxis,
    Model,
    Record,
    Viscous,
    simulate,
    write_csv,
)
from sysid.data.checks import check_excitation
from sysid.data.logs import read
from sysid.data.needed_rate import needed_rate
from sysid.data.splitting import sample_of, split
from tests.sysid.written import MODEL, REAL, SENSOR, of_real_machine, rollouts, same, table, write

# ---- what was written comes back ---------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [("theta",), ("theta_dot",), ("theta", "theta_dot")], ids="+".join)
def test_a_written_record_comes_back_to_the_bit(channels, tmp_path):
    (record,) = rollouts()
    record = replace(record, **{c: None for c in ("theta", "theta_dot") if c not in channels}, name="log")
    write_csv(record, tmp_path / "log.csv")
    log = read(tmp_path / "log.csv")
    assert len(log) == 1 and log[0].name == "log" and log.notes == () and log.dt == pytest.approx(0.02, rel=1e-9)
    same(log[0], record)


def test_our_zero_our_units_and_our_sign_whatever_the_log_had(tmp_path):
    (record,) = rollouts()
    theirs = table(record) | {"torque": -np.append(record.u, 0.0)}
    theirs["theta"] = np.rad2deg(record.theta - math.pi)
    theirs["theta_dot"] = np.rad2deg(record.theta_dot)
    path = write(tmp_path / "log.csv", theirs)
    same(read(path, zero="hanging", degrees=True, flip_torque=True)[0], record, rtol=1e-12)


@pytest.mark.parametrize(("cell", "asked"), [("0.1", True), ("", False)])
def test_a_column_that_may_be_the_torque_is_asked_about_if_it_holds_numbers(cell, asked, tmp_path):
    (record,) = rollouts()
    path = write(tmp_path / "log.csv", {"t": record.t, "theta": record.theta, "tau_cmd": [cell] * len(record.t)})
    notes = read(path, columns="t=t,theta=theta").notes
    assert any("column 'tau_cmd' is not read: is it the torque" in note for note in notes) is asked


@pytest.mark.parametrize("degrees", [False, True])
def test_a_zero_anywhere_is_told_by_where_the_joint_hangs(degrees, tmp_path):
    (record,) = rollouts()
    at = 123.0 if degrees else 2.15
    theirs = table(record) | {"theta": (np.rad2deg if degrees else np.asarray)(record.theta - math.pi) + at}
    theirs["theta_dot"] = (np.rad2deg if degrees else np.asarray)(record.theta_dot)
    same(read(write(tmp_path / "log.csv", theirs), zero=at, degrees=degrees)[0], record, rtol=1e-12)


@pytest.mark.parametrize("zero", ["upright", "hanging"])
@pytest.mark.parametrize(("at", "degrees", "said"), [(2.15, False, "2.1"), (-123.0, True, "-12")])
def test_free_swings_say_where_the_joint_hangs(zero, at, degrees, said, tmp_path):
    free = simulate(Model(GeneralJoint(J=0.1, G=2.0), (Viscous(b=0.01),), dt=0.01), np.zeros(800), math.pi - 0.7, 0.0)
    theta = np.asarray(free.theta) - math.pi
    path = write(tmp_path / "log.csv", {"t": free.t, "theta": (np.rad2deg(theta) if degrees else theta) + at})
    (note,) = [n for n in read(path, zero=zero, degrees=degrees).notes if "say so" in n]
    assert f"the swings are about {said}" in note and f"(--zero {said}" in note
    assert abs(float(note.partition("--zero ")[2].rstrip(")")) - at) < (0.5 if degrees else 0.01)
    assert not any("say so" in n for n in read(path, zero=at, degrees=degrees).notes)


@pytest.mark.parametrize("turns", [-1, 0, 1, 3])
def test_a_free_swing_hangs_where_its_zero_is_whatever_whole_turns_its_encoder_has_made(turns, tmp_path):
    free = simulate(Model(GeneralJoint(J=0.1, G=2.0), (Viscous(b=0.01),), dt=0.01), np.zeros(800), math.pi - 2.5, 0.0)
    theta = np.asarray(free.theta) - math.pi
    path = write(tmp_path / "log.csv", {"t": free.t, "theta": theta + 2.0 * math.pi * turns})
    log = read(path, zero="hanging", thin=False)
    np.testing.assert_allclose(log[0].theta, free.theta[-len(log[0].theta) :], atol=1e-9)
    assert any(f"{abs(turns)} turn" in note for note in log.notes) == (turns != 0)
    carriage = read(path, zero="upright", thin=False, plant=LinearAxis())[0].theta
    np.testing.assert_allclose(carriage, theta[-len(carriage) :] + 2.0 * math.pi * turns, atol=1e-9)


def test_any_names_and_extra_columns_and_a_mapping_as_good_as_a_string(tmp_path):
    (record,) = rollouts()
    t, theta, theta_dot, torque = table(record).values()
    names = {"stamp": t, "q": theta, "note": ["ok"] * len(t), "dq": theta_dot, "amps": torque}
    path = write(tmp_path / "log.csv", names)
    text = "t=stamp, theta=q, theta_dot=dq, torque=amps"
    same(read(path, columns=text)[0], record)
    same(read(path, columns={"t": "stamp", "theta": "q", "theta_dot": "dq", "torque": "amps"})[0], record)
    assert read(path, columns="t=stamp,theta=q")[0].theta_dot is None
    assert read(write(tmp_path / "own.csv", table(record)), columns="theta_dot=")[0].theta_dot is None


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("decimal_comma", [False, True])
def test_without_a_row_of_names_columns_go_by_their_numbers(delimiter, decimal_comma, tmp_path):
    (record,) = rollouts()
    path = write(tmp_path / "log.csv", table(record))
    plain = read(path)
    text = path.read_text().split("\n", 1)[1].replace(",", delimiter)
    if decimal_comma and delimiter != ",":
        text = text.replace(".", ",")
    (tmp_path / "log.csv").write_text(text)
    same(read(path, columns="t=1,theta=2,theta_dot=3,torque=4")[0], plain[0])


def test_rows_without_a_time_come_at_the_interval_that_is_given(tmp_path):
    (record,) = rollouts()
    columns = table(record)
    plain = read(write(tmp_path / "log.csv", columns | {"t": 0.02 * np.arange(len(record.t))}))
    path = write(tmp_path / "log.csv", {name: column for name, column in columns.items() if name != "t"})
    same(read(path, columns="t=", dt=0.02)[0], plain[0])
    with pytest.raises(InvalidInput, match="columns leave out t: expected the interval of the rows in seconds"):
        read(path, columns="t=")


def test_without_torque_it_is_a_free_swing(tmp_path):
    (record,) = rollouts()
    path = write(tmp_path / "log.csv", {"t": record.t, "theta": record.theta})
    log = read(path)
    assert not np.any(log[0].u) and any("a free swing" in note for note in log.notes)


@pytest.mark.parametrize("command", ["current", "voltage", "position"])
def test_a_command_that_is_asked_for_is_read_or_asked_after(tmp_path, command):
    (record,) = rollouts()
    columns = table(record)
    torque = columns.pop("torque")
    path = write(tmp_path / "log.csv", columns | {"goal": torque})
    with pytest.raises(InvalidInput, match=f"no {command} that the machine was told.*perhaps columns {command}=goal"):
        read(path, command=command)
    with pytest.raises(InvalidInput, match="no column 'duty' for torque"):
        read(path, command=command, columns=f"{command}=duty")
    same(read(path, command=command, columns=f"{command}=goal")[0], record)
    assert not np.any(read(path, command=command, columns="torque=")[0].u), "a free swing that somebody asked for"
    assert any("'goal' is not read" in note for note in read(path).notes)


def test_what_was_told_is_not_guessed_to_be_what_was_read(tmp_path):
    (record,) = rollouts()
    names = ("target pos (1)", "pos (1)", "set speed", "speed rad/sec", "motor current", "Time (ms)")
    path = write(tmp_path / "log.csv", dict.fromkeys(names, record.t))
    likely = "perhaps columns t=Time (ms),theta=pos (1),theta_dot=speed rad/sec"
    for command, told in (("position", "target pos (1)"), ("current", "motor current")):
        with pytest.raises(InvalidInput, match=re.escape(f"{likely},{command}={told}")):
            read(path, command=command)


def test_a_position_is_no_torque_where_none_is_told(tmp_path):
    (record,) = rollouts()
    path = write(tmp_path / "log.csv", table(record) | {"q": record.theta})
    with pytest.raises(InvalidInput, match=r"columns name 'position'.*--input position"):
        read(path, columns="position=q")


@pytest.mark.parametrize("command", ["current", "voltage", "position"])
def test_a_command_called_what_it_is_is_read(tmp_path, command):
    (record,) = rollouts()
    columns = table(record)
    path = write(tmp_path / "log.csv", columns | {command: columns.pop("torque"), "u": np.zeros(len(columns["t"]))})
    same(read(path, command=command)[0], record)


def test_a_position_beside_no_theta_is_the_angle_that_was_read(tmp_path):
    (record,) = rollouts()
    path = write(tmp_path / "log.csv", {"t": record.t, "position": record.theta, "u": np.append(record.u, 0.0)})
    with pytest.raises(InvalidInput, match=r"neither theta nor theta_dot.*perhaps columns theta=position"):
        read(path, command="position")


def test_several_files_and_a_rollout_column_are_several_rollouts(tmp_path):
    one, two = rollouts(2)
    paths = [write(tmp_path / f"{r.name}.csv", table(r)) for r in (one, two)]
    for log in (read(*paths), read(paths)):
        assert [r.name for r in log] == [one.name, two.name]
        same(log[0], one), same(log[1], two)
    both = {name: np.concatenate([v, table(two)[name]]) for name, v in table(one).items()}
    both["rollout"] = np.repeat([7.0, 3.0], [len(one.t), len(two.t)])
    log = read(write(tmp_path / "both.csv", both))
    assert [r.name for r in log] == ["both rollout 7", "both rollout 3"]
    same(log[1], two)
    del both["rollout"]
    log = read(write(tmp_path / "restart.csv", both))
    assert len(log) == 2 and "1 restart of the clock, each a new rollout" in log.notes
    same(log[1], two)


def test_the_window_and_only_the_window(tmp_path):
    (record,) = rollouts()
    log = read(write(tmp_path / "log.csv", table(record)), begin=1.0, end=2.5)
    assert log[0].t[0] == record.t[50] and log[0].t[-1] == record.t[125]
    np.testing.assert_array_equal(log[0].u, record.u[50:125])


def test_a_start_angle_alone_is_not_written(tmp_path):
    record = replace(rollouts()[0], theta=np.array([math.pi]))
    with pytest.raises(InvalidInput, match="has the start angle alone: expected the angle of every instant, or of non"):
        write_csv(record, tmp_path / "speed.csv")


def test_the_last_line_may_be_torn(tmp_path):
    path = write(tmp_path / "log.csv", table(rollouts()[0]))
    path.write_text(path.read_text()[:-45])
    log = read(path)
    assert "log.csv: 1 row without a reading" in log.notes and len(log[0]) == 299


# ---- the clock ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "per_second"), [("ms", 1e3), ("us", 1e6)])
@pytest.mark.parametrize("shown_by", ["name", "speed", "option"])
def test_a_clock_that_counts_faster_than_seconds_gives_the_same_records(shown_by, unit, per_second, tmp_path):
    (record,) = rollouts()
    columns = {"t": np.round(record.t * per_second)} | {k: v for k, v in table(record).items() if k != "t"}
    options = {}
    if shown_by == "name":
        columns = {f"time_{unit}" if k == "t" else k: v for k, v in columns.items() if k != "theta_dot"}
        options = {"columns": f"t=time_{unit}"}
    elif shown_by == "option":
        del columns["theta_dot"]
        options = {"time_unit": unit}
    path = write(tmp_path / "log.csv", columns)
    expected = record if shown_by == "speed" else replace(record, theta_dot=None)
    log = read(path, **options)
    same(log[0], expected, rtol=1e-9)
    assert any("converted to seconds" in note for note in log.notes) == (shown_by != "option")
    window = read(path, **options, begin=1.0, end=2.5)
    assert (window[0].t[0], window[0].t[-1]) == pytest.approx((1.0, 2.5))


def test_a_clock_of_unknown_unit_is_refused_in_a_sentence_that_names_the_option(tmp_path):
    (record,) = rollouts()
    path = write(tmp_path / "log.csv", {"t": 1e3 * record.t, "theta": record.theta})
    with pytest.raises(InvalidInput, match=r"rows are 20 apart in 't'.*--time-unit.*s \(0.05 Hz\) or ms \(50 Hz\)"):
        read(path)
    assert read(path, time_unit="s").dt == pytest.approx(20.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c | {"theta_dot": np.rad2deg(c["theta_dot"])},
        lambda c: c | {"theta_dot": 1e-3 * c["theta_dot"][::-1]},
        lambda c: c | {"theta_dot": np.random.default_rng(0).normal(0.0, 5.0, len(c["t"]))},
        lambda c: {name: v[::10] for name, v in c.items()},
    ],
    ids=["degrees", "nonsense", "noise", "5 Hz"],
)
def test_seconds_stay_seconds(change, tmp_path):
    log = read(write(tmp_path / "log.csv", change(table(rollouts(seconds=12.0)[0]))), time_unit=None)
    assert not any("converted to seconds" in note for note in log.notes) and log.dt >= 0.0199


# ---- what is refused ---------------------------------------------------------------------------------------------

HEAD = "t,theta,theta_dot,torque\n"
REFUSED = {
    "no.csv": ("", "no.csv is empty: expected a row that names the columns"),
    "numbers.csv": (
        "0,1,2,3\n1,2,3,4\n",
        "numbers.csv has no t: found 4 columns without names, called 1 to 4; say which is which, as in columns "
        "t=1,theta=2; if rows have no time, columns t= and their interval (--dt, dt)",
    ),
    "tree.json": (
        '{"t": [0, 1',
        "tree.json is not JSON that is whole: expected lists of numbers, or a list of records",
    ),
    "names.csv": (
        "time_s,angle_rad,velocity\n0,1,2\n",
        "names.csv has no t: found time_s, angle_rad, velocity; say which is which, perhaps columns "
        "t=time_s,theta=angle_rad,theta_dot=velocity",
    ),
    "unread.csv": ("t,torque\n0,1\n", "unread.csv has neither theta nor theta_dot: found t, torque"),
    "text.csv": (HEAD + "0,1,2,3\n0.1,1,fast,3\n", "text.csv, line 3: theta_dot is 'fast', expected a number"),
    "comma.csv": ("t,theta\n0,'1,5'\n", 'comma.csv, line 2: theta is "\'1", expected a number (with a decimal point)'),
    "short.csv": (HEAD + "0,1,2,3\n0.1,1\n0.2,1,2,3\n", "short.csv, line 3: 2 cells, expected 4"),
    "one.csv": (HEAD + "0,1,2,3\n", "nothing to work on in one (1 row): expected at least two rows"),
    "none.csv": (HEAD, "none.csv has no rows"),
    "hollow.csv": ("t,theta,torque\n0,1,\n1,1,\n2,1,\n", "column 'torque' for torque holds no numbers"),
    "twice.csv": ("t,theta,theta\n0,1,2\n", "twice.csv: column 'theta' comes twice"),
    "holes.csv": (
        "t,theta\n" + "".join(f"{'nan' if k % 2 else 0.02 * k},{k}\n" for k in range(40)),
        "holes.csv: 20 of 40 rows lack a number, most often 't': expected a few at most",
    ),
    "back.csv": ("t,theta\n" + "".join(f"{-k},1\n" for k in range(9)), "'t' goes backwards in 100% of the rows"),
    "binary.csv": (b"\x89PNG\r\n\x1a\n\x00\x00\x00", "binary.csv is not a text file: expected CSV, JSON, .npz"),
    "no.npz": (b"PK\3\4 nothing of the kind", "no.npz is not an .npz file of plain arrays"),
    "no.mat": (b"MATLAB".ljust(124) + b"\0\1IM nothing of the kind", "no.mat is not a .mat file"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_log_is_refused_in_one_sentence(name, tmp_path):
    content, message = REFUSED[name]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InvalidInput, match=re.escape(message)) as refusal:
        read(path)
    assert "\n" not in str(refusal.value)


def test_wrong_wishes_are_refused(tmp_path):
    path = write(tmp_path / "log.csv", table(rollouts()[0]))
    for wish, message in (
        ({"zero": "left"}, "zero = 'left': expected upright, hanging, or the log's angle where the joint hangs"),
        ({"zero": math.nan}, "zero = nan: expected upright"),
        ({"time_unit": "min"}, "time_unit = 'min': expected one of s, ms, us"),
        ({"columns": "theta"}, "columns has 'theta': expected name=column pairs"),
        ({"columns": "angle=theta"}, "columns name 'angle': expected some of t, theta, theta_dot, torque, rollout"),
        ({"columns": "theta=phi"}, "log.csv has no column 'phi' for theta: found t, theta, theta_dot, torque"),
        ({"begin": 3.0, "end": 2.0}, "the window from 3 to 2 s is empty"),
        ({"begin": 100.0}, "log.csv has no rows between 100 and inf s"),
        ({"dt": 0.001}, "dt = 0.001 s is finer than log, sampled every 0.02 s"),
    ):
        with pytest.raises(InvalidInput, match=re.escape(message)):
            read(path, **wish)
    for path, message in ((tmp_path / "absent.csv", "no such file"), (tmp_path, "is a folder: expected a log file")):
        with pytest.raises(InvalidInput, match=message):
            read(path)
    with pytest.raises(InvalidInput, match="no log was given"):
        read()


def test_a_register_that_lost_its_sign_gets_it_back(tmp_path):
    (record,) = rollouts()
    signed = np.round(100.0 * np.append(record.u, 0.0))
    columns = table(record) | {"torque": np.where(signed < 0.0, signed + 65536.0, signed)}
    log = read(write(tmp_path / "servo.csv", columns))
    np.testing.assert_array_equal(log[0].u, signed[:-1])
    assert any("column 'torque' jumps from 0 to 65535" in note for note in log.notes)
    whole = read(write(tmp_path / "counts.csv", columns | {"torque": np.arange(len(signed)) * 40.0}))
    np.testing.assert_array_equal(whole[0].u, np.arange(len(signed) - 1) * 40.0)


def test_logs_of_several_rates_are_read_at_that_of_the_slowest(tmp_path):
    slow, fast = rollouts()[0], rollouts(model=replace(MODEL, dt=0.005))[0]
    paths = [write(tmp_path / f"{name}.csv", table(r)) for name, r in (("slow", slow), ("fast", fast))]
    log = read(paths)
    assert [r.dt for r in log] == pytest.approx([0.02, 0.02])
    assert "resampled from 50-200 Hz to 50 Hz" in str(log)
    np.testing.assert_array_equal(log[0].theta, slow.theta)
    milliseconds = write(tmp_path / "ms.csv", table(fast) | {"t": 1000.0 * fast.t})
    with pytest.raises(InvalidInput, match=r"slow is sampled at 50 Hz and ms at 0.2 Hz: .* check time_unit"):
        read([*paths[:1], milliseconds], time_unit="s")


def test_too_many_rows_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("sysid.data.logs.LOG_ROWS", 5_000)
    t = 0.001 * np.arange(40_000)
    path = write(tmp_path / "log.csv", {"t": t, "theta": np.sin(t)})
    with pytest.raises(InvalidInput, match=r"log.csv: rows: 40,000: expected at most 5,000, in a window"):
        read(path)
    assert len(read(path, begin=10.0, end=12.0, thin=False)[0]) == 2000 and len(read(path, dt=0.02)[0]) == 2000
    monkeypatch.setattr("sysid.data.text_files.RAW_ROWS", 30_000)
    monkeypatch.setattr("sysid.data.text_files.CHUNK", 1 << 16)
    with pytest.raises(InvalidInput, match=r"rows, of those read so far: 3\d,\d{3}: expected at most 30,000"):
        read(path, dt=0.02)


# ---- what looks wrong --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", [("theta", "theta_dot"), ("theta", "torque"), ("theta_dot", "torque"), ("t", "theta")])
def test_swapped_columns_are_named(pair, tmp_path):
    one, other = pair
    columns = f"{one}={other},{other}={one}"
    with pytest.raises(InvalidInput, match=f"are {one} and {other} swapped"):
        read(write(tmp_path / "log.csv", table(rollouts()[0])), columns=columns)


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (lambda c: c | {"theta_dot": np.rad2deg(c["theta_dot"])}, "theta_dot looks like deg/s where theta is in rad"),
        (lambda c: c | {"theta": np.rad2deg(c["theta"])}, "theta looks like degrees where theta_dot is in rad/s"),
        (lambda c: c | {"theta_dot": -c["theta_dot"]}, "theta_dot has the opposite sign of theta's rate"),
        (lambda c: c | {"theta_dot": c["theta_dot"][::-1]}, "theta_dot is not the rate of theta"),
        (lambda c: c | {"theta": c["theta"] - math.pi}, "does 0 mean hanging in this log?"),
        (lambda c: c | {"torque": -c["torque"]}, "a positive torque lowers theta: is its sign turned round?"),
        (lambda c: c | {"torque": 0.0 * c["torque"] + 0.4}, "the torque never changes (0.4 N m)"),
        (lambda c: {"t": c["t"], "theta": np.rad2deg(c["theta"])}, "or is it in degrees?"),
    ],
)
def test_a_doubt_is_voiced(change, note, tmp_path):
    columns = table(rollouts()[0])
    assert not read(write(tmp_path / "good.csv", columns)).notes
    assert any(note in n for n in read(write(tmp_path / "odd.csv", change(columns))).notes)


@pytest.mark.parametrize("factor", [math.degrees(1.0), -1.0, 30.0 / math.pi, 6.33, 0.155], ids="{:.3g}".format)
def test_a_speed_in_another_unit_is_left_out(factor: float, tmp_path):
    """In degrees/s, turned round, in turns a minute, or of a shaft before or behind a gear; also of a rollout that does
    not move."""
    moving = table(rollouts()[0])
    still = {name: np.zeros(40) for name in moving} | {"t": 0.02 * np.arange(40)}
    paths = [write(tmp_path / "a.csv", moving | {"theta_dot": factor * moving["theta_dot"]})]
    paths.append(write(tmp_path / "b.csv", still))
    log, expected = read(paths), read(paths, columns="theta_dot=")
    assert [said for said in log.notes if said.endswith("theta_dot is left out")]
    for one, other in zip(log, expected, strict=True):
        assert one.theta_dot is None and np.array_equal(one.theta, other.theta) and np.array_equal(one.u, other.u)


def test_a_speed_in_radians_beside_an_angle_in_degrees_is_not_converted(tmp_path):
    moving = table(rollouts()[0])
    path = write(tmp_path / "log.csv", moving | {"theta": np.rad2deg(moving["theta"])})
    assert read(path, degrees=True)[0].theta_dot is None
    assert read(path)[0].theta_dot is not None


@pytest.mark.parametrize(
    ("zero", "sign", "note"),
    [(math.pi, 1.0, ""), (0.0, 1.0, "does 0 mean hanging in this log?"), (math.pi, -1.0, "its sign turned round?")],
    ids=["as ours", "zero", "sign"],
)
def test_a_doubt_is_voiced_of_a_geared_joint_that_is_moved_slowly(zero, sign, note, tmp_path):
    rng = np.random.default_rng(0)
    t = 0.02 * np.arange(1500)
    hanging = 0.6 * np.sin(0.8 * t) + 0.3 * np.sin(0.31 * t)
    speed = 0.48 * np.cos(0.8 * t) + 0.093 * np.cos(0.31 * t)
    torque = 3.0 * np.sin(hanging) + 0.8 * np.sign(speed) + 0.2 * speed + 0.1 * rng.standard_normal(len(t))
    theta = 0.004 * np.round((hanging + 0.01 * rng.standard_normal(len(t))) / 0.004)
    log = read(write(tmp_path / "joint.csv", {"t": t, "theta": zero + theta, "torque": sign * torque}))
    voiced = [said for said in log.notes if said.endswith("?")]
    assert len(voiced) == (note != "") and all(note in said for said in voiced)


def test_an_axis_is_not_asked_about_angles(tmp_path):
    (record,) = rollouts()
    columns = table(record) | {"theta": 50.0 + np.sin(record.t), "torque": np.full(len(record.t), 0.4)}
    path = write(tmp_path / "log.csv", columns | {"theta_dot": np.cos(record.t)})
    assert any("degrees" in note for note in read(path).notes)
    assert read(path, plant=LinearAxis()).notes == ("the force never changes (0.4 N)",)


def test_a_joint_that_no_gravity_pulls_is_not_asked_where_it_hangs(tmp_path):
    columns = table(rollouts()[0])
    path = write(tmp_path / "log.csv", columns | {"theta": columns["theta"] - math.pi})
    assert any("mean hanging" in note for note in read(path, plant=GeneralJoint()).notes)
    assert read(path, plant=GeneralJoint(G=0.0)).notes == ()


def test_a_machine_at_rest_shows_nothing():
    rng = np.random.default_rng(0)
    t, n = 0.02 * np.arange(301), 301
    rest = [Record(t, np.full(300, 0.1), 3.1 + 0.003 * rng.standard_normal(n), 0.05 * rng.standard_normal(n))] * 2
    with pytest.raises(InvalidInput, match=r"the machine is at rest: theta stays within .* nothing shows its inertia"):
        check_excitation(rest, SENSOR)
    moving = Record(t, np.zeros(300), rest[0].theta + 0.01 * np.sin(5.0 * t), rest[0].theta_dot)
    check_excitation([*rest, moving], SENSOR)


@pytest.mark.parametrize("path", sorted(REAL.glob("*.csv")) or [None], ids=lambda p: p.stem if p else "none")
def test_real_logs_are_read_and_their_zero_is_recognised(path):
    if path is None:
        pytest.skip("the real logs are not here")
    torque = "torque_cmd_Nm" if "shaping" in path.name or "sac" in path.name else "torque_meas_Nm"
    torque = "duty_meas" if "bam" in path.name else torque
    log = of_real_machine(path.stem, torque)
    assert len(log) == 1 and len(log[0]) * log.dt > 3.0
    assert not any("?" in note for note in log.notes), log.notes
    assert any("does 0 mean hanging" in note for note in of_real_machine(path.stem, torque, zero="upright").notes)
    with pytest.raises(InvalidInput, match="are theta and theta_dot swapped"):
        read(path, columns=f"t=time_s,theta=velocity_rad_s,theta_dot=angle_rad,torque={torque}")


# ---- what is held out --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("n", "hold_out", "held"), [(8, None, 2), (4, None, 1), (5, None, 1), (13, None, 3), (8, 0.5, 4)]
)
def test_a_share_of_the_rollouts_is_held_out_spread_over_the_log(n, hold_out, held):
    """Its end may be another kind of motion, and rollouts may go forwards and backwards in turn."""
    records = rollouts(n, seconds=3.0)
    training, out = split(records, hold_out)
    places = np.array([records.index(r) for r in out])
    assert [r for r in records if r not in out] == list(training) and len(out) == held
    assert np.all(np.diff(places) > 0) and np.all(np.abs(places - (np.arange(held) + 0.5) * n / held) <= 0.5 * n / held)
    assert held == 1 or len(set(places % 2)) == 2


@pytest.mark.parametrize(("n", "count"), [(3, 1), (8, 3), (8, 7)])
def test_a_number_holds_out_the_last_rollouts(n, count):
    records = rollouts(n, seconds=3.0)
    assert split(records, count) == (tuple(records[: n - count]), tuple(records[n - count :]))


@pytest.mark.parametrize(
    ("n", "seconds", "share"), [(1, 30.0, 0.25), (3, 8.0, 0.25), (1, 5.0, 2.0 / 5.0), (1, 30.0, 0.4)]
)
def test_few_rollouts_are_cut_and_nothing_is_lost_or_used_twice(n, seconds, share):
    records = rollouts(n, seconds)
    training, out = split(records, share if share == 0.4 else None)
    for record in records:
        parts = sorted((r for r in (*training, *out) if r.name.startswith(record.name)), key=lambda r: r.t[0])
        np.testing.assert_array_equal(np.concatenate([r.u for r in parts]), record.u)
    seconds_out = sum(len(r) * r.dt for r in out)
    assert seconds_out == pytest.approx(share * n * seconds, abs=0.5)
    assert len(out) <= 4


def test_what_is_held_out_of_one_rollout_is_spread_over_it():
    """Neither its beginning nor its end, which may be another kind of motion."""
    (record,) = rollouts(1, 24.0)
    training, out = split([record])
    assert len(out) == 3
    assert training[0].t[0] == record.t[0] and training[-1].t[-1] == record.t[-1]
    (longer,) = rollouts(1, 60.0)
    held = [0.5 * (r.t[0] + r.t[-1]) for r in split([longer])[1]]
    np.testing.assert_allclose(held, [10.0, 30.0, 50.0], atol=0.1)


def stepped(seconds: float, at: Sequence[float], channel: str) -> Record:
    """A joint that moves for half a second after each of some instants, and rests the remaining time."""
    rng, t = np.random.default_rng(0), 0.02 * np.arange(round(seconds / 0.02) + 1)
    theta = np.sum([2.0 * np.clip((t - begin) / 0.5, 0.0, 1.0) for begin in at], axis=0)
    angles, speeds = theta + 5e-3 * rng.standard_normal(len(t)), np.gradient(theta, 0.02)
    read = {"theta": angles} if channel == "theta" else {"theta_dot": speeds + 0.1 * rng.standard_normal(len(t))}
    return Record(t=t, u=np.zeros(len(t) - 1), **read)


def motion(records: Iterable[Record], at: Sequence[float]) -> float:
    """The seconds in which a joint moves that does so for half a second after each of some instants."""
    return sum(max(min(r.t[-1], begin + 0.5) - max(r.t[0], begin), 0.0) for r in records for begin in at)


@pytest.mark.parametrize("channel", ["theta", "theta_dot"])
@pytest.mark.parametrize("at", [(1.5,), (1.5, 5.0), (3.2, 3.9), (0.2, 6.2), (1.0, 3.3, 5.7)])
def test_neither_side_of_a_split_is_all_at_rest(at, channel):
    """In its middle a stretch may hold all of the motion, or none."""
    fitted, held_out = (motion(side, at) for side in split([stepped(7.0, at, channel)]))
    assert fitted + held_out == pytest.approx(0.5 * len(at))
    assert 0.03 < held_out / (fitted + held_out) < 0.65


def test_of_two_rollouts_with_a_step_in_the_middle_one_is_fitted():
    records = [stepped(3.5, [1.5], "theta"), replace(stepped(3.5, [1.5], "theta"), name="other")]
    fitted, held_out = (motion(side, [1.5]) for side in split(records))
    assert min(fitted, held_out) > 0.3


def test_the_sample_of_a_log_holds_its_motion():
    """It is what is searched: all of the motion may be in it."""
    for at in ([10.0, 10.6], [3.0]):
        assert motion(sample_of([stepped(30.0, at, "theta")], 500), at) > 0.1


def test_a_log_without_readings_is_refused_with_its_reason():
    t = 0.02 * np.arange(500)
    with pytest.raises(InvalidInput, match="reading"):
        split([Record(t=t, u=np.zeros(499), theta=np.zeros(1), theta_dot=None)])


@pytest.mark.parametrize("n", [1, 3, 4, 12])
def test_of_a_long_log_a_sample_is_taken_that_is_spread_over_it(n):
    records = rollouts(n, 60.0 / n)
    total = sum(map(len, records))
    assert sample_of(records, total) == tuple(records)
    sample = sample_of(records, total // 3)
    assert 0.2 * total < sum(map(len, sample)) < 0.4 * total
    assert all(any(r.name.startswith(record.name) for record in records) for r in sample)
    numbers = [next(k for k, record in enumerate(records) if r.name.split(",")[0] == record.name) for r in sample]
    places = [float(r.t[0]) + 60.0 / n * k for r, k in zip(sample, numbers, strict=True)]
    assert min(places) < 20.0 and max(places) > 36.0


@pytest.mark.parametrize(
    ("seconds", "n", "hold_out", "message"),
    [
        (6.0, 2, 0.0, "hold_out = 0.0: expected a share between 0 and 1"),
        (6.0, 2, 1.5, "hold_out = 1.5: expected a share"),
        (6.0, 2, 2, "hold_out = 2 of 2 rollouts leaves none to fit"),
        (0.4, 1, None, "0.4 s of log are too short to hold a part out"),
    ],
)
def test_a_split_that_leaves_nothing_is_refused(seconds, n, hold_out, message):
    with pytest.raises(InvalidInput, match=re.escape(message)):
        split(rollouts(n, seconds), hold_out)


def test_of_rollouts_too_short_to_be_cut_whole_ones_are_held_out():
    """Stretches of a second in four rollouts of little more leave only pieces that are too short."""
    records = rollouts(4, 1.16)
    training, held_out = split(records)
    assert set(map(id, (*training, *held_out))) == set(map(id, records)) and len(held_out) == 2


@pytest.mark.parametrize("n", range(1, 9))
def test_every_log_of_half_a_second_and_more_is_split(n):
    for seconds in np.arange(0.06, 3.0, 0.1).tolist():
        if n * seconds >= 0.5:
            training, held_out = split(rollouts(n, seconds))
            assert training and held_out


@pytest.mark.parametrize("seconds", (0.7, 1.9))
def test_of_a_quick_stroke_a_part_is_held_out_too(seconds):
    training, held_out = split(rollouts(1, seconds))
    assert sum(len(r) * r.dt for r in held_out) > 0.3 * seconds
    assert sum(len(r) * r.dt for r in training) > 0.3 * seconds


# ---- thinning --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "left"), [(50, 50), (150, 150), (500, 100), (1000, 100)])
def test_a_fast_log_of_a_slow_motion_is_thinned_to_100_hz(rate, left, tmp_path):
    t = np.arange(4 * rate + 1) / rate
    path = write(tmp_path / "log.csv", {"t": t, "theta": 3.0 + np.sin(6.0 * t), "torque": np.cos(6.0 * t)})
    log = read(path)
    assert 1.0 / log.dt == pytest.approx(left)
    assert log.records[0].dt == pytest.approx(log.dt)
    assert any("thinned from" in note for note in log.notes) == (rate != left)


def test_a_piece_of_fewer_rows_than_one_thinned_sample_is_dropped(tmp_path):
    """Seven rows behind a gap are no rollout at a tenth of the rate."""
    t = np.append(np.arange(4001), np.arange(4900, 4907)) / 1000.0
    path = write(tmp_path / "log.csv", {"t": t, "theta": 3.0 + np.sin(6.0 * t), "torque": np.cos(6.0 * t)})
    assert len(read(path, thin=False)) == 2
    assert [r.dt for r in read(path)] == [pytest.approx(0.01)]


def test_a_fast_motion_keeps_its_rate(tmp_path):
    """Twenty samples a period: 12 Hz needs 240."""
    t = np.arange(4001) / 1000.0
    path = write(tmp_path / "log.csv", {"t": t, "theta": 3.0 + 0.3 * np.sin(2.0 * np.pi * 12.0 * t)})
    assert 240.0 <= 1.0 / read(path).dt < 480.0


@pytest.mark.parametrize("amplitude", [0.6, 0.1, 0.05])
def test_white_noise_is_no_motion_that_a_fast_log_shows(amplitude):
    t, rng = np.arange(4001) * 1e-3, np.random.default_rng(0)
    theta = math.pi + amplitude * np.sin(2.0 * math.pi * t) + 0.003 * rng.standard_normal(4001)
    assert needed_rate([Record(t, np.zeros(4000), theta)]) == 50.0, "a free swing"
    assert needed_rate([Record(t, np.ones(4000), theta)]) == 100.0


def test_a_fast_motion_is_seen_through_the_noise():
    t, rng = np.arange(4001) * 1e-3, np.random.default_rng(0)
    theta = math.pi + 0.5 * np.sin(2.0 * math.pi * t) + 0.02 * np.sin(40.0 * math.pi * t)
    rate = needed_rate([Record(t, np.zeros(4000), theta + 0.003 * rng.standard_normal(4001))])
    assert rate == pytest.approx(400.0, rel=0.02), "20 samples a period of 20 Hz"


def test_what_gaps_cut_off_does_not_tell_the_rate_that_a_motion_needs():
    """A moment of a sine, without its trend, is a part of no period: it has something at every frequency."""
    t = np.arange(4001) * 1e-3
    whole = Record(t, np.ones(4000), math.pi + 0.3 * np.sin(6.0 * math.pi * t))
    moments = [whole.part(k, k + 50, f"moment {k}") for k in (900, 1300)]
    assert needed_rate([whole]) == needed_rate([whole, *moments]) == 100.0 < needed_rate(moments)


def test_the_rate_that_a_motion_needs_is_seen_in_its_speed_alone():
    t, rng = np.arange(4001) * 1e-3, np.random.default_rng(0)
    theta_dot = 2.0 * math.pi * np.cos(2.0 * math.pi * t) + 0.1 * np.sign(np.sin(6.0 * math.pi * t))
    noisy = theta_dot + 0.2 * rng.standard_normal(4001)
    assert needed_rate([Record(t, np.ones(4000), theta_dot=noisy)]) == 100.0


@pytest.mark.parametrize("name, end", [("energy_shaping", 4.2), ("sac", 4.6), ("dircol", 3.5), ("ddp", 6.0)])
def test_a_sign_turned_round_is_doubted_in_logs_of_a_real_pendulum(name, end):
    for flipped in (False, True):
        notes = of_real_machine(f"dfki_sp_{name}", end=end, flip_torque=flipped).notes
        assert any("its sign turned round?" in note for note in notes) == flipped
