"""The rooms of the study import from those above them only, and no module from one that imports it."""

import pytest

from tests.floors import ROOT, against_the_order, circle, imported

FLOORS = (
    "formatting",
    "statistics",
    "figure_style",
    "pipeline",
    "paper",
    "trials",
    "strategies",
    "mismatch",
    "worth",
    "presets",
    "main",
)


def test_a_room_imports_from_those_above_it_only():
    assert not against_the_order("study", FLOORS)


@pytest.mark.parametrize("package", ["sysid", "policies", "study"])
def test_no_modules_import_each_other_in_a_circle(package):
    assert not circle(package)


def test_the_experiments_on_hidden_plants_stand_without_the_papers_sweep():
    for room in ("trials", "mismatch", "strategies"):
        imports = {name for path in (ROOT / "study" / room).rglob("*.py") for name in imported(path)}
        assert {name for name in imports if name.startswith("study.paper.")} <= {
            f"study.paper.protocol.{name}" for name in ("paper_model", "BOUNDS")
        }
