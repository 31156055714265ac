"""The rooms of policies import from those above them only."""

from tests.floors import against_the_order

FLOORS = ("limits", "environments", "network_policy", "evaluation", "control", "training", "storage", "cli")


def test_a_room_imports_from_those_above_it_only():
    assert not against_the_order("policies", FLOORS)
