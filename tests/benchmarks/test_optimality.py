"""The benchmark of quality over cost trains what it was told to, and says when the optimum was near."""

import csv

import pytest

from policies.control import references
from policies.control.dynamic_programming import Grid
from tests.benchmarks.optimality import COLUMNS, main, reached

pytestmark = pytest.mark.long


def test_near_is_within_a_share_of_the_optimum():
    rows = [
        {"median": value, "optimum": -100.0, "cpu_seconds": 2.0 * k, "steps": 1000 * k}
        for k, value in enumerate((-300.0, -104.0, -120.0, -101.0))
    ]
    assert reached(rows, 0.05) == "2 s, 1,000 steps"
    assert reached(rows, 0.02) == "6 s, 3,000 steps"
    assert reached(rows[:1], 0.05) == "never"


def test_a_table_grows_by_the_looks_of_every_plant(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(references, "FINE", Grid(60, 61, 5))
    table = tmp_path / "table.csv"
    words = ["--plants", "plain", "--agents", "2", "--looks", "3", "--csv", str(table)]
    of_sac = ("hidden=8", "batch=16", "random_steps=20")
    assert main([*words, "--algorithm", "sac", "--steps", "60", "--set", *of_sac]) == 0
    assert main([*words, "--set", "hidden=8", "environments=4", "horizon=5", "--steps", "60"]) == 0
    with table.open() as opened:
        rows = list(csv.DictReader(opened))
    assert tuple(rows[0]) == COLUMNS and [row["steps"] for row in rows] == 2 * ["20", "40", "60"]
    assert [row["algorithm"] for row in rows] == 3 * ["sac"] + 3 * ["shac"]
    assert {row["settings"] for row in rows[:3]} == {" ".join(of_sac)}
    assert all(float(row["lowest"]) <= float(row["median"]) <= float(row["highest"]) < -500.0 for row in rows)
    assert "plain: within 5 %: never; within 2 %: never" in capsys.readouterr().out
