"""The rooms of the study import from those above them only; the two experiments do not know each other."""

from tests.floors import ROOT, against_the_order, imported

FLOORS = (
    "formatting",
    "statistics",
    "figure_style",
    "pipeline",
    "paper",
    "mismatch",
    "strategies",
    "worth",
    "presets",
    "main",
)


def test_a_room_imports_from_those_above_it_only():
    assert not against_the_order("study", FLOORS)


def test_the_mismatch_experiment_stands_without_the_papers_sweep():
    found = [name for path in (ROOT / "study" / "mismatch").rglob("*.py") for name in imported(path)]
    assert {name for name in found if name.startswith("study.paper.")} <= {
        f"study.paper.protocol.{name}" for name in ("paper_model", "BOUNDS")
    }
