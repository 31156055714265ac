"""The three packages know each other in one direction only, and sysid stays light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.floors import ROOT, against_the_order, imported

FORBIDDEN = {
    "sysid": {"torch", "torchrl", "tensordict", "gymnasium", "control", "policies", "study"},
    "policies": {"study"},
}


def packages(path: Path) -> set[str]:
    """The packages that a file imports, those inside functions and those by a text included."""
    names = set(imported(path))
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        called = getattr(node, "func", None)
        if getattr(called, "attr", getattr(called, "id", "")) in ("import_module", "__import__"):
            names.update(a.value for a in node.args if isinstance(a, ast.Constant))
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize(("package", "forbidden"), FORBIDDEN.items())
def test_packages_import_in_one_direction(package, forbidden):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        assert not packages(path) & forbidden, path


def fresh(code: str) -> str:
    """What a new Python prints."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_importing_sysid_loads_no_learning_and_no_drawing():
    heavy = "('torch', 'gymnasium', 'control', 'policies', 'study', 'matplotlib', 'plotly', 'jinja2', 'pandas')"
    assert fresh(f"import sys, sysid; print([n for n in {heavy} if n in sys.modules])") == "[]"


def test_every_public_name_exists():
    assert fresh("import sysid; print([n for n in sysid.__all__ if not hasattr(sysid, n)])") == "[]"


FLOORS = (
    "errors",
    "limits",
    "version",
    "physics",
    "data",
    "estimation",
    "planning",
    "diagnosis",
    "report",
    "export",
    "cli",
    "web",
)


def test_a_room_imports_from_those_above_it_only():
    assert not against_the_order("sysid", FLOORS)
