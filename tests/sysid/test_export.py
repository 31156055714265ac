"""Exports: a simulator plays what the model does, a user's file keeps what is not the joint's, and nothing is lost
without a sentence."""

import dataclasses
import json
import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sysid
from sysid import InvalidInput, Model, to_mjcf, to_urdf
from sysid.__main__ import main
from sysid.physics.effects import ACTUATORS, CATALOGUE
from sysid.planning.excitation import multisine
from tests.hostile_input.answering import answered, many, refused
from tests.sysid.written import MODEL, SENSOR, rollouts, same

NOISE = 0.003
"""The sensor's noise [rad] in the logs of the README."""
ROD = sysid.RodPendulum(m=1.04, l=0.97, g=9.81)
PLANTS = (ROD, sysid.PointMassPendulum(m=0.7, l=0.9), sysid.GeneralJoint(J=0.3, G=2.4), sysid.LinearAxis(m=2.0))
FREE = sysid.GeneralJoint(J=0.3, G=0.0)
FRICTION = (sysid.Viscous(0.05), sysid.Coulomb(0.15))
MAPPED = {
    "nothing": (),
    "viscous": (sysid.Viscous(0.1), sysid.BackEmf(0.05)),
    "coulomb": FRICTION,
    "rotor": (sysid.RotorInertia(0.1),),
    "spring": (sysid.Spring(0.5),),
    "tilt": (sysid.Tilt(0.1),),
    "bias": (sysid.TorqueBias(0.2),),
    "gain": (sysid.TorqueGain(0.8),),
    "saturation": (sysid.Saturation(1.0),),
    "saturation, then gain, and bias": (sysid.Saturation(1.2), sysid.TorqueGain(0.8), sysid.TorqueBias(0.2)),
    "gain, then saturation": (sysid.TorqueGain(1.3), sysid.Saturation(1.2)),
    "delay": (sysid.Delay(0.06),),
    "delay of no whole steps": (sysid.Delay(0.05003),),
    "lag": (sysid.Lag(0.07),),
    "lag of less than a step": (sysid.Lag(1e-5),),
    "lag and saturation": (sysid.Lag(0.07), sysid.Saturation(1.0)),
    "current": (sysid.TorqueConstant(2.0), sysid.Saturation(0.4)),
    "voltage": (sysid.DCMotor(1.5, 0.3), sysid.Saturation(1.0)),
    "servo": (sysid.PositionServo(10.0, 1.0, 3.0),),
    "all": (*FRICTION, sysid.Delay(0.05), sysid.Saturation(1.5), sysid.TorqueBias(0.1), sysid.Tilt(0.05)),
}


def played(text, u, theta, dt, name="drive"):
    """The joint's angle (N+1,) in MuJoCo under commands u (N,), each held over dt [s]."""
    mujoco = pytest.importorskip("mujoco", reason="the exported file is played by the extra [sim]")
    model = mujoco.MjModel.from_xml_string(text)
    data, steps = mujoco.MjData(model), round(dt / model.opt.timestep)
    assert steps * model.opt.timestep == pytest.approx(dt)
    data.qpos[0] = theta
    angles = [theta]
    for command in u:
        if model.nu:
            data.ctrl[0] = command
        mujoco.mj_step(model, data, steps)
        angles.append(data.qpos[0])
    return np.array(angles)


def commands(seed, model):
    rng = np.random.default_rng(seed)
    u = multisine(rng, round(5.0 / model.dt), model.dt, 2.0, 2.0)
    return u + math.pi * (model.actuator is not None and model.actuator.at_angle), math.pi + rng.uniform(-0.8, 0.8)


def numbers_of(element):
    return {k: v for k, v in element.attrib.items() if k not in ("name", "joint")}


# ---- MJCF of our own ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "plant"),
    [
        *((name, ROD) for name in MAPPED),
        *((name, p) for name in ("nothing", "spring", "servo", "all") for p in PLANTS[1:]),
    ],
    ids=lambda p: p if isinstance(p, str) else type(p).__name__,
)
def test_mujoco_plays_what_the_model_does(name, plant):
    """Over 5 s the angles differ by less than the noise of the sensor; without dry friction by next to nothing."""
    model = Model(plant, MAPPED[name], sysid.RK4(8), dt=0.02)
    exported = to_mjcf(model)
    soft = any(isinstance(e, sysid.Coulomb) for e in model.effects)
    assert any("dry friction is soft" in s for s in exported.sentences) == soft
    for seed in range(2):
        u, theta = commands(seed, model)
        off = np.abs(played(exported.text, u, theta, model.dt) - sysid.simulate(model, u, theta, 0.0).theta)
        assert off.max() < (NOISE if soft else 3e-4)


def test_the_largest_command_is_the_range_of_the_control_and_the_joint_has_its_name():
    pytest.importorskip("mujoco")
    text = to_mjcf(Model(FREE, (sysid.Saturation(1.0),), u_max=2.0), joint="shoulder").text
    (general,) = ElementTree.fromstring(text).iter("general")
    assert numbers_of(general) == {
        "gainprm": "1",
        "ctrllimited": "true",
        "ctrlrange": "-2 2",
        "forcelimited": "true",
        "forcerange": "-1 1",
    }
    assert general.get("joint") == "shoulder"
    played(text, np.ones(5), 0.0, 0.05)


@pytest.mark.parametrize("language", [to_mjcf, to_urdf])
@pytest.mark.parametrize("name", [*CATALOGUE, *ACTUATORS])
def test_an_effect_changes_the_file_or_is_named_in_a_sentence(name, language):
    kind = {**CATALOGUE, **ACTUATORS}[name]
    sized = {k: 0.3 for k, p in kind().parameters.items() if p.neutral is not None or p.known or k in ("k_e", "k_d")}
    effect = kind(
        **{k: min(max(v, kind().parameters[k].bounds[0]), kind().parameters[k].bounds[1]) for k, v in sized.items()}
    )
    plain, exported = language(Model(ROD)), language(Model(ROD, (effect,)))
    new = set(exported.sentences) - set(plain.sentences)
    assert exported.text != plain.text or new
    if exported.text == plain.text:
        assert all(s.endswith(".") and "\n" not in s for s in new)
    assert not any(s.startswith(name) for s in plain.sentences)


def test_what_belongs_to_the_log_or_the_sensor_is_said_to():
    effects = (sysid.Stamp(0.5), sysid.Backlash(0.1), sysid.Drag(0.02), sysid.Stribeck(0.1, 0.05))
    sentences = to_mjcf(Model(ROD, effects)).sentences
    stamp, backlash, drag, stribeck = (next(s for s in sentences if s.startswith(e.name)) for e in effects)
    assert "it belongs to the log, not to the machine" in stamp
    assert "it is of the sensor" in backlash
    assert drag == "drag (c = 0.02 N m s^2/rad^2) is not in the file: MJCF has no word for air drag."
    assert "tau_c = 0.1 N m, excess = 0.05 N m" in stribeck
    (drag, gain) = to_urdf(Model(sysid.LinearAxis(), (sysid.Drag(0.02), sysid.TorqueGain(1.1)))).sentences
    assert drag.startswith("drag (c = 0.02 N s^2/m^2)") and gain.startswith("torque_gain (c = 1.1) is not in the file")


# ---- a user's MJCF -----------------------------------------------------------------------------------------------

ROBOT = """<!-- our robot, licensed to be kept -->
<mujoco model="robot">
  <compiler angle="{angle}"/>
  <option timestep="0.0005" integrator="{integrator}"/>
  <default><joint damping="7"/></default>
  <worldbody>
    <!-- the base -->
    <body name="arm">
      <joint name="shoulder" type="hinge" axis="0 1 0" limited="false" user="3"/>
      <inertial pos="0 0 0.485" mass="1.04" diaginertia="0.0815447 0.0815447 0.0815447"/>
    </body>
    <body name="cart" pos="0 3 0">
      <joint name="wrist" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="m" joint="shoulder" gear="{gear}" ctrlrange="-9 9"/>
    <position name="p" joint="wrist" kp="5"/>
  </actuator>
  <!-- the end -->
</mujoco>
"""


def robot(path, angle="degree", integrator="implicitfast", gear="1", **changes):
    text = ROBOT.format(angle=angle, integrator=integrator, gear=gear)
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return path


@pytest.mark.parametrize("integrator", ["RK4", "implicitfast"])
@pytest.mark.parametrize("angle", ["degree", "radian"])
@pytest.mark.parametrize("name", ["coulomb", "spring", "saturation", "delay", "rotor", "all but bias and tilt"])
def test_a_users_file_plays_what_the_model_does(name, angle, integrator, tmp_path):
    effects = (*FRICTION, sysid.Delay(0.06), sysid.Saturation(1.2), sysid.Spring(0.3)) if " " in name else MAPPED[name]
    model = Model(ROD, effects, sysid.RK4(8), dt=0.02)
    text = to_mjcf(model, "shoulder", robot(tmp_path / "robot.xml", angle, integrator)).text
    u, theta = commands(0, model)
    off = np.abs(played(text, u, theta, model.dt) - sysid.simulate(model, u, theta, 0.0).theta)
    assert off.max() < 2.0 * NOISE  # its own steps and solver, which are coarser than ours


def test_a_users_file_is_kept_but_for_the_joint_and_its_actuator(tmp_path):
    path = robot(tmp_path / "robot.xml", gear="50")
    before = path.read_text()
    exported = to_mjcf(Model(ROD, MAPPED["all"]), "shoulder", path)
    assert path.read_text() == before
    for comment in re.findall(r"<!--.*?-->", before):
        assert comment in exported.text
    assert exported.text.startswith("<!-- our robot") and exported.text.endswith("</mujoco>\n")
    old, new = (ElementTree.fromstring(t) for t in (before, exported.text))
    for mine, yours in zip(old.iter(), new.iter(), strict=True):
        assert mine.tag == yours.tag
        if "shoulder" not in (mine.get("name"), mine.get("joint")):
            assert mine.attrib == yours.attrib
        else:
            assert mine.attrib.items() <= yours.attrib.items()
    motor = next(new.iter("motor"))
    assert motor.get("forcerange") == "-0.03 0.03" and motor.get("gear") == "50" and motor.get("ctrlrange") == "-9 9"
    said = " ".join(exported.sentences)
    for what in (
        "The body is as it was",
        "tilt (alpha = 0.05 rad) is not in the file",
        "joint of MJCF has no word for a constant torque",
    ):
        assert what in said


def test_an_actuator_that_takes_another_command_is_left_as_it_is(tmp_path):
    for changes, model, sentence in (
        ({"<motor": "<velocity"}, Model(ROD, (sysid.Delay(0.01),)), "The actuator <velocity> takes another command"),
        ({}, Model(ROD, (sysid.PositionServo(5.0, 1.0, 3.0),)), "The actuator <motor> takes another command"),
        ({'joint="shoulder"': 'joint="wrist"'}, Model(ROD), "No actuators of this joint: expected one"),
        ({'gear="1" ': "", "<default>": '<default><motor gear="9"/>'}, Model(ROD), "The gear may come from a default"),
    ):
        exported = to_mjcf(model, "shoulder", robot(tmp_path / "robot.xml", **changes))
        assert any(s.startswith(sentence) for s in exported.sentences), exported.sentences
        assert "forcerange" not in exported.text and 'kp="5"' in exported.text
    servo = to_mjcf(
        Model(ROD, (sysid.PositionServo(5.0, 1.0, 3.0),)),
        "shoulder",
        robot(tmp_path / "robot.xml", **{'<motor name="m"': '<position name="m"'}),
    )
    assert 'kp="5" kv="1"' in servo.text.replace(" forcelimited", "")


LAUGHS = '<!DOCTYPE m [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><mujoco>&b;</mujoco>'
NO_FILE = {
    "laughs": (LAUGHS, "declares a document type"),
    "doctype": ("<!DOCTYPE mujoco SYSTEM 'file:///etc/passwd'><mujoco/>", "declares a document type"),
    "sixteen": (LAUGHS.encode("utf-16"), "declares a document type|is not XML"),
    "other": ("<robot/>", "is a file of <robot>: expected MJCF"),
    "text": ("nothing of the kind", "is not XML in UTF-8"),
    "empty": ("", "is not XML in UTF-8"),
    "cut": (ROBOT[:300], "is not XML in UTF-8"),
    "none": ("<mujoco/>", "has no joint 'shoulder': found none"),
    "deep": (
        "<mujoco>" + "<body>" * 10**5 + '<joint name="shoulder"/>' + "</body>" * 10**5 + "</mujoco>",
        "too many elements within each other",
    ),
    "step": ('<mujoco><option timestep="x"/><joint name="shoulder"/></mujoco>', "is no number"),
    "slide": ('<mujoco><joint name="shoulder" type="slide"/></mujoco>', "slides, and the model does not"),
    "gear": (
        '<mujoco><joint name="shoulder"/><actuator><motor joint="shoulder" gear="nan"/></actuator></mujoco>',
        "gear of actuator <motor> is 'nan': expected a number",
    ),
}


@pytest.mark.parametrize("name", NO_FILE)
def test_what_is_no_users_file_is_refused(name, tmp_path):
    content, message = NO_FILE[name]
    path = tmp_path / "robot.xml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert not answered(to_mjcf, Model(ROD), "shoulder", path)
    with pytest.raises(InvalidInput, match=message):
        to_mjcf(Model(ROD), "shoulder", path)


@many
@given(changes=st.lists(st.tuples(st.integers(0, 5000), st.sampled_from(list(b'<>&"/=!- \0\xff9xN'))), max_size=6))
def test_a_damaged_file_is_refused_or_changed(tmp_path_factory, changes):
    content = bytearray(ROBOT.format(angle="degree", integrator="RK4", gear="2").encode())
    for place, byte in changes:
        content[place % len(content)] = byte
    path = tmp_path_factory.getbasetemp() / "robot.xml"
    path.write_bytes(content)
    answered(to_mjcf, Model(ROD, MAPPED["all"]), "shoulder", path)


# ---- URDF --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plant", PLANTS, ids=lambda p: type(p).__name__)
def test_a_reader_of_urdf_plays_what_the_model_does(plant):
    """MuJoCo reads URDF, too: a swing without a drive, under damping, on a base that leans."""
    pytest.importorskip("mujoco")
    model = Model(plant, (sysid.Viscous(0.1), sysid.Tilt(0.1), sysid.RotorInertia(0.05)), sysid.RK4(8), dt=0.02)
    text = to_urdf(model, "shoulder").text
    if plant.turns:
        options = '<mujoco><option timestep="0.0005" integrator="RK4"/></mujoco></robot>'
        angles = played(text.replace("</robot>", options), np.zeros(250), 2.5, 0.02)
        np.testing.assert_allclose(angles, sysid.simulate(model, np.zeros(250), 2.5, 0.0).theta, atol=NOISE)
    (joint,) = ElementTree.fromstring(text).iter("joint")
    assert joint.get("name") == "shoulder" and joint.get("type") == ("continuous" if plant.turns else "prismatic")


def test_urdf_holds_friction_and_the_limit():
    text = to_urdf(Model(ROD, (*FRICTION, sysid.Saturation(1.5)), u_max=2.0)).text
    attributes = {e.tag: e.attrib for e in ElementTree.fromstring(text).iter()}
    assert attributes["dynamics"] == {"damping": "0.05", "friction": "0.15"} and attributes["limit"]["effort"] == "1.5"


# ---- the command line --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model.json, and two rollouts of it."""
    path = tmp_path_factory.mktemp("export")
    sysid.save(dataclasses.replace(MODEL, effects=(*MODEL.effects, sysid.Drag(0.01))), path / "model.json")
    for record in rollouts(2):
        sysid.write_csv(record, path / f"{record.name}.csv")
    return path


def test_the_ending_says_the_language(folder, tmp_path, capsys):
    for to, root in (("arm.xml", "mujoco"), ("arm.urdf", "robot")):
        assert main(["export", str(folder / "model.json"), "--to", str(tmp_path / to)]) == 0
        assert ElementTree.parse(tmp_path / to).getroot().tag == root
        assert "drag (c = 0.01 N m s^2/rad^2) is not in the file" in capsys.readouterr().out
    words = ["export", str(folder / "model.json"), "--to"]
    for more, message in (
        ([str(tmp_path / "arm.txt")], "arm.txt is neither MJCF nor URDF: expected a name that ends with .xml or .urdf"),
        ([str(tmp_path / "arm.xml")], "arm.xml is there already: expected another name, or --force"),
        ([str(tmp_path / "no.urdf"), "--into", str(tmp_path / "arm.xml")], "--into changes a file of MJCF"),
    ):
        assert message in refused(main, [*words, *more], capsys)
    assert not (tmp_path / "no.urdf").exists()
    answer = tmp_path / "answer.json"
    assert main([*words, str(tmp_path / "arm.xml"), "--force", "--json", str(answer)]) == 0
    saved = json.loads(answer.read_text())
    assert saved["text"] == (tmp_path / "arm.xml").read_text() and saved["format"] == "MJCF" and saved["sentences"]


def test_the_command_line_changes_a_users_file(folder, tmp_path, capsys):
    path = robot(tmp_path / "robot.xml")
    words = ["export", str(folder / "model.json"), "--into", str(path), "--joint", "shoulder", "--to"]
    assert main([*words, str(tmp_path / "new.xml")]) == 0
    assert 'damping="0.05"' in (tmp_path / "new.xml").read_text()
    assert "is read by this command" in refused(main, [*words, str(path), "--force"], capsys)


def test_a_mended_log_comes_back_beside_its_predictions(folder, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    logs = sorted(folder.glob("*.csv"))
    sysid.save(MODEL, tmp_path / "true.json")
    words = [
        "compare",
        *map(str, logs),
        "--model",
        str(tmp_path / "true.json"),
        "--noise",
        "theta=0.003,theta_dot=0.05",
    ]
    assert main([*words, "--parquet", str(tmp_path / "log.parquet")]) == 0
    for mine, yours in zip(sysid.read(tmp_path / "log.parquet"), sysid.read(logs), strict=True):
        same(mine, yours)
    table = {k: np.array(v, dtype=float) for k, v in parquet.read_table(tmp_path / "log.parquet").to_pydict().items()}
    assert list(table) == [
        "rollout",
        "t",
        "torque",
        *(f"{c}{what}" for c in ("theta", "theta_dot") for what in ("", "_predicted", "_residual")),
        "residual_torque",
        "residual_torque_sd",
    ]
    for channel in ("theta", "theta_dot"):
        left = table[f"{channel}_residual"]
        np.testing.assert_array_equal(left, table[channel] - table[f"{channel}_predicted"])
        assert np.isfinite(left).all()
        assert np.sqrt(np.mean(left**2)) == pytest.approx(getattr(SENSOR, channel), rel=0.15)
    assert np.isnan(table["residual_torque"]).sum() == 2
