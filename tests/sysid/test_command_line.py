"""The command line: the whole way of a user, and what it says to wrong input."""

import json
import math
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import sysid
from sysid.__main__ import main
from sysid.cli.command_options import COMMANDS
from sysid.cli.starting_model import _turns_round
from sysid.planning.excitation import multisine
from tests.hostile_input import answering
from tests.sysid.written import table, write

ROOT = Path(__file__).parents[2]
DT = 0.02
SENSOR = sysid.Sensor(theta=0.003, theta_dot=0.05)


def swings(plant, *effects, count=6, seconds=6.0, torque=1.2, sensor=SENSOR, seed=0):
    """Rollouts from rest under multisine torques, the largest `torque` times that of gravity."""
    rng = np.random.default_rng(seed)
    model = sysid.Model(plant, effects, sysid.RK4(10), dt=DT)
    size = torque * (float(plant.gravity_torque(0.5 * math.pi)) or float(plant.inertia()))
    pace = math.sqrt(float(plant.gravity_torque(0.5 * math.pi)) / float(plant.inertia())) / (2.0 * math.pi) or 1.0
    u = np.stack([multisine(rng, round(seconds / DT), DT, size, min(2.0 * pace, 5.0)) for _ in range(count)])
    start = math.pi + rng.normal(0.0, 0.3, count)
    return sensor.measure(sysid.simulate(model, u, start, np.zeros(count)), rng)


def written(records, folder, torque=True):
    """The records as files of the default columns; returns their paths as words of a command line."""
    files = []
    for k, record in enumerate(records):
        columns = {c: v for c, v in table(record).items() if v is not None and (torque or c != "torque")}
        files.append(str(write(folder / f"swing{k}.csv", columns)))
    return files


@pytest.fixture(scope="module")
def hidden(tmp_path_factory):
    """A log with a dry friction of 0.15 N m that nobody told of."""
    plant = sysid.PointMassPendulum(m=1.3, l=0.6)
    return written(swings(plant, sysid.Coulomb(0.15)), tmp_path_factory.mktemp("hidden"))


def test_python_answers_as_the_command_does(tmp_path, capsys):
    """Of a log that was sampled ten times faster than its motion needs."""
    rng, t = np.random.default_rng(0), 0.002 * np.arange(10_001)
    model = sysid.Model(sysid.GeneralJoint(J=0.1, G=2.0), (sysid.Viscous(b=0.01),), dt=0.002)
    swing = sysid.simulate(model, np.zeros(10_000), math.pi + 0.7, 0.0)
    read = np.round((swing.theta - math.pi + 0.001 * rng.standard_normal(len(t))) / 5e-4) * 5e-4
    write(tmp_path / "swing.csv", {"t": t, "theta": read})
    answer = str(tmp_path / "answer.json")
    options = ("--plant", "joint", "--zero", "hanging", "--json", answer)
    assert main(["diagnose", str(tmp_path / "swing.csv"), *options]) == 0
    stored = json.loads(Path(answer).read_text())
    log = sysid.read(tmp_path / "swing.csv", zero="hanging")
    assert log.dt == pytest.approx(0.02) and log[0].whole.dt == pytest.approx(0.002)
    diagnosis = sysid.diagnose(sysid.Model(sysid.GeneralJoint(), dt=log.dt), log)
    assert diagnosis.verdict == stored["verdict"] == "missing" and [s.effect for s in diagnosis.steps] == ["viscous"]
    for name, value in diagnosis.estimate.values.items():
        assert value == pytest.approx(stored["parameters"][name]["value"], rel=1e-3)
    assert repr(diagnosis) == str(diagnosis) and str(diagnosis).splitlines()[0] in capsys.readouterr().out


@pytest.mark.parametrize(("torque", "wrong"), [(0.005, False), (1.2, True)], ids=["next to the noise", "a wrong sign"])
def test_an_error_is_called_far_above_the_noise_only_if_it_is(torque, wrong, tmp_path, capsys):
    """A motion little larger than the noise is not told any better by the right model; a wrong sign tells nothing."""
    model = sysid.Model(sysid.GeneralJoint(J=0.1, G=2.0), (sysid.Viscous(b=0.1),), dt=DT)
    u = np.stack([multisine(np.random.default_rng(k), 300, DT, 2.0 * torque, 1.5) for k in range(6)])
    records = SENSOR.measure(sysid.simulate(model, u, np.full(6, math.pi), np.zeros(6)), np.random.default_rng(0))
    options = ["--flip-torque"] if wrong else []
    assert main(["fit", *written(records, tmp_path), "--plant", "joint", "--with", "viscous", *options]) == 0
    assert ("the error is far above any noise" in capsys.readouterr().out) == wrong


@pytest.mark.long
def test_the_whole_loop(hidden, tmp_path, capsys):
    model, better, answer = (str(tmp_path / name) for name in ("model.json", "better.json", "answer.json"))
    before = [Path(f).read_bytes() for f in hidden]

    assert main(["fit", *hidden, "--plant", "point", "-o", model]) == 0
    assert "the model lacks something" in capsys.readouterr().out
    assert main(["compare", *hidden, "--model", model, "--json", answer]) == 0
    assert "dry friction" in capsys.readouterr().out
    off = json.loads(Path(answer).read_text())["errors"]["1_s"]["ratio"]
    assert off > 2.0

    assert main(["diagnose", *hidden, "--model", model, "--json", answer, "-o", better]) == 0
    assert capsys.readouterr().out.splitlines()[2].startswith("missing: coulomb")
    diagnosis = json.loads(Path(answer).read_text())
    assert diagnosis["schema"] == "gapfinder/diagnosis/1" and diagnosis["verdict"] == "missing"
    saved = sysid.load(better)
    assert [e.name for e in saved.model.effects] == ["coulomb"]
    assert saved.estimate.values == pytest.approx({k: v["value"] for k, v in diagnosis["parameters"].items()})
    assert diagnosis["base_error"] == pytest.approx(off, rel=0.01)
    (step,) = diagnosis["steps"]
    tau_c = step["parameters"]["coulomb.tau_c"]
    assert step["effect"] == diagnosis["ranking"][0]["effect"] == "coulomb"
    assert abs(tau_c["value"] - 0.15) < 4.0 * tau_c["sd"] < 0.01
    assert 0.9 < step["error_after"] < 1.1

    assert main(["add", "coulomb", *hidden, "--model", model, "-o", better]) == 0
    assert "wrote" in capsys.readouterr().out
    assert main(["compare", *hidden, "--model", better, "--json", answer]) == 0
    assert "nothing is missing" in capsys.readouterr().out
    assert 0.9 < json.loads(Path(answer).read_text())["errors"]["1_s"]["ratio"] < 1.1
    assert [Path(f).read_bytes() for f in hidden] == before


FAR = {
    "small rod": (sysid.RodPendulum(m=0.05, l=0.1, g=9.81, bounds={"m": (0, 99), "l": (0, 99)}), "rod"),
    "large rod": (sysid.RodPendulum(m=20.0, l=3.0, g=9.81, bounds={"m": (0, 99), "l": (0, 99)}), "rod"),
    "light joint": (sysid.GeneralJoint(J=1e-4, G=0.02), "joint"),
    "heavy joint": (sysid.GeneralJoint(J=60.0, G=300.0), "joint"),
    "heavy carriage": (sysid.LinearAxis(m=300.0), "axis"),
}


@pytest.mark.long
@pytest.mark.parametrize("effects", [(), ("friction",)], ids=["plain", "friction"])
@pytest.mark.parametrize(("plant", "kind"), FAR.values(), ids=FAR.keys())
def test_a_fit_begins_far_off_and_arrives(plant, kind, effects, tmp_path):
    size = float(plant.gravity_torque(0.5 * math.pi)) or float(plant.inertia())
    hidden = [sysid.Coulomb(0.03 * size, bounds={"tau_c": (0.0, 1e4)}) for _ in effects]
    files = written(swings(plant, *hidden, count=4), tmp_path)
    assert main(["fit", *files, "--plant", kind, "-o", str(tmp_path / "model.json")]) == 0
    estimate = sysid.load(tmp_path / "model.json").estimate
    truth = {name: float(plant.parameters[name].value) for name in estimate.names}
    if hidden:  # the nearest numbers of a model that lacks the friction
        assert estimate.values == pytest.approx(truth, rel=0.25)
    else:
        for name, (low, high) in estimate.interval(0.9999).items():
            assert low < truth[name] < high


def test_a_free_swing_shows_the_length_and_not_the_mass(tmp_path, capsys):
    rod = sysid.RodPendulum(m=1.0, l=0.8, g=9.81)
    files = written(swings(rod, torque=0.0), tmp_path, torque=False)
    assert main(["fit", *files, "-o", str(tmp_path / "model.json")]) == 0
    said = capsys.readouterr().out
    assert "a free swing cannot show m" in said
    assert "--set m=" in said
    estimate = sysid.load(tmp_path / "model.json").estimate
    assert estimate.names == ("l",)
    assert abs(estimate.values["l"] - 0.8) < 4.0 * estimate.sd["l"]


@pytest.mark.long
def test_what_is_known_stays_fixed(hidden, tmp_path, capsys):
    out = str(tmp_path / "model.json")
    assert main(["fit", *hidden, "--plant", "point", "--set", "l=0.6", "--set", "g=9.8", "-o", out]) == 0
    saved = sysid.load(out)
    assert saved.free == ("m",)
    assert (saved.model.plant.l, saved.model.plant.g) == (0.6, 9.8)
    assert main(["fit", *hidden, "--model", out, "--noise", "theta=0.004,theta_dot=0.06", "-o", out + "2"]) == 0
    again = sysid.load(out + "2")
    assert again.free == ("m",)
    assert (again.estimate.sensor.theta, again.estimate.sensor.theta_dot) == (0.004, 0.06)
    assert "sensor noise: theta" not in capsys.readouterr().out.split("wrote")[1]


def test_a_published_model_is_compared_as_it_stands(hidden, tmp_path, capsys):
    """All of its numbers given: nothing is fitted, and the truth leaves nothing over."""
    answer = tmp_path / "answer.json"
    words = ["compare", *hidden, "--plant", "point", "--set", "m=1.3", "--set", "l=0.6", "--json", str(answer)]
    assert main([*words, "--with", "coulomb.tau_c=0.15"]) == 0
    assert "nothing is missing" in capsys.readouterr().out
    assert main([*words, "--with", "coulomb.tau_c=0.05,viscous.b=0.01"]) == 0
    assert json.loads(answer.read_text())["errors"]["1_s"]["ratio"] > 1.4


def test_effects_from_the_start_are_fitted_or_fixed(hidden, tmp_path, capsys):
    out = str(tmp_path / "model.json")
    assert main(["fit", *hidden, "--plant", "point", "--to", "3", "--with", "coulomb,viscous.b=0.001", "-o", out]) == 0
    assert capsys.readouterr().out.count("+- is one standard deviation") == 1
    saved = sysid.load(out)
    assert saved.free == ("m", "l", "coulomb.tau_c")
    assert saved.model.parameters["viscous.b"].value == 0.001
    assert "has it already" in refused(["fit", *hidden, "--model", out, "--with", "coulomb"], capsys)
    assert main(["compare", *hidden, "--model", out, "--plant", "point"]) == 0
    said = refused(["compare", *hidden, "--model", out, "--plant", "rod"], capsys)
    assert "--plant rod, but the plant of" in said and "is point" in said


def test_an_axis_is_told_in_its_own_units(tmp_path, capsys):
    files = written(swings(sysid.LinearAxis(m=2.0), sysid.Viscous(0.5), count=2), tmp_path)
    assert main(["fit", *files, "--plant", "axis", "--with", "viscous", "--json", str(tmp_path / "a.json")]) == 0
    said = capsys.readouterr().out
    noise, numbers = said.splitlines()[1], said[said.index("  m ") : said.index("  on held-out")]
    assert " m (" in noise and " m/s (" in noise and "rad" not in noise
    assert "N s/m" in numbers and "rad" not in numbers
    assert json.loads((tmp_path / "a.json").read_text())["units"]["viscous.b"] == "N s/m"


def test_a_wheel_of_which_speeds_alone_are_known_has_no_gravity(tmp_path, capsys):
    """It turns round: where its weight would hang nothing says. A pendulum that swings keeps its own."""
    sensor = sysid.Sensor(None, 0.05)
    wheel = written(
        swings(sysid.GeneralJoint(J=0.1, G=0.0), sysid.Viscous(0.05), count=2, torque=200.0, sensor=sensor), tmp_path
    )
    assert main(["fit", *wheel, "--plant", "joint", "--with", "viscous", "-o", str(tmp_path / "wheel.json")]) == 0
    assert "G = 0 is taken" in capsys.readouterr().out
    estimate = sysid.load(tmp_path / "wheel.json").estimate
    assert estimate.names == ("J", "viscous.b")
    assert estimate.values["J"] == pytest.approx(0.1, rel=0.05)
    known = sysid.Model(sysid.GeneralJoint(J=0.1, G=1.0), dt=DT)
    sysid.save(known, tmp_path / "given.json")
    assert main(["compare", *wheel, "--model", str(tmp_path / "given.json")]) == 0
    assert "G = 1 is taken" in capsys.readouterr().out, "what was given is what is compared"
    swing = written(swings(sysid.GeneralJoint(J=0.1, G=1.0), count=2, torque=0.3, sensor=sensor), tmp_path)
    assert main(["fit", *swing, "--plant", "joint", "-o", str(tmp_path / "swing.json")]) == 0
    assert "is taken" not in capsys.readouterr().out
    assert sysid.load(tmp_path / "swing.json").estimate.values["G"] == pytest.approx(1.0, rel=0.05)


def test_a_speed_that_reads_too_much_does_not_turn_a_pendulum_round():
    t = DT * np.arange(10_001)
    for offset, turns in ((0.1, False), (6.0, True)):
        record = sysid.Record(t, np.zeros(10_000), None, np.sin(3.0 * t) + offset)
        assert _turns_round(record) == turns
    assert not _turns_round(sysid.Record(t, np.zeros(10_000), np.zeros(1), np.full(10_001, 6.0))), "it began somewhere"


@pytest.mark.long
def test_a_known_loop_is_integrated_in_steps_that_are_stable(tmp_path):
    """Damped by 440 in a second, and logged every 20 ms: a step of RK4 would be unstable beyond 6 ms."""
    servo = sysid.PositionServo(k_p=16.0, k_d=1.6)
    options = ["--plant", "joint", "--input", "position", "--set", "J=0.0037", "--set", "G=0"]
    options += ["--set", "position_servo.k_p=16", "--set", "position_servo.k_d=1.6", "--with", "coulomb"]
    model = sysid.Model(sysid.GeneralJoint(J=0.0037, G=0.0), (servo, sysid.Coulomb(0.3)), sysid.RK4(40), dt=DT)
    u = np.array([multisine(np.random.default_rng(0), 300, DT, 1.0, 1.0)])
    files = written(SENSOR.measure(sysid.simulate(model, u, u[:, 0], np.zeros(1)), np.random.default_rng(1)), tmp_path)
    assert main(["fit", *files, *options, "--hold-out", "0.3", "-o", str(tmp_path / "m.json")]) == 0
    estimate = sysid.load(tmp_path / "m.json").estimate
    assert estimate.model.integrator.substeps >= 9
    assert estimate.values["coulomb.tau_c"] == pytest.approx(0.3, rel=0.1)


def test_a_log_carries_its_options_in_a_file_beside_it(hidden, tmp_path, capsys):
    sec, phi, omega, motor = np.loadtxt(hidden[0], delimiter=",", skiprows=1, unpack=True)
    rig = write(tmp_path / "rig.csv", {"sec": sec, "phi": phi - math.pi, "omega": omega, "motor": motor})
    (tmp_path / "log.toml").write_text(
        'columns = {t = "sec", theta = "phi", theta_dot = "omega", torque = "motor"}\nzero = "hanging"\n'
        'plant = "point"\nto = 4\n'
    )
    assert main(["fit", str(rig), "--to", "3", "-o", str(tmp_path / "a.json")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert "zero hanging; plant point (the command line overrides to)" in said[0] and "(3 s)" in said[1]
    assert main(["fit", hidden[0], "--plant", "point", "--to", "3", "-o", str(tmp_path / "b.json")]) == 0
    first, second = (sysid.load(tmp_path / f).estimate.values for f in ("a.json", "b.json"))
    assert second == pytest.approx(first, rel=1e-4)
    assert "is read by this command" in refused(["fit", str(rig), "-o", str(tmp_path / "log.toml")], capsys)
    assert "found sec, phi" in refused(["fit", str(rig), "--log", "none"], capsys)
    assert "no such file: absent.toml" in refused(["fit", str(rig), "--log", "absent.toml"], capsys)


def test_a_window_and_another_rate(hidden, tmp_path, capsys):
    """A saved model steps at the interval of the log that it is held against."""
    out = str(tmp_path / "model.json")
    assert main(["fit", *hidden, "--plant", "point", "--to", "5", "-o", out]) == 0
    assert "6 rollouts, 1500 samples" in capsys.readouterr().out
    assert main(["compare", *hidden, "--model", out, "--dt", "0.04"]) == 0
    assert "at 25 Hz" in capsys.readouterr().out


@pytest.mark.long
def test_the_next_experiment_is_what_a_rig_can_play(hidden, tmp_path, capsys):
    out, rivals = tmp_path / "play.csv", ["--plant", "point", "--between", "coulomb,viscous", "--u-max", "2"]
    short = [hidden[0], "--to", "2", *rivals, "--duration", "4", "--rollouts", "1", "-o", str(out)]
    assert main(["experiment", *short]) == 0
    assert "tells coulomb from viscous" in capsys.readouterr().out
    t, torque = np.loadtxt(out, delimiter=",", skiprows=1, unpack=True)
    np.testing.assert_allclose(t, DT * np.arange(200), atol=1e-9)
    assert 0.0 < np.max(np.abs(torque)) <= 2.0
    assert main(["experiment", *hidden, *rivals, "--duration", "1", "--rollouts", "1"]) == 0
    assert "the log at hand tells coulomb from viscous" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_answers_at_once(command):
    words = [sys.executable, "-m", "sysid", *command.split(), "--help"]
    spent = []
    for _ in range(10):
        before = os.times()
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
        after = os.times()  # of the processor: a busy machine is no fault of ours
        spent.append(after.children_user + after.children_system - before.children_user - before.children_system)
        if spent[-1] < 0.5:
            break
    assert done.stdout.startswith("usage: sysid") and "None" not in done.stdout
    assert min(spent) < 0.5


def test_the_catalogue_is_listed(capsys):
    assert main(["effects"]) == 0
    said = capsys.readouterr().out
    for name, kind in sysid.CATALOGUE.items():
        assert f"\n{name}\n    {kind.formula}\n" in f"\n{said}"


# ---- bad input -------------------------------------------------------------------------------------------------------

LOG = "t,theta,theta_dot,torque\n"
STILL = LOG + "".join(f"{0.02 * k:.2f},3.14159,0,0.3\n" for k in range(200))


def noisy_rest():
    """A pendulum at rest, seen by a real sensor."""
    rng = np.random.default_rng(3)
    rows = [f"{0.02 * k:.2f},{math.pi + 0.003 * rng.normal():.5f},{0.05 * rng.normal():.4f},0.3\n" for k in range(300)]
    return LOG + "".join(rows)


refused = partial(answering.refused, main)


FILES = {
    "missing columns": ("time,angle\n0,1\n", "found time, angle"),
    "at rest": (STILL, "nothing shows its inertia"),
    "at rest under noise": (noisy_rest(), "nothing shows its inertia"),
    "no CSV": ("\x00\x01\x02", "bad.csv"),
}


@pytest.mark.parametrize(("text", "message"), FILES.values(), ids=FILES.keys())
@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_a_log_that_cannot_be_used(command, text, message, tmp_path, capsys):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    before = file.read_bytes()
    assert message in refused([command, str(file)], capsys)
    assert file.read_bytes() == before


OPTIONS = {
    "no log": (["fit"], "no log was given"),
    "no such log": (["fit", "absent.csv"], "no such file"),
    "unknown effect": (["add", "colomb", "LOG"], "did you mean coulomb"),
    "unknown parameter": (["fit", "LOG", "--set", "k=3"], "unknown parameter 'k'"),
    "no number": (["fit", "LOG", "--set", "l=long"], "expected NAME=NUMBER"),
    "out of bounds": (["fit", "LOG", "--set", "l=1e9"], "out of bounds"),
    "nothing left": (["fit", "LOG", "--set", "l=1", "--set", "m=1"], "nothing is left to fit"),
    "noise of nothing": (["fit", "LOG", "--noise", "phi=1"], "--noise names 'phi'"),
    "noise below zero": (["fit", "LOG", "--noise", "theta=-1"], "positive number"),
    "no gravity": (["fit", "LOG", "--plant", "joint", "--set", "g=9"], "unknown parameter 'g'"),
    "set without effect": (["fit", "LOG", "--set", "viscous.b=0.1"], "--with viscous.b=0.1 puts it in"),
    "with no effect": (["fit", "LOG", "--with", "viscus"], "did you mean viscous"),
    "with no such number": (["fit", "LOG", "--with", "viscous.c=1"], "expected viscous or viscous.b=NUMBER"),
    "with a number for all": (["fit", "LOG", "--with", "viscous=1"], "expected viscous or viscous.b=NUMBER"),
    "with no number": (["fit", "LOG", "--with", "viscous.b=much"], "expected NAME=NUMBER"),
    "no model": (["compare", "LOG", "--model", "absent.json"], "absent.json"),
    "log as model": (["compare", "LOG", "--model", "LOG"], "is not JSON"),
    "log as output": (["fit", "LOG", "-o", "LOG"], "is read by this command"),
    "a log twice": (["fit", "LOG", "LOG"], "is given twice"),
    "one file for two": (["fit", "LOG", "-o", "x.json", "--json", "x.json"], "two answers"),
    "no folder": (["fit", "LOG", "-o", "absent/model.json"], "no folder"),
    "folder as output": (["fit", "LOG", "-o", "."], "is a folder"),
    "picture of no kind": (["compare", "LOG", "--plant", "point", "--figure", "x.abc"], "x.abc"),
    "experiment to nowhere": (
        ["experiment", "LOG", "--plant", "point", "--duration", "6", "-o", "/proc/x.csv"],
        "x.csv",
    ),
    "experiment with nothing": (["experiment", "LOG", "--plant", "point", "--between", "coulomb,frixion"], "'frixion'"),
    "effects of nobody": (["effects", "--effects", "absent.py"], "no such file"),
}


@pytest.mark.parametrize(("words", "message"), OPTIONS.values(), ids=OPTIONS.keys())
def test_options_that_cannot_be(words, message, hidden, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = Path(hidden[0]).read_bytes()
    assert message in refused([hidden[0] if w == "LOG" else w for w in words], capsys)
    assert Path(hidden[0]).read_bytes() == before
    assert not list(tmp_path.glob("*.json"))


OTHERS = {
    "measurements": ["fit", "LOG", "-o", "FILE"],
    "measurements for a page": ["compare", "LOG", "--plant", "point", "--html", "FILE"],
    "measurements for a plan": ["experiment", "LOG", "--plant", "point", "--duration", "6", "-o", "FILE"],
}


@pytest.mark.parametrize("words", OTHERS.values(), ids=OTHERS.keys())
@pytest.mark.parametrize("content", ["t,theta\n0,1\n", '{"rig": "pendulum"}', "<html></html>"])
def test_what_others_wrote_is_never_replaced(words, content, hidden, tmp_path, capsys):
    theirs = tmp_path / "measured.csv"
    theirs.write_text(content)
    replacements = {"LOG": hidden[0], "FILE": str(theirs)}
    assert "no answer of ours: expected another name" in refused([replacements.get(w, w) for w in words], capsys)
    assert theirs.read_text() == content


def test_what_was_written_before_is_replaced(hidden, tmp_path):
    files = {name: str(tmp_path / f"own.{name}") for name in ("model", "json", "html", "png")}
    for _ in range(2):
        words = ["fit", *hidden[:4], "--plant", "point", "--to", "3", "-o", files["model"], "--json", files["json"]]
        assert main(words) == 0
        words = ["compare", hidden[0], "--model", files["model"], "--html", files["html"], "--figure", files["png"]]
        assert main([*words, "--json", files["json"]]) == 0
        assert json.loads(Path(files["json"]).read_text())["schema"].startswith("gapfinder/")
        assert Path(files["html"]).read_text(encoding="utf-8").lower().startswith("<!doctype html>")


@pytest.mark.parametrize(
    "words",
    [
        ["fit", "--zero", "down"],
        ["fit", "--zero", "None"],
        ["fit", "--dt", "None"],
        ["fit", "--hold"],
        ["diagnoze"],
        [],
    ],
)
def test_words_that_are_no_command(words, capsys):
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code == 2
    assert "help" in capsys.readouterr().err


@pytest.mark.long
def test_a_servo_told_by_its_commands(tmp_path, capsys):
    """The log has angles and goals in degrees from hanging; the answer's numbers are relative to the servo's gain."""
    rng = np.random.default_rng(1)
    truth = sysid.Model(
        sysid.GeneralJoint(J=0.04, G=1.0), (sysid.PositionServo(k_p=6.0, k_d=0.3), sysid.Coulomb(0.2)), dt=DT
    )
    goals = math.pi + np.stack([multisine(rng, 400, DT, 1.2, 1.5) for _ in range(3)])
    records = sysid.Sensor(theta=0.001).measure(sysid.simulate(truth, goals, np.full(3, math.pi), np.zeros(3)), rng)
    for k, r in enumerate(records):
        theta, goal = (np.rad2deg(v - math.pi) for v in (r.theta, np.append(r.u, r.u[-1])))
        write(tmp_path / f"servo{k}.csv", {"t": r.t, "theta": theta, "goal": goal})
    (tmp_path / "log.toml").write_text(
        'input = "position"\nplant = "joint"\ndegrees = true\nzero = "hanging"\ncolumns = "command=goal"\n'
    )
    files = [str(f) for f in sorted(tmp_path.glob("*.csv"))]
    answer = tmp_path / "answer.json"
    assert main(["diagnose", *files, "--json", str(answer)]) == 0
    said = capsys.readouterr().out
    assert "motion alone cannot show position_servo.k_p: it stays at 1 N m/rad" in said
    diagnosis = json.loads(answer.read_text())
    assert [s["effect"] for s in diagnosis["steps"]] == ["coulomb"], said
    assert diagnosis["parameters"]["coulomb.tau_c"]["value"] == pytest.approx(0.2 / 6.0, rel=0.03)
    assert main(["fit", *files, "--set", "position_servo.k_p=6"]) == 0
    assert "motion alone" not in capsys.readouterr().out
    assert main(["fit", *files, "--set", "J=0.04", "--set", "G=1", "--with", "coulomb"]) == 0
    assert "position_servo.k_p = 5.9" in capsys.readouterr().out.replace("6.0", "5.9")


def test_an_actuators_constant_stays_where_the_plant_is_free(tmp_path, capsys):
    """Also where the actuator is put in by name: motion alone cannot show it."""
    rng = np.random.default_rng(1)
    truth = sysid.Model(sysid.GeneralJoint(J=0.04, G=1.0), (sysid.DCMotor(k=0.5, k_e=0.2),), dt=DT)
    volts = np.stack([multisine(rng, 300, DT, 2.0, 1.5) for _ in range(2)])
    records = SENSOR.measure(sysid.simulate(truth, volts, np.full(2, math.pi), np.zeros(2)), rng)
    files = written(records, tmp_path)
    for chosen in (["--input", "voltage"], ["--with", "dc_motor"]):
        assert main(["fit", *files, "--plant", "joint", *chosen]) == 0
        said = capsys.readouterr().out
        assert "it stays at 1 N m/V" in said and "dc_motor.k_e = " in said.replace("  ", " ")
        assert "dc_motor.k " not in said


@pytest.mark.parametrize("noise", ["theta=1e-300", "theta_dot=1e-300", "theta=1e-160,theta_dot=0.05", "theta=1e300"])
def test_a_noise_out_of_all_proportion_is_refused(noise, hidden, capsys):
    said = answering.refused(main, ["fit", hidden[0], "--noise", noise], capsys)
    assert "sensor sd of " in said and ": expected 1e-20 to 1e+20" in said


@pytest.mark.parametrize("noise", ["theta=1e-12,theta_dot=0.05", "theta=1e-12,theta_dot=1e12"])
def test_a_noise_of_any_unit_is_taken(noise, hidden):
    assert main(["fit", hidden[0], "--noise", noise]) == 0


@pytest.mark.parametrize("module", ["sysid", "policies", "study.worth", "study.main"])
def test_who_closes_the_pipe_reads_no_traceback(module):
    reading, writing = os.pipe()
    os.close(reading)
    try:
        words = [sys.executable, "-m", module, "--help"]
        done = subprocess.run(words, cwd=ROOT, stdout=writing, stderr=subprocess.PIPE, timeout=60, check=False)
    finally:
        os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")
