"""A user's own effects: a file of theirs joins the catalogue, and is told what is wrong with it."""

import sys

import numpy as np
import pytest

import sysid

FILE = """
from __future__ import annotations

from dataclasses import dataclass

import sysid
from sysid.physics import ops


@sysid.register
@dataclass(frozen=True, eq=False)
class {name}(sysid.JointEffect):
    k: float = sysid.parameter(0.0, unit="N m", bounds=(-10.0, 10.0){neutral})

    def torque(self, joint):
        return {torque}
"""


@pytest.fixture
def write(tmp_path, catalogue):
    """Writes a file with an effect of that torque; the catalogue is put back after the test."""

    def written(torque="self.k * ops.sin(3.0 * joint.theta)", name="Wave", neutral=", neutral=0.0"):
        file = tmp_path / "mine.py"
        file.write_text(FILE.format(torque=torque, name=name, neutral=neutral))
        return file

    return written


def test_it_joins_the_catalogue_and_is_fitted(write, catalogue):
    assert sysid.load_effects(write()) == ("wave",)
    truth = sysid.Model(sysid.PointMassPendulum(m=1.0, l=0.5), (sysid.effect("wave", k=0.4),), dt=0.02)
    rng = np.random.default_rng(2)
    u = rng.uniform(-2.0, 2.0, (4, 300)).repeat(2, axis=1)[:, :300]
    log = sysid.Sensor(0.003, 0.05).measure(sysid.simulate(truth, u, np.full(4, 3.0), np.zeros(4)), rng)
    added = sysid.add(sysid.Model(sysid.PointMassPendulum(m=1.1, l=0.55), dt=0.02), "wave", log)
    assert abs(added.estimate.values["wave.k"] - 0.4) < 4.0 * added.estimate.sd["wave.k"] < 0.1
    assert added.after.ratio < 1.1 < added.before.ratio
    sysid.save(added.estimate, write().with_name("model.json"))
    assert sysid.load_model(write().with_name("model.json")).effects[0].k == added.estimate.values["wave.k"]


def test_a_file_that_was_changed_is_loaded_again(write, catalogue):
    sysid.load_effects(write())
    first = catalogue["wave"]
    sysid.load_effects(write("self.k * ops.cos(joint.theta)"))
    assert catalogue["wave"] is not first
    sysid.load_effects(write(name="Other"))
    assert "wave" not in catalogue


WRONG = {
    "raises": ({"torque": "self.k * nonsense"}, "effect 'wave' of mine.py: mine.py, line 16 raises NameError"),
    "asks a symbol": ({"torque": "self.k if joint.theta.max() > 1 else 0.0 * joint.theta"}, "line 16 raises"),
    "not finite": ({"torque": "self.k * ops.sqrt(joint.theta - 10.0)"}, "not finite"),
    "numbers only": ({"torque": "self.k * (joint.theta if ops.is_number(joint.theta) else 0.0)"}, "disagree"),
    "not neutral": ({"torque": "self.k + 0.1"}, "neutral value"),
    "no neutral": ({"neutral": ""}, "no parameter has a neutral value"),
    "name is taken": ({"name": "Coulomb"}, "give the class another name"),
}


@pytest.mark.parametrize(("effect", "message"), WRONG.values(), ids=WRONG.keys())
def test_an_effect_that_cannot_be_used(effect, message, write, catalogue):
    before = dict(catalogue)
    with pytest.raises(sysid.InvalidInput) as refused:
        sysid.load_effects(write(**effect))
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
    assert catalogue == before


TEXTS = {
    "raises": ("\n1 / 0\n", "mine.py, line 2 raises ZeroDivisionError"),
    "leaves": ("raise SystemExit(3)\n", "raises SystemExit: 3"),
    "no Python": ("def f(:\n", "mine.py, line 1: invalid syntax"),
    "no module": ("import nowhere_to_be_found\n", "nowhere_to_be_found"),
    "no effect": ("x = 1\n", "holds no effect"),
}


@pytest.mark.parametrize(("text", "message"), TEXTS.values(), ids=TEXTS.keys())
def test_a_file_that_holds_no_effect(text, message, tmp_path, catalogue):
    (tmp_path / "mine.py").write_text(text)
    with pytest.raises(sysid.InvalidInput) as refused:
        sysid.load_effects(tmp_path / "mine.py")
    assert message in str(refused.value)


def test_nothing_is_written_beside_the_file(write, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    sysid.load_effects(write())
    assert [p.name for p in tmp_path.iterdir()] == ["mine.py"]
