"""The three packages know each other in one direction only, and sysid stays light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FORBIDDEN = {
    "sysid": {"torch", "torchrl", "tensordict", "gymnasium", "control", "policies", "study"},
    "policies": {"study"},
}


def imported(path: Path) -> set[str]:
    """Top-level names of all imports of a file, those inside functions included."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module.split(".")[0])
        elif isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in (
            "import_module",
            "__import__",
        ):
            names.update(a.value.split(".")[0] for a in node.args if isinstance(a, ast.Constant))
    return names


@pytest.mark.parametrize(("package", "forbidden"), FORBIDDEN.items())
def test_packages_import_in_one_direction(package, forbidden):
    files = sorted((ROOT / package).rglob("*.py"))
    assert files
    for path in files:
        assert not imported(path) & forbidden, path


def fresh(code: str) -> str:
    """What a new Python prints."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_importing_sysid_loads_no_learning_and_no_drawing():
    heavy = "('torch', 'gymnasium', 'control', 'policies', 'study', 'matplotlib', 'plotly', 'jinja2', 'pandas')"
    assert fresh(f"import sys, sysid; print([n for n in {heavy} if n in sys.modules])") == "[]"


def test_importing_sysid_is_quick():
    clock = "import time; t = time.perf_counter(); import sysid; print(time.perf_counter() - t)"
    assert min(float(fresh(clock)) for _ in range(3)) < 1.5


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


def modules(node: ast.AST) -> list[str]:
    """The modules of an import, with what it takes from them."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom) and node.level == 0:
        return [f"{node.module}.{alias.name}" for alias in node.names]
    return []


@pytest.mark.parametrize("room", FLOORS)
def test_a_room_imports_from_those_above_it_only(room):
    """Floor by floor, imports inside functions and those for types included."""
    above = FLOORS[: FLOORS.index(room) + 1]
    files = (
        [ROOT / "sysid" / f"{room}.py"]
        if (ROOT / "sysid" / f"{room}.py").is_file()
        else sorted((ROOT / "sysid" / room).rglob("*.py"))
    )
    assert files
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in modules(node):
                parts = name.split(".")
                assert parts[0] != "sysid" or parts[1] in above, f"{path.relative_to(ROOT)} imports {name}"
