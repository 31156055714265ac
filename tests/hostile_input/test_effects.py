"""Whatever a user's effect does, its file and line are blamed in one sentence."""

import pytest

import sysid
from sysid.__main__ import main as sysid_main
from tests.hostile_input.answering import refused

EFFECT = """from dataclasses import dataclass
from sysid import JointEffect, ops, parameter, register

@register
@dataclass(frozen=True, eq=False)
class Weight(JointEffect):
    {declared}
    a: ops.Value = parameter(0.0, unit="N m", bounds=(0.0, 1.0), neutral=0.0)

    def torque(self, joint):
        {first}
        return -self.a * ops.sin(joint.theta)
"""
RAISED = ("KeyboardInterrupt", "SystemExit(0)", "GeneratorExit", "BaseException('\\n\\x1b[31m')", "MemoryError", "Bad")
BAD = "class Bad(BaseException):\n    def __str__(self): return 3\n"
EFFECTS = {
    **{f"file {raised}": f"{BAD}raise {raised}\n" for raised in RAISED},
    **{f"torque {raised}": BAD + EFFECT.format(declared="", first=f"raise {raised}") for raised in RAISED},
    **{
        f"declared {declared}": EFFECT.format(declared=declared, first="")
        for declared in (
            "name = 3",
            "formula = 3",
            "confused = 3",
            "rarity = 'x'",
            "refines = 3",
            "contains = 3",
            "name = 'x' * 10**6",
        )
    },
    "for ever": "def f(): f()\nf()\n",
    "a number": "from sysid import register\nregister(3)\n",
    "no effect": "from sysid import register\n@register\nclass Weight: pass\n",
    "NUL": "a\0b",
}


@pytest.mark.parametrize("text", EFFECTS.values(), ids=EFFECTS.keys())
def test_an_effect_may_raise_anything_or_be_none(text, tmp_path, capsys):
    (tmp_path / "mine.py").write_text(text)
    before = dict(sysid.CATALOGUE)
    assert "mine.py" in refused(sysid_main, ["effects", "--effects", str(tmp_path / "mine.py")], capsys)
    assert before == sysid.CATALOGUE


@pytest.mark.parametrize(
    ("returned", "shown"),
    [
        ("None", "returns None"),
        ("'0.1'", "returns '0.1'"),
        ("[0.1, 0.2, 0.3]", "returns [0.1, 0.2, 0.3]"),
        ("__import__('numpy').ones(3)", "returns an array of shape (3,)"),
    ],
)
def test_a_torque_that_is_no_number_is_shown_beside_what_was_expected(returned, shown, tmp_path, capsys):
    (tmp_path / "mine.py").write_text(EFFECT.format(declared="", first=f"return {returned}"))
    said = refused(sysid_main, ["effects", "--effects", str(tmp_path / "mine.py")], capsys)
    assert f"effect 'weight' of mine.py: torque {shown}: expected a number or an array of the state's shape" in said


def test_an_effect_that_raises_in_the_middle_is_blamed_with_its_line(log, tmp_path, capsys):
    count = "import builtins; builtins.seen = getattr(builtins, 'seen', 0) + 1; assert builtins.seen < 200, 'too often'"
    (tmp_path / "mine.py").write_text(EFFECT.format(declared="", first=count))
    before = dict(sysid.CATALOGUE)
    try:
        words = ["fit", str(log / "log.csv"), "--effects", str(tmp_path / "mine.py"), "--with", "weight"]
        assert "mine.py, line 11 raises AssertionError: too often" in refused(sysid_main, words, capsys)
    finally:
        sysid.CATALOGUE.clear()
        sysid.CATALOGUE.update(before)
